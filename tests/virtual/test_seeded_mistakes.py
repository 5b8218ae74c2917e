"""Mistakes in the rig of bought drives: each is caught by `hil check`, or before a task by bring-up and the push.

The drives do not know the binding (sim_plant/drives): they are as their makers' documents and EDS files say.
"""

from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import pytest

from drivers.families.moteus.registers import _NUMBER, Mode, Register
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.schema import RigConfig, RigError
from hil.virtual.lockstep import LockstepRun
from tests.support.bought_drives import EDS, ODRIVE_DBC, RIGS_OF, VESC_DBC, write_files

Document = dict[str, Any]
PATIENCE = {"enable_timeout_ticks": 60, "disable_timeout_ticks": 30}
TICKS = 330


class Mistake(NamedTuple):
    """drive: whose rig. what: in a few words. rig: changes its document. file, old, new: change a file it names.
    code: changes names of the codec's modules, as a mistake in it would.
    """

    drive: str
    what: str
    rig: Callable[[Document], Any] = lambda rig: None
    file: str = ""
    old: str = ""
    new: str = ""
    code: tuple[tuple[str, Any], ...] = ()


def codec(what: str, *code: tuple[str, Any]) -> "Mistake":
    """A mistake in the codec of moteus: names below drivers.families.moteus, and what stands there."""
    return Mistake("moteus", what, code=code)


def binding(key: str, **changes: Any) -> Callable[[Document], Any]:
    """All entries of a list in [bus.dbc]."""
    return lambda rig: [entry.update(changes) for entry in rig["bus"]["dbc"][key]]


def swapped(key: str) -> Callable[[Document], Any]:
    return lambda rig: rig["bus"]["dbc"][key].reverse()


def without(*keys: str) -> Callable[[Document], Any]:
    def change(rig: Document) -> None:
        for key in keys:
            messages = {entry["message"] for entry in rig["bus"]["dbc"].pop(key)}
            on_change = rig["bus"]["dbc"].get("on_change", [])
            rig["bus"]["dbc"]["on_change"] = [name for name in on_change if name not in messages]

    return change


def axes(**changes: Any) -> Callable[[Document], Any]:
    return lambda rig: [axis.update(changes) for axis in rig["axes"].values()]


def table(**changes: Any) -> Callable[[Document], Any]:
    """[bus.cia402]."""
    return lambda rig: rig["bus"]["cia402"].update(changes)


def moteus(**changes: Any) -> Callable[[Document], Any]:
    """[bus.moteus]."""
    return lambda rig: rig["bus"]["moteus"].update(changes)


def both(*changes: Callable[[Document], Any]) -> Callable[[Document], Any]:
    return lambda rig: [change(rig) for change in changes]


def constant(signal: str, value: int) -> Callable[[Document], Any]:
    def change(rig: Document) -> None:
        for entry in rig["bus"]["dbc"]["constant"]:
            if entry["signal"] == signal:
                entry["value"] = value

    return change


def renumbered(what: str, numbers: type[IntEnum], **changes: int) -> "Mistake":
    """A mistake in the codec of moteus: other numbers in one of its enumerations."""
    members: dict[str, int] = {member.name: member.value for member in numbers} | changes
    return codec(what, (f"layout.{numbers.__name__}", IntEnum(numbers.__name__, members)))


BIG_ENDIAN = {kind: Struct(">" + form.format[1:]) for kind, form in _NUMBER.items()}
_TORQUE, _POSITION = "Input_Torque : 0|32@1- (1,0)", "Pos_Estimate : 0|32@1- (1,0)"
_CURRENT, _PID = "Current : 7|32@0- (0.001,0)", "PID_Pos : 55|16@0- (0.02,0)"
MISTAKES = (
    # state map
    Mistake("odrive", "enable sends idle", binding("enable", on=1)),
    Mistake("odrive", "idle is taken for enabled too", both(binding("enable", on=1), binding("status", enabled=[1]))),
    Mistake("odrive", "enable and disable exchanged", binding("enable", on=1, off=8)),
    Mistake("odrive", "enable asks for a calibration", binding("enable", on=3)),
    Mistake("odrive", "no enable", without("enable")),
    Mistake("odrive", "idle means enabled", binding("status", enabled=[1])),
    Mistake("odrive", "status read as bits", binding("status", enabled=[])),
    Mistake("odrive", "state read from another signal", binding("status", signal="Procedure_Result")),
    Mistake("odrive", "state taken for an error", binding("error", signal="Axis_State")),
    # mode
    Mistake("odrive", "position control", constant("Control_Mode", 3)),
    Mistake("odrive", "velocity control", constant("Control_Mode", 2)),
    Mistake("odrive", "input not passed through", constant("Input_Mode", 0)),
    Mistake("odrive", "mode left as it is", without("constant")),
    # sign, scale, unit
    Mistake("odrive", "torque of the other sign", file=ODRIVE_DBC, old=_TORQUE, new="Input_Torque : 0|32@1- (-1,0)"),
    Mistake(
        "odrive", "position of the other sign", file=ODRIVE_DBC, old=_POSITION, new="Pos_Estimate : 0|32@1- (-1,0)"
    ),
    Mistake("odrive", "torque in mN m", binding("torque", scale=0.001)),
    Mistake("odrive", "torque in kN m", binding("torque", scale=1000.0)),
    Mistake("odrive", "no gear", axes(gear=1.0)),
    Mistake("odrive", "gear without 2 pi", axes(gear=100.0)),
    Mistake("odrive", "gear the other way round", axes(gear=1 / 628.3)),
    Mistake("odrive", "ten times too few counts", binding("position", scale=1e4)),
    Mistake("odrive", "ten times too many counts", binding("position", scale=1e6)),
    Mistake("odrive", "position in radians", binding("position", scale=1e5 / 6.2832)),
    Mistake("odrive", "position in degrees", binding("position", scale=1e5 / 360)),
    Mistake("odrive", "another encoder", axes(encoder_resolution=1e-6)),
    # what is where
    Mistake("odrive", "velocity for position", binding("position", signal="Vel_Estimate")),
    Mistake("odrive", "torques exchanged", swapped("torque")),
    Mistake("odrive", "positions exchanged", swapped("position")),
    Mistake("odrive", "torque big-endian", file=ODRIVE_DBC, old=_TORQUE, new="Input_Torque : 7|32@0- (1,0)"),
    Mistake("odrive", "position big-endian", file=ODRIVE_DBC, old=_POSITION, new="Pos_Estimate : 7|32@0- (1,0)"),
    Mistake("odrive", "torque an integer", file=ODRIVE_DBC, old="SIG_VALTYPE_ 14 Input_Torque : 1;", new=""),
    Mistake("odrive", "position an integer", file=ODRIVE_DBC, old="SIG_VALTYPE_ 9 Pos_Estimate : 1;", new=""),
    Mistake("odrive", "torque to the position input", file=ODRIVE_DBC, old=" 14 ", new=" 12 "),
    Mistake("odrive", "state to another command", file=ODRIVE_DBC, old="BO_ 7 Set", new="BO_ 6 Set"),
    Mistake("odrive", "estimates of another node", file=ODRIVE_DBC, old=" 9 ", new=" 73 "),
    Mistake("odrive", "heartbeat shorter", file=ODRIVE_DBC, old="Heartbeat0: 8", new="Heartbeat0: 7"),
    # VESC
    Mistake("vesc", "torque little-endian", file=VESC_DBC, old=_CURRENT, new="Current : 0|32@1- (0.001,0)"),
    Mistake("vesc", "torque of the other sign", file=VESC_DBC, old=_CURRENT, new="Current : 7|32@0- (-0.001,0)"),
    Mistake("vesc", "current in A", file=VESC_DBC, old=_CURRENT, new="Current : 7|32@0- (1,0)"),
    Mistake("vesc", "no torque constant", binding("torque", scale=1.0)),
    Mistake("vesc", "position little-endian", file=VESC_DBC, old=_PID, new="PID_Pos : 48|16@1- (0.02,0)"),
    Mistake("vesc", "position of the other sign", file=VESC_DBC, old=_PID, new="PID_Pos : 55|16@0- (-0.02,0)"),
    Mistake("vesc", "position from another signal", binding("position", signal="Temp_Motor")),
    Mistake("vesc", "position in turns", binding("position", scale=18_000.0)),
    Mistake("vesc", "ten times too few counts", both(binding("position", scale=5.0, wrap=1800.0))),
    Mistake("vesc", "braking current", file=VESC_DBC, old="BO_ 2147483904 ", new="BO_ 2147484160 "),
    Mistake("vesc", "speed for current", file=VESC_DBC, old="BO_ 2147483904 ", new="BO_ 2147484416 "),
    Mistake("vesc", "another VESC", file=VESC_DBC, old="BO_ 2147483904 ", new="BO_ 2147483911 "),
    Mistake("vesc", "11-bit identifiers", file=VESC_DBC, old="BO_ 2147483904 ", new="BO_ 256 "),
    Mistake("vesc", "no gear", axes(gear=1.0)),
    Mistake("vesc", "turns too fast to be counted", lambda rig: rig["axes"]["x"]["limits"].update(speed=3.0)),
    # moteus
    Mistake("moteus", "another controller", moteus(nodes=[1, 3])),
    Mistake("moteus", "controllers exchanged", moteus(nodes=[2, 1])),
    Mistake("moteus", "a timeout that the rig does not state", moteus(watchdog_s=0.1)),
    Mistake("moteus", "positions of 16 bits", moteus(position="int16")),
    Mistake("moteus", "torques of 16 bits, too coarse", moteus(torque="int16")),
    Mistake("moteus", "no gear", axes(gear=1.0)),
    Mistake("moteus", "gear without 2 pi", axes(gear=100.0)),
    Mistake("moteus", "gear the other way round", axes(gear=1 / 628.3)),
    Mistake("moteus", "another encoder", axes(encoder_resolution=1e-6)),
    Mistake("moteus", "another frame layout", lambda rig: rig["bus"].update(protocol="stage_fd")),
    renumbered("current mode", Mode, POSITION=9),
    renumbered("zero velocity mode", Mode, POSITION=12),
    codec("its own loop left on", ("layout._NO_LOOP", b"")),
    renumbered("torque to the velocity command", Register, FEEDFORWARD_TORQUE=0x21),
    renumbered("torque to its limit", Register, FEEDFORWARD_TORQUE=0x25),
    renumbered("velocity for position", Register, POSITION=0x02),
    renumbered("torque for position", Register, POSITION=0x03),
    renumbered("mode read from another register", Register, MODE=0x0B),
    codec("ten times too many counts", ("layout.COUNTS_PER_TURN", 1_000_000)),
    codec("positions in radians", ("layout.COUNTS_PER_TURN", 100_000 * 6.2832)),
    codec("positions of the other sign", ("layout.COUNTS_PER_TURN", -100_000)),
    renumbered("stopped means enabled", Mode, POSITION=0),
    codec("big-endian floats", ("registers._NUMBER", BIG_ENDIAN)),
    codec("no answer asked for", ("layout._REPLY_WANTED", 0)),
    # CiA 402
    Mistake("cia402", "another rated torque", table(rated_torque=[50.0, 5.0])),
    Mistake("cia402", "rated torque in mN m", table(rated_torque=[0.005, 0.005])),
    Mistake("cia402", "another node", table(nodes=[3, 8])),
    Mistake("cia402", "mode 0", table(write=[{"object": "6060h", "value": 0}])),
    Mistake("cia402", "another mode", table(write=[{"object": "6060h", "value": 8}])),
    Mistake("cia402", "an object it has not", table(write=[{"object": "6072h", "value": 1000}])),
    Mistake("cia402", "an RPDO for all without dummies", table(rpdo="shared")),
    Mistake("cia402", "a counter it has not", table(sync_counter="on")),
    Mistake("cia402", "not started", table(start="autostart")),
    Mistake("cia402", "gear", axes(gear=10.0)),
    Mistake("cia402", "another encoder", axes(encoder_resolution=1e-6)),
    Mistake("cia402", "the EDS of a drive without CST", file=EDS, old="DefaultValue=0x225", new="DefaultValue=0x25"),
    Mistake("cia402", "another frame layout", lambda rig: rig["bus"].update(protocol="stage_classic")),
    Mistake("cia402", "torques exchanged", table(nodes=[9, 3])),
)


def seeded(mistake: Mistake, folder: Path) -> RigConfig:
    """The rig with the mistake, its files in the folder. Raises ValueError where the rig file alone is refused."""
    write_files(folder)
    if mistake.file:
        path = folder / mistake.file
        text = path.read_text()
        assert mistake.old in text
        path.write_text(text.replace(mistake.old, mistake.new))
    rig = RIGS_OF[mistake.drive]()
    mistake.rig(rig)
    rig["safety"] = rig.get("safety", {}) | PATIENCE
    return RigConfig.model_validate(rig)


def right(drive: str, folder: Path) -> LockstepRun:
    folder.mkdir()
    return LockstepRun(seeded(Mistake(drive, "none"), folder), folder)


@pytest.mark.parametrize("drive", RIGS_OF)
def test_without_a_mistake_the_task_runs(drive: str, tmp_path: Path) -> None:
    run = right(drive, tmp_path / "right")
    while run.cycle.setpoints.trajectory is None:
        run.tick()
        assert run.index < TICKS
    assert run.cycle.state is State.ACTIVE
    assert run.cycle.supervisor.commissioning.done


@pytest.mark.requirement(id="SR-4.5")
@pytest.mark.long
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: f"{mistake.drive}: {mistake.what}")
def test_a_mistake_is_caught_before_a_task_runs(
    mistake: Mistake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = right(mistake.drive, tmp_path / "right")
    for name, value in mistake.code:
        monkeypatch.setattr(f"drivers.families.moteus.{name}", value)
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    try:
        rig = seeded(mistake, wrong)
        layout = refuse_unschedulable(rig, wrong)
        if encoder_range_problems(rig, layout):
            return
        run.cycle = ControlCycle(rig, wrong, layout)
    except (ValueError, RigError):
        return  # by `hil check`, before a bus is opened
    while run.index < TICKS and run.cycle.state not in (State.FAULT, State.ESTOP):
        run.tick()
        assert run.cycle.setpoints.trajectory is None, "the task runs"
    assert max(abs(run.true_position)) < 0.1


def test_there_are_enough_of_each_kind() -> None:
    assert len({(mistake.drive, mistake.what) for mistake in MISTAKES}) == len(MISTAKES) >= 40
