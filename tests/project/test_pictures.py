"""The pictures of docs/ are what their code draws. Numbers may differ in the last digits: BLAS makes them."""

import re
from pathlib import Path

import pytest

from docs.pictures.__main__ import FOLDER, PICTURES

SIMULATED = {"two-laws.svg", "fault-story.svg"}
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
NEAR = 1e-3


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if name in SIMULATED else ()) for name in PICTURES]
)
def test_a_picture_is_up_to_date(name: str, tmp_path: Path) -> None:
    PICTURES[name](tmp_path / name)
    drawn, kept = ((folder / name).read_text(encoding="utf-8") for folder in (tmp_path, FOLDER))
    assert NUMBER.sub("#", drawn) == NUMBER.sub("#", kept), "make docs"
    numbers = [[float(word) for word in NUMBER.findall(text)] for text in (drawn, kept)]
    assert numbers[0] == pytest.approx(numbers[1], abs=NEAR), "make docs"


def test_every_picture_is_shown_on_a_page_and_drawn_by_code() -> None:
    pages = [page.read_text(encoding="utf-8") for page in FOLDER.parent.glob("*.md")]
    shown = {name for text in pages for name in re.findall(r"\(pictures/([\w-]+\.svg)\)", text)}
    assert shown == set(PICTURES) == {path.name for path in FOLDER.glob("*.svg")}
