"""From a rig file to a layout that runs: the way leads down through the rooms, and back up at most three times."""

import sys
from types import FrameType
from typing import Any

import pytest

from hil.rig.file import load_rig
from hil.rig.layout import host_layout
from tests.project.test_layering import ROOMS
from tests.support.paths import RIGS

MOST = 3


def height(module: str) -> int | None:
    """Of a module of ours: the ground first, then what all layouts share, the families, and the rooms."""
    package, *rest = module.split(".")
    if package == "hil" and rest and rest[0] in ROOMS:
        return 3 + len(ROOMS) - ROOMS.index(rest[0])
    if package == "drivers" and rest:
        return {"base": 0, "families": 2}.get(rest[0], 1) if len(rest) > 1 else 1
    return None


class Climbs:
    """Notes who calls into a room above its own; a profile function."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_back is not None:
            below, above = (str(one.f_globals.get("__name__", "")) for one in (frame.f_back, frame))
            low, high = height(below), height(above)
            if low is not None and high is not None and high > low:
                self.calls.append(f"{below} calls {above}.{frame.f_code.co_name}")


@pytest.mark.parametrize("name", ["microscope", "paper-dbc", "moteus", "robstride"])
def test_the_way_leads_back_up_at_most_three_times(name: str) -> None:
    file = RIGS / f"{name}.toml"
    climbs, kept = Climbs(), sys.getprofile()
    host_layout(load_rig(file), file.parent)  # what is imported on the way is not the way
    sys.setprofile(climbs)
    try:
        host_layout(load_rig(file), file.parent)
    finally:
        sys.setprofile(kept)
    assert 1 <= len(climbs.calls) <= MOST, climbs.calls
