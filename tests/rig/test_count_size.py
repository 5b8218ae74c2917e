"""encoder_resolution and gear of an axis are held against its drive's count, before anything moves."""

import tomllib
from typing import Any

import pytest

from drivers.protocols.base import LayoutError
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS


def judge(name: str, key: str, value: Any, **also: float) -> None:
    """Refuse a shipped rig with another value at a dotted key, and other values of axis x."""
    document: Any = tomllib.loads((RIGS / f"{name}.toml").read_text())
    document["axes"]["x"] |= also
    *way, last = key.split(".")
    place = document
    for step in way:
        place = place[int(step)] if isinstance(place, list) else place[step]
    place[last] = value
    host_layout(RigConfig.model_validate(document), RIGS)


def swapped(message: str, signal: str, **also: int) -> list[dict[str, Any]]:
    """A list of [bus.dbc] in the wrong order."""
    return [{"message": f"{message}{number}", "signal": signal, **also} for number in (1, 0)]


@pytest.mark.parametrize(
    ("rig", "gear", "also"),
    [
        ("damiao", 6.0, {"encoder_resolution": 6.3579e-05}),  # behind a gear of 6
        ("damiao", 4.5, {"encoder_resolution": 6.3579e-05}),  # of which a quarter is friction
        ("moteus", 140.0, {}),  # a screw that holds itself
        ("paper-dbc", 20.0, {}),  # the encoder is on the axis
    ],
)
def test_a_gear_with_friction_and_an_encoder_on_the_axis_are_right(
    rig: str, gear: float, also: dict[str, float]
) -> None:
    judge(rig, "axes.x.gear", gear, **also)


@pytest.mark.parametrize(
    ("rig", "key", "value", "says"),
    [
        ("damiao", "bus.mit.position", [6.28], "gear = 1 encoder_resolution has to be 0.000191653 rad"),
        ("robstride", "axes.x.encoder_resolution", 1e-4, "2/65535 of bus.mit.position = 12.57"),
        ("damiao", "axes.y.gear", 6.0, "axes.y: encoder_resolution = 0.000381476 rad, gear = 6"),
        ("moteus", "axes.x.gear", 1.0, "encoder_resolution has to be 6.28319e-05 m"),
        ("moteus", "axes.x.gear", 1.0, "a count of the drive is 6.28319e-05 rad (1/100000 of a turn)"),
        ("moteus", "axes.x.gear", 700.0, "gear has to be 628.319, or less by friction (at least 125.7)"),
        ("moteus", "axes.x.gear", 120.0, "gear has to be 628.319"),
        ("odrive", "axes.x.encoder_resolution", 1e-6, "Get_Encoder_Estimates0.Pos_Estimate is in rev"),
        ("paper-dbc", "bus.dbc.position.0.scale", 1e3, "is in um, bus.dbc.position has scale = 1000"),
        ("paper-dbc", "bus.dbc.position.0.scale", 1e3, "a count of the drive is 1e-09 m (MotorFeedbackA"),
        # what the DBC file says of nodes and forces
        ("odrive", "bus.dbc.torque.1.scale", 1e-3, "Set_Input_Torque1.Input_Torque is in N m, so its scale is 1"),
        ("odrive", "bus.dbc.status.0.message", "Heartbeat1", "status[0]: Heartbeat1 belongs to the drive of pos"),
        ("odrive", "bus.dbc.error.1.message", "Heartbeat0", "error[1]: Heartbeat0 belongs to the drive of pos"),
        ("odrive", "bus.dbc.enable", swapped("Set_Axis_State", "Axis_Requested_State"),
         "enable[0]: Set_Axis_State1 belongs to the drive of torque[1]"),
        ("odrive", "bus.dbc.reset", swapped("Clear_Errors", "Identify", on=0),
         "reset[0]: Clear_Errors1 belongs to the drive of torque[1]"),
        ("odrive", "bus.dbc.torque", swapped("Set_Input_Torque", "Input_Torque"),
         "enable[0]: Set_Axis_State0 belongs to the drive of torque[1]"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_refused_with_what_would(rig: str, key: str, value: Any, says: str) -> None:
    with pytest.raises(LayoutError) as caught:
        judge(rig, key, value)
    assert says in str(caught.value)
