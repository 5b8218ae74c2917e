"""Where one table of a rig file bounds another: the last value that is taken, and the first that is refused."""

from pathlib import Path

import pytest

from hil.rig.file import load_rig
from hil.rig.schema import RigError
from tests.support.paths import RIGS

WAY = ["task.kind=waypoints", "task.axes=['x']"]
TIMED = ["task.kind=path", "task.axes=['x']"]
HOME = "task.injection.home"

# (rig, overrides of both, the last that is taken, the first that is refused, what is then said)
PAIRS = {
    "a value for every axis of an injection": (
        "microscope-ideal", [], f"{HOME}=[0.0, 0.0, 0.0, 0.0]", f"{HOME}=[0.0, 0.0, 0.0]",
        "task.injection.home has 3 values for 4 axes",
    ),
    "a watchdog that outlasts a period": (
        "paper", ["rate_hz=100"], "drives.watchdog_s=0.0100001", "drives.watchdog_s=0.01",
        "drives.watchdog_s = 0.01: it must be longer than the 0.01 s from one command to the next (rate_hz = 100)",
    ),
    "a weight that stands before its brake opens": (
        "microscope", [], "axes.z.limits.force_rate=122.5001", "axes.z.limits.force_rate=122.0",
        "drives.brake_opening_s = 0.02: by then axes.z.limits.force_rate = 122 lets 2.44 N stand, and the axis weighs "
        "2.45 N",
    ),
    "the watchdog that drives are told": (
        "moteus", [], "rate_hz=1000", "bus.moteus.watchdog_s=0.02",
        "bus.moteus.watchdog_s = 0.02: the drives are told another than drives.watchdog_s says",
    ),
    "the timeout of a VESC": (
        "vesc", [], "drives.watchdog_s=0.01", "drives.watchdog_s=0.0099",
        "bus.dbc.vesc.values[3]: timeout_msec may be 10 to 10; the rig relies on drives.watchdog_s = 0.0099, so it has "
        "to be above 0 and at most 9.9",
    ),
    "a VESC without a timeout": (
        "vesc", ["bus.dbc.vesc.application_signature=1"],
        'bus.dbc.vesc.values=[{value="timeout_msec",least=1,most=10}]',
        'bus.dbc.vesc.values=[{value="timeout_msec",least=0,most=10}]',
        "timeout_msec may be 0 to 10; the rig relies on drives.watchdog_s = 0.01, so it has to be above 0",
    ),
    "masses on springs": (
        "microscope", ["axes.x.model.mode_load=0.3", "axes.x.model.mode_frequency_hz=120"],
        "axes.x.model.other_modes=[[280.0, 0.01, 0.65]]", "axes.x.model.other_modes=[[280.0, 0.01, 0.66]]",
        "other_modes and mode_load carry 0.96 of the mass together: at most 0.95",
    ),
    "half a turn between two positions": (
        "vesc", [], "axes.x.limits.speed=2.4999", "axes.x.limits.speed=2.501",
        "bus.dbc.position: at axes.x.limits.speed the axis goes 0.005002 in the 0.002 s between two positions; it must "
        "be less than half of `wrap`, 0.005",
    ),
    "a position in every tick": (
        "odrive", [], "bus.dbc.feedback_period_s=0.0025025", "bus.dbc.feedback_period_s=0.0025026",
        "bus.dbc.feedback_period_s = 0.0025026: a position has to come in every tick",
    ),
    "a state within the patience for it": (
        "odrive", ["safety.disable_timeout_ticks=40"], "bus.dbc.state_period_s=0.0999", "bus.dbc.state_period_s=0.1",
        "bus.dbc.state_period_s = 0.1: a drive that is disabled has to say so within the 0.1 s of "
        "safety.disable_timeout_ticks = 40",
    ),
    "the upper end of the travel": (
        "paper", WAY, "task.waypoints=[[0.0], [1.2]]", "task.waypoints=[[0.0], [1.2000001]]",
        "task.waypoints: row 2, column x: 1.2000001 is outside axes.x.limits.position = [-1.2, 1.2]",
    ),
    "the lower end of the travel": (
        "paper", WAY, "task.waypoints=[[-1.2], [0.0]]", "task.waypoints=[[-1.2000001], [0.0]]",
        "task.waypoints: row 1, column x: -1.2000001 is outside axes.x.limits.position = [-1.2, 1.2]",
    ),
    "the far corner of a raster": (
        "paper", ["task.kind=raster", "task.axes=['x', 'y']", "task.corner=[0.5, 0.0]"],
        "task.size=[0.5, 0.1]", "task.size=[0.5, 1.5]",
        "task.corner and task.corner + task.size: row 2, column y: 1.5 is outside axes.y.limits.position",
    ),
    "the speed between two rows": (
        "paper", TIMED, "task.samples=[[0.0, 0.0], [0.125, 0.75]]", "task.samples=[[0.0, 0.0], [0.125, 0.750001]]",
        "task.samples: row 2, column x: 6.00001 /s from the row before, axes.x.limits.speed is 6",
    ),
    "the same speed backwards": (
        "paper", TIMED, "task.samples=[[1.0, 0.75], [1.125, 0.0]]", "task.samples=[[1.0, 0.75], [1.125, -0.000001]]",
        "task.samples: row 2, column x: 6.00001 /s from the row before, axes.x.limits.speed is 6",
    ),
    "the end of what repeats": (
        "paper", [*TIMED, "task.repeat=true"], "task.samples=[[0.0, 0.1], [1.0, 0.0], [2.0, 0.1]]",
        "task.samples=[[0.0, 0.1], [1.0, 0.0], [2.0, 0.2]]",
        "task.repeat = true: row 3 of task.samples must have the positions of row 1",
    ),
}  # fmt: skip


def said(rig: str, overrides: list[str]) -> str:
    """What stands against it; empty where nothing does."""
    try:
        load_rig(Path(RIGS) / f"{rig}.toml", overrides)
    except RigError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("name", PAIRS)
def test_the_last_value_is_taken_and_the_next_refused_with_both_keys(name: str) -> None:
    rig, both, taken, refused, text = PAIRS[name]
    assert said(rig, [*both, taken]) == ""
    assert text in said(rig, [*both, refused])
