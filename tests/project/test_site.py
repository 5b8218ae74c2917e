"""Every page has a place in the site."""

import re

from tests.support.paths import ROOT

CONFIG = (ROOT / "deploy" / "site" / "mkdocs.yml").read_text()


def test_the_site_has_every_page_once() -> None:
    pages = re.findall(r"^ +- [^:\n]+: ([\w/-]+\.md)$", CONFIG, re.MULTILINE)
    here = {path.name for path in (ROOT / "docs").glob("*.md")} | {"adr/README.md"}
    assert sorted(pages) == sorted(here)
