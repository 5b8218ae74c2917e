"""The emulated drive's touch probe by CiA 402-2: which edge of the zero pulse latches which count, and when not."""

from pathlib import Path

import pytest

from sim_plant.drives.object_dictionary import ObjectDictionary
from sim_plant.drives.touch_probe import TouchProbe
from tests.support.foreign_drive import CST_DRIVE, I32, U16, Fact, eds_text

INDEX = 1000.0
FACTS = {(0x60B8, 0): Fact(U16), (0x60B9, 0): Fact(U16, "ro")} | {
    (index, 0): Fact(I32, "ro") for index in (0x60BA, 0x60BB)
}
FIRST, EACH, BOTH = 0x15, 0x17, 0x35  # of the zero pulse: first rising edge, each, the first of both kinds


def probe_of(folder: Path, index: float | None = INDEX) -> tuple[ObjectDictionary, TouchProbe]:
    (folder / "made.eds").write_text(eds_text(CST_DRIVE | FACTS))
    dictionary = ObjectDictionary(3, folder / "made.eds")
    return dictionary, TouchProbe(dictionary, index)


def function(dictionary: ObjectDictionary, value: int) -> None:
    dictionary.write(0x60B8, 0, value.to_bytes(2, "little"))


def told(dictionary: ObjectDictionary) -> tuple[int, int, int]:
    """60B9h, 60BAh, 60BBh."""
    read = [dictionary.read(index, 0) for index in (0x60B9, 0x60BA, 0x60BB)]
    status, rising, falling = (int.from_bytes(data, "little", signed=True) for data in read)
    return status, rising, falling


@pytest.mark.parametrize(
    ("places", "asked", "expected"),
    [
        ((0.0, 5000.0), FIRST, (0x03, 1000, 0)),
        ((5000.0, 0.0), FIRST, (0x03, 1001, 0)),  # from above the pulse begins at its other end
        ((0.0, 5000.0), BOTH, (0x07, 1000, 1001)),
        ((0.0, 5000.0, 0.0), FIRST, (0x03, 1000, 0)),
        ((0.0, 5000.0, 0.0), EACH, (0x03, 1001, 0)),
        ((0.0, 999.9), FIRST, (0x01, 0, 0)),
        ((1000.0, 5000.0), FIRST, (0x01, 0, 0)),  # it begins on the pulse
        ((0.0, 5000.0), 0x11, (0x01, 0, 0)),  # the probe's digital input
        ((0.0, 5000.0), 0x14, (0x00, 0, 0)),  # not switched on
    ],
)
def test_edges(places: tuple[float, ...], asked: int, expected: tuple[int, int, int], tmp_path: Path) -> None:
    dictionary, probe = probe_of(tmp_path)
    function(dictionary, asked)
    for place in places:
        probe.follow(place)
    assert told(dictionary) == expected


def test_off_forgets_and_on_looks_out_anew(tmp_path: Path) -> None:
    dictionary, probe = probe_of(tmp_path)
    function(dictionary, FIRST)
    probe.follow(0.0)
    probe.follow(5000.0)
    function(dictionary, 0)
    assert told(dictionary) == (0x00, 1000, 0)
    probe.follow(0.0)
    function(dictionary, FIRST)
    assert told(dictionary) == (0x01, 1000, 0)
    probe.follow(5000.0)
    assert told(dictionary) == (0x03, 1000, 0)


def test_without_an_index_nothing_is_latched(tmp_path: Path) -> None:
    dictionary, probe = probe_of(tmp_path, None)
    function(dictionary, FIRST)
    probe.follow(0.0)
    probe.follow(5000.0)
    assert told(dictionary) == (0x01, 0, 0)
