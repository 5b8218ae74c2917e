"""No layout sends a force that a drive may not be told, whatever lets it pass before."""

import math
from typing import Any

import pytest

from drivers.protocols.base import Command
from hil.rig.bus_load import rig_layout
from hil.rig.file import load_rig
from tests.support.paths import RIGS
from tests.support.two_segments import TWO

LAYOUTS = [
    ("paper", ()),
    ("paper", ("bus.protocol=stage_classic",)),
    ("paper", ("bus.protocol=cia402",)),
    ("paper", TWO),
    ("paper-dbc", ()),
    ("odrive", ()),
    ("vesc", ()),
    ("moteus", ()),
]


def layout_of(name: str, overrides: tuple[str, ...]) -> tuple[Any, list[float]]:
    rig = load_rig(RIGS / f"{name}.toml", overrides)
    return rig_layout(rig, RIGS), [axis.limits.force for axis in rig.axes.values()]


@pytest.mark.requirement(id="SR-1.1")
@pytest.mark.parametrize(("name", "overrides"), LAYOUTS)
@pytest.mark.parametrize("enable", [0, 3])
def test_a_force_is_sent_up_to_the_rated_one_and_no_further(name: str, overrides: tuple[str, ...], enable: int) -> None:
    host, rated = layout_of(name, overrides)
    for axis, limit in enumerate(rated):
        for value in (limit, -limit):
            force = [0.0] * len(rated)
            force[axis] = value
            assert host.encode(Command(0, force, enable, False))
            force[axis] = math.nextafter(value, 2.0 * value)
            with pytest.raises(ValueError, match="the gate must not let it pass"):
                host.encode(Command(0, force, enable, False))
        for value in (math.nan, math.inf, -math.inf):
            force = [0.0] * len(rated)
            force[axis] = value
            with pytest.raises(ValueError, match=f"force {value} is not within"):
                host.encode(Command(0, force, enable, False))


@pytest.mark.parametrize(("name", "overrides"), LAYOUTS)
def test_a_command_has_a_force_for_every_axis_and_for_no_other(name: str, overrides: tuple[str, ...]) -> None:
    host, rated = layout_of(name, overrides)
    for count in (0, len(rated) - 1, len(rated) + 1):
        with pytest.raises(ValueError):  # noqa: PT011
            host.encode(Command(0, [0.0] * count, 0, False))
