"""Hostile manifests: an uninstall ends without a traceback, and touches nothing that is not ours."""

from pathlib import Path

import pytest

from hil.operate.installed import MANIFEST, InstallError, read_manifest
from tests.fuzz.manifests import FILES, LINKS, manifests


@pytest.mark.requirement(id="SR-9.4")
@pytest.mark.parametrize("count", [20, pytest.param(200, marks=pytest.mark.long)])
def test_drawn_manifests_remove_nothing_that_is_not_ours(tmp_path: Path, count: int) -> None:
    counts = manifests(count, 1, tmp_path)
    assert counts["read"] + counts["refused"] == count
    assert min(counts.values()) > count // 8


@pytest.mark.parametrize("entry", ["etc/passwd", "usr/lib/systemd/system/hil.target", "etc/hil/rigs/mine.toml", "hil"])
def test_an_entry_that_no_installation_makes_is_refused(tmp_path: Path, entry: str) -> None:
    place = tmp_path / MANIFEST
    place.parent.mkdir(parents=True)
    place.write_text(f'{{"{entry}": ""}}')
    with pytest.raises(InstallError, match=f"the entry '{entry}' is no file of `hil install`; nothing was removed"):
        read_manifest(tmp_path)
    assert all(name.startswith("etc/s") for name in (*FILES, *LINKS))
