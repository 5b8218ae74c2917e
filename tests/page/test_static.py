"""The page's own files: small, readable in both schemes, and free of anything from elsewhere."""

import gzip
import re
from pathlib import Path

import pytest

from hil.page.server import STATIC

FILES = sorted(STATIC.iterdir())
STYLE = (STATIC / "style.css").read_text()
MOST_BYTES = 150_000  # gzipped, at first load
LEAST_CONTRAST = 4.5  # WCAG 2.2, 1.4.3


def test_a_first_load_is_small() -> None:
    assert sum(len(gzip.compress(path.read_bytes(), 6)) for path in FILES) < MOST_BYTES
    assert {path.suffix for path in FILES} == {".html", ".css", ".js", ".svg"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_nothing_comes_from_elsewhere_and_no_text_becomes_markup(path: Path) -> None:
    text = path.read_text().replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://", text.replace("`${scheme}://", "").replace('"https:"', ""))
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function", text)
    if path.suffix == ".html":
        assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\bon\w+=|\bstyle=", text)


def luminance(colour: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    parts = [int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one: str, other: str) -> float:
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def variables(scheme: int) -> dict[str, str]:
    """Colours by name. scheme: 0 light, 1 dark."""
    found = dict(re.findall(r"--([\w-]+): (#\w{6});", STYLE))
    pairs = re.findall(r"--([\w-]+): light-dark\((#\w{6}), (#\w{6})\)", STYLE)
    return found | {name: colours[scheme] for name, *colours in pairs}


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_every_text_can_be_read_on_every_ground_it_stands_on(scheme: int) -> None:
    colours = variables(scheme)
    for text in ("ink", "faint", "accent", "alarm", "a", "b", "c", "d"):
        for ground in ("ground", "card"):
            assert contrast(colours[text], colours[ground]) >= LEAST_CONTRAST, (text, ground)
    assert contrast(colours["on-accent"], colours["accent"]) >= LEAST_CONTRAST


def test_words_on_coloured_fields_can_be_read() -> None:
    ground_first = re.findall(r"background: (#\w{3,6});[^}]*?color: (#\w{3,6})", STYLE)
    text_first = re.findall(r"color: (#\w{3,6}); background: (#\w{3,6})", STYLE)
    states = [(ground, "#fff") for ground in re.findall(r"=\w+\] \{ background: (#\w{6})", STYLE)]
    fields = [*ground_first, *text_first, *states]
    assert len(fields) > 6
    for one, other in fields:
        assert contrast(whole(one), whole(other)) >= LEAST_CONTRAST, (one, other)


def whole(colour: str) -> str:
    """#rrggbb of #rgb."""
    return colour if len(colour) == 7 else "#" + "".join(2 * digit for digit in colour[1:])
