"""Digital inputs in the signals of a DBC file: read, and believed only while they are told."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.families.dbc.host import STATE_TIMEOUT_NS
from drivers.frame import Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Sample
from hil.cycle.state_machine import State
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS
from tests.support.switch_run import assert_switch_stops

MS = 1_000_000
FILE = "example_drive.dbc"
BESIDE = "MotorFeedbackA"  # two bits beside the position, and a home switch that opens
APART = "InputsA"  # a message of their own
LIMITS = DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH


def write_file(folder: Path) -> None:
    """The supplier's file with inputs of drive A in both places."""
    text = (RIGS / FILE).read_text()
    free = ' SG_ Ends : 39|2@0+ (1,0) [0|3] "" Controller\n SG_ Home : 37|1@0+ (1,0) [0|1] "" Controller\n'
    after = ' SG_ AliveEcho : 35|4@0+ (1,0) [0|15] "" Controller\n'
    apart = 'BO_ 900 InputsA: 1 DriveA\n SG_ Ends : 7|2@0+ (1,0) [0|3] "" Controller\n\n'
    text = text.replace(after, after + free, 1).replace("CM_ ", apart + "CM_ ", 1)
    (folder / FILE).write_text(text)


def inputs(message: str, axis: int = 0) -> list[dict[str, Any]]:
    ends = [("limit_low", 1), ("limit_high", 2)]
    return [
        {"axis": axis, "input": name, "message": message, "signal": "Ends", "closed": [raw, 3]} for name, raw in ends
    ]


HOME = {"axis": 0, "input": "home", "message": BESIDE, "signal": "Home", "closed": [0]}


def rig_of(bound: list[dict[str, Any]], **of_x: Any) -> RigConfig:
    document: Any = tomllib.loads((RIGS / "paper-dbc.toml").read_text())
    document["bus"]["dbc"]["inputs"] = bound
    document["axes"]["x"] |= {key: value for key, value in of_x.items() if key != "limits"}
    document["axes"]["x"]["limits"] |= of_x.get("limits", {})
    document["plant"]["switches"] = [{"axis": "x", "low": -0.02, "high": 0.02}]
    return RigConfig.model_validate(document)


def host_of(folder: Path, *bound: dict[str, Any]) -> Any:
    write_file(folder)
    return host_layout(rig_of(list(bound)), folder)


def answered(host: Any, ends: int, home: int) -> int:
    """Status of axis 0 when its drive says that."""
    values = {"ShaftPosition": 0, "AliveEcho": 0, "Ends": ends, "Home": home, "StateBits": 0, "Checksum": 0}
    page = next(page for page in host._feedback if page.name == BESIDE)
    sample = host.decode(page.frame([values[name] for name in page.codec.names])._replace(timestamp_ns=MS))
    assert isinstance(sample, Sample)
    return sample.status


@pytest.mark.parametrize(
    ("ends", "home", "status"),
    [
        (0, 1, 0),
        (1, 1, DriveStatus.LIMIT_LOW),
        (2, 1, DriveStatus.LIMIT_HIGH),
        (3, 1, LIMITS),
        (0, 0, DriveStatus.HOME),
    ],
)
def test_inputs_beside_the_position(ends: int, home: int, status: int, tmp_path: Path) -> None:
    host = host_of(tmp_path, *inputs(BESIDE), HOME)
    assert answered(host, ends, home) == status


def test_inputs_in_a_message_of_their_own_are_believed_for_half_a_second(tmp_path: Path) -> None:
    host = host_of(tmp_path, *inputs(APART))

    def after(ticks: int) -> int:
        for _ in range(ticks):
            host.encode(Command(0, [0.0, 0.0], 0, False))
        return answered(host, 0, 0)

    assert after(1) == DriveStatus.FAULT  # not told yet
    assert not isinstance(host.decode(Frame(900, b"\x40", 0, MS)), Sample)
    assert after(1) == DriveStatus.LIMIT_LOW
    assert after(STATE_TIMEOUT_NS // MS - 1) == DriveStatus.LIMIT_LOW
    assert after(1) == DriveStatus.LIMIT_LOW | DriveStatus.FAULT


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("message", [BESIDE, APART])
def test_an_axis_that_runs_onto_a_switch_is_stopped(message: str, direction: int, tmp_path: Path) -> None:
    write_file(tmp_path)
    run = LockstepRun(rig_of(inputs(message), direction=direction, limits={"switches": True}), tmp_path)
    assert_switch_stops(run)
    while run.cycle.state is not State.FAULT:
        run.tick()


@pytest.mark.parametrize(
    ("bound", "says"),
    [
        ([], "no bit for LIMIT_LOW|LIMIT_HIGH, which axes.x.limits.switches = true needs"),
        (inputs(BESIDE)[:1], "no bit for LIMIT_HIGH"),
        (inputs(BESIDE, axis=1), "bus.dbc.inputs[0]: MotorFeedbackA belongs to the drive of position[0]"),
        (inputs(BESIDE, axis=2), "bus.dbc.inputs[0].axis = 2: 0 to 1 are there"),
        (inputs(BESIDE) * 2, "bus.dbc.inputs[2]: limit_low of axis 0 is bound twice"),
        ([{**HOME, "signal": "Hone"}], "has no signal 'Hone'"),
    ],
)
def test_what_cannot_be_meant_is_refused(bound: list[dict[str, Any]], says: str, tmp_path: Path) -> None:
    write_file(tmp_path)
    with pytest.raises(LayoutError) as caught:
        host_layout(rig_of(bound, limits={"switches": True}), tmp_path)
    assert says in str(caught.value)
