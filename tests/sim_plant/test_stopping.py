"""How a CiA 402 drive comes to rest: 605Ah to 605Eh, the decelerations, the torque slope; following error; inputs."""

from pathlib import Path
from typing import NamedTuple

import pytest

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, DriveState, Emergency
from drivers.frame import Frame
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.motion_drive import CSP, CST, CSV, HOME_SWITCH, INTERLOCK, PV, TQ
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.servo import ServoDrive
from sim_plant.drives.stopping import ABSENT, OPTIONS, TorqueRamp
from tests.support.foreign_drive import CST_DRIVE, I16, U16, U32, Fact, eds_text
from tests.support.motion_line import MS, NODE, Line

SLOW, QUICK = 100_000, 500_000  # counts/s^2: 6084h, 6085h
RUN = 10_000  # counts/s
SLOPE = 10_000  # thousandths of the rated torque per second: 6087h
OPTION_VALUES = {0x605A: 6, 0x605B: 1, 0x605C: 1, 0x605D: 1, 0x605E: 2}
HAS_OPTIONS = {(index, 0): Fact(I16, "rw", str(value)) for index, value in OPTION_VALUES.items()} | {
    (0x6084, 0): Fact(U32, "rw", str(SLOW)),
    (0x6085, 0): Fact(U32, "rw", str(QUICK)),
    (0x6087, 0): Fact(U32, "rw", str(SLOPE)),
    (0x6065, 0): Fact(U32, "rw", "100"),
    (0x6066, 0): Fact(U16, "rw", "5"),
    (0x6062, 0): Fact(0x4, "ro"),
    (0x60F4, 0): Fact(0x4, "ro"),
}
SHUTDOWN, DISABLE, QUICK_STOP, HALT, ENABLE = 0x06, 0x07, 0x02, 0x10F, 0x0F
S = DriveState


@pytest.fixture
def line(tmp_path: Path) -> Line:
    return Line(tmp_path, more=HAS_OPTIONS)


def running(line: Line, mode: int = PV) -> Line:
    """At RUN counts/s, or under half the rated torque (1 N m)."""
    line.enable(mode)
    if mode in (TQ, CST):
        assert line.write(0x6071, 500, 2) == 0
        line.send(0x080)
        line.pass_time(100)
        assert line.servo.force == 1.0
    else:
        assert line.write(0x60FF, RUN, 4) == 0
        line.send(0x080)
        line.pass_time(100)
        assert line.speed == RUN
    return line


def milliseconds_until(line: Line, state: DriveState) -> int:
    for passed in range(1000):
        if line.drive.state is state:
            return passed
        line.pass_time(1)
    raise AssertionError(line.drive.state)


SLOWLY, QUICKLY = RUN * 1000 // SLOW, RUN * 1000 // QUICK  # ms from RUN to rest


class Case(NamedTuple):
    """A value of an option, the controlword that it is for, the states then and at the end, and ms until that."""

    index: int
    value: int
    word: int
    meanwhile: DriveState
    end: DriveState
    passes: int


STOPS = [
    Case(0x605A, 0, QUICK_STOP, S.SWITCH_ON_DISABLED, S.SWITCH_ON_DISABLED, 0),
    Case(0x605A, 1, QUICK_STOP, S.QUICK_STOP, S.SWITCH_ON_DISABLED, SLOWLY),
    Case(0x605A, 2, QUICK_STOP, S.QUICK_STOP, S.SWITCH_ON_DISABLED, QUICKLY),
    Case(0x605A, 3, QUICK_STOP, S.SWITCH_ON_DISABLED, S.SWITCH_ON_DISABLED, 0),
    Case(0x605A, 4, QUICK_STOP, S.SWITCH_ON_DISABLED, S.SWITCH_ON_DISABLED, 0),
    Case(0x605B, 0, SHUTDOWN, S.READY_TO_SWITCH_ON, S.READY_TO_SWITCH_ON, 0),
    Case(0x605B, 1, SHUTDOWN, S.OPERATION_ENABLED, S.READY_TO_SWITCH_ON, SLOWLY),
    Case(0x605C, 0, DISABLE, S.SWITCHED_ON, S.SWITCHED_ON, 0),
    Case(0x605C, 1, DISABLE, S.OPERATION_ENABLED, S.SWITCHED_ON, SLOWLY),
]


@pytest.mark.parametrize("case", STOPS, ids=lambda case: f"{case.index:X}h = {case.value}")
@pytest.mark.parametrize("mode", [PV, CSV])
def test_a_motion_ends_in_the_time_and_state_that_the_option_says(mode: int, case: Case, line: Line) -> None:
    running(line, mode)
    assert line.write(case.index, case.value, 2) == line.write(0x6040, case.word, 2) == 0
    assert line.drive.state is case.meanwhile
    line.pass_time(1)
    lets_go = case.value == 0
    if case.passes:
        assert line.speed == pytest.approx(RUN * (1 - 1 / case.passes), abs=2)
    else:
        assert line.speed == (pytest.approx(RUN, rel=0.01) if lets_go else 0)
    assert milliseconds_until(line, case.end) == pytest.approx(max(0, case.passes - 1), abs=1)
    if not lets_go:
        assert line.speed == 0


@pytest.mark.parametrize(("value", "expected"), [(5, SLOWLY), (6, QUICKLY), (7, 0), (8, 0)])
def test_a_quick_stop_that_stays_holds_the_motor_until_it_is_enabled_again(
    value: int, expected: int, line: Line
) -> None:
    running(line)
    assert line.write(0x605A, value, 2) == line.write(0x6040, QUICK_STOP, 2) == 0
    for passed in range(expected + 1):
        assert (line.speed == 0) == (passed == expected)
        line.pass_time(1)
    stopped = line.position
    line.pass_time(100)
    assert (line.drive.state, line.position) == (S.QUICK_STOP, stopped)
    assert line.write(0x6040, ENABLE, 2) == 0  # transition 16
    line.pass_time(100)
    assert (line.drive.state, line.speed) == (S.OPERATION_ENABLED, RUN)


def test_a_quick_stop_on_its_way_out_cannot_be_taken_back_but_ended(line: Line) -> None:
    running(line)
    assert line.write(0x605A, 2, 2) == line.write(0x6040, QUICK_STOP, 2) == line.write(0x6040, ENABLE, 2) == 0
    assert line.drive.state is S.QUICK_STOP
    assert line.write(0x6040, 0, 2) == 0  # disable voltage: it runs out
    line.pass_time(1)
    assert line.drive.state is S.SWITCH_ON_DISABLED
    assert line.speed == pytest.approx(RUN, rel=0.01)


def test_disabling_is_taken_back_by_enabling_while_it_slows_down(line: Line) -> None:
    running(line)
    assert line.write(0x6040, DISABLE, 2) == 0
    line.pass_time(SLOWLY // 2)
    assert line.speed == RUN // 2
    assert line.write(0x6040, ENABLE, 2) == 0
    line.pass_time(SLOWLY)
    assert (line.drive.state, line.speed) == (S.OPERATION_ENABLED, RUN)


@pytest.mark.parametrize(("value", "expected"), [(1, SLOWLY), (2, QUICKLY), (3, 0), (4, 0)])
def test_halt_stays_enabled_stands_and_goes_on(value: int, expected: int, line: Line) -> None:
    running(line)
    assert line.write(0x605D, value, 2) == line.write(0x6040, HALT, 2) == 0
    if expected:
        line.pass_time(expected - 1)
        assert line.speed > 0
        line.pass_time(1)
    assert line.speed == 0
    line.pass_time(100)
    assert line.drive.state is S.OPERATION_ENABLED
    assert line.word & 0x0400  # halted: target reached means that it stands
    assert line.write(0x6040, ENABLE, 2) == 0
    line.pass_time(100)
    assert line.speed == RUN


def test_shutting_down_while_halted_is_not_held_up(line: Line) -> None:
    running(line)
    assert line.write(0x605B, 0, 2) == line.write(0x6040, HALT, 2) == line.write(0x6040, SHUTDOWN | 0x100, 2) == 0
    assert line.drive.state is S.READY_TO_SWITCH_ON


@pytest.mark.parametrize(("value", "expected"), [(0, 0), (1, SLOWLY), (2, QUICKLY), (3, 0), (4, 0)])
def test_a_fault_brings_the_motor_to_rest_before_fault(value: int, expected: int, line: Line) -> None:
    running(line)
    assert line.write(0x605E, value, 2) == 0
    line.servo.fail()
    line.pass_time(1)
    assert line.drive.state is (S.FAULT_REACTION if expected else S.FAULT)
    assert line.word & 0x4F == (0x0F if expected else 0x08)
    assert line.emergencies == [Emergency.INTERNAL]
    if expected:
        assert line.write(0x6040, 0x80, 2) == 0  # nothing is reset before FAULT
    assert milliseconds_until(line, S.FAULT) == pytest.approx(expected, abs=1)
    assert line.speed == (0 if value else pytest.approx(RUN, rel=0.01))
    assert line.write(0x6040, 0x00, 2) == line.write(0x6040, 0x80, 2) == 0
    assert line.drive.state is S.SWITCH_ON_DISABLED
    assert line.emergencies == [Emergency.INTERNAL, Emergency.NONE]


@pytest.mark.parametrize("mode", [TQ, CST])
@pytest.mark.parametrize(
    ("index", "value", "word", "end"),
    [
        (0x605A, 2, QUICK_STOP, S.SWITCH_ON_DISABLED),
        (0x605A, 6, QUICK_STOP, S.QUICK_STOP),
        (0x605B, 1, SHUTDOWN, S.READY_TO_SWITCH_ON),
        (0x605C, 1, DISABLE, S.SWITCHED_ON),
        (0x605D, 1, HALT, S.OPERATION_ENABLED),
    ],
)
def test_a_torque_ends_by_its_slope(mode: int, index: int, value: int, word: int, end: DriveState, line: Line) -> None:
    running(line, mode)
    assert line.write(index, value, 2) == line.write(0x6040, word, 2) == 0
    line.pass_time(20)
    assert line.servo.force == pytest.approx(0.6)  # ten times the rated 2 N m per second
    assert line.write(0x6071, 900, 2) == 0  # no new target holds that up
    line.send(0x080)
    line.pass_time(29)
    assert line.servo.force == pytest.approx(0.02)
    line.pass_time(1)
    assert (line.servo.force, line.drive.state) == (0.0, end)


def test_a_torque_target_is_followed_by_its_slope_in_tq_alone(line: Line) -> None:
    line.enable(TQ)
    assert line.write(0x6071, -500, 2) == 0
    line.pass_time(1)
    line.pass_time(25)
    assert line.servo.force == pytest.approx(-0.5)
    line.enable(CST)
    assert line.write(0x6071, 500, 2) == 0
    line.send(0x080)
    assert line.servo.force == 1.0


def test_a_halted_torque_that_goes_on_stays_until_a_new_target(line: Line) -> None:
    running(line, CST)
    assert line.write(0x6040, HALT, 2) == 0
    line.pass_time(20)
    assert line.write(0x6040, ENABLE, 2) == 0
    line.pass_time(20)
    assert line.servo.force == pytest.approx(0.6)


@pytest.mark.parametrize("index", OPTION_VALUES)
def test_a_value_that_is_not_supported_aborts_and_changes_nothing(index: int, line: Line) -> None:
    key = key_of(index)
    supported = OPTIONS[key]
    for value in range(-3, 12):
        before = line.drive.dictionary.number(key)
        code = line.write(index, value, 2)
        assert code == (0 if value in supported else Abort.VALUE_RANGE)
        assert line.drive.dictionary.number(key) == (value if value in supported else before)


def test_a_makers_value_in_the_file_and_no_object_are_the_same(tmp_path: Path) -> None:
    makers = {place: fact._replace(value="-1") for place, fact in HAS_OPTIONS.items() if place[0] in OPTION_VALUES}
    for folder, more in (("makers", makers), ("none", {})):
        line = running(Line(tmp_path / folder, more=more))
        assert ABSENT.keys() == OPTIONS.keys()
        assert line.write(0x6040, QUICK_STOP, 2) == 0
        line.pass_time(1)
        assert (line.drive.state, line.speed) == (S.QUICK_STOP, 0)


def test_a_rigs_drive_ends_its_torque_by_the_slope_and_feeds_its_watchdog_meanwhile(tmp_path: Path) -> None:
    stated = CST_DRIVE | {(0x605A, 0): Fact(I16, "rw", "2"), (0x6087, 0): Fact(U32, "rw", "1000")}
    (tmp_path / "made.eds").write_text(eds_text(stated))
    servo = ServoDrive(0, 5.0, 1e-7, 10 * MS, False, 0)
    drive = Cia402Drive(NODE, servo, lambda: 0.0, eds=tmp_path / "made.eds")
    now = 0

    def write(index: int, value: int, size: int) -> None:
        data = cia301.SDO.pack(0x23 | (4 - size) << 2, index, 0, value.to_bytes(4, "little"))
        (answer,) = drive.on_frame(Frame(0x600 + NODE, data, 0, now))
        assert answer.data[0] == 0x60

    drive.advance(0)
    drive.on_frame(Frame(0x000, bytes((1, NODE)), 0, now))
    write(0x6060, cia301.TORQUE_MODE, 1)
    for word in (0x06, 0x07, 0x0F):
        write(0x6040, word, 2)
    write(0x6071, 100, 2)
    drive.on_frame(Frame(0x080, b"", 0, now))
    assert servo.force == 0.5
    write(0x6040, QUICK_STOP, 2)
    for now in range(0, 100 * MS, 5 * MS):
        write(0x6071, 0, 2)
        drive.on_frame(Frame(0x080, b"", 0, now))
        assert servo.force == pytest.approx(0.5 - 5.0 * now * 1e-9)
        assert servo.deadline_ns == now + 10 * MS
    drive.advance(100 * MS)
    assert (servo.force, drive.state) == (0.0, S.SWITCH_ON_DISABLED)


def test_a_servo_without_power_makes_no_ramp(line: Line) -> None:
    running(line, CST)
    line.servo.fail()
    line.pass_time(1)
    assert (line.drive.state, line.servo.force) == (S.FAULT, 0.0)


def test_a_ramp_goes_either_way_and_ends_at_its_goal() -> None:
    ramp = TorqueRamp()
    ramp.jump(1.0)
    ramp.head_for(-1.0, 10.0, 0)
    assert [ramp.follow(at * MS) for at in (0, 50, 100, 150)] == pytest.approx([1.0, 0.5, 0.0, -0.5])
    assert ramp.follow(250 * MS) == -1.0
    assert ramp.arrived


def cyclic_positions(line: Line, targets: list[int]) -> None:
    for target in targets:
        assert line.write(0x607A, target, 4) == 0
        line.send(0x080)
        line.pass_time(2)


def test_a_following_error_counts_after_its_time_and_is_a_fault(line: Line) -> None:
    line.enable(CSP)
    cyclic_positions(line, [0, 50, 100])
    assert (line.position, line.drive.dictionary.get(key_of(0x60F4))) == (100, 0)
    line.drive.blocked = True
    cyclic_positions(line, [150, 200])  # within the window of 100
    line.pass_time(50)
    assert line.drive.state is S.OPERATION_ENABLED
    assert line.drive.dictionary.get(key_of(0x60F4)) == 100
    assert line.drive.dictionary.get(key_of(0x6062)) == 200
    cyclic_positions(line, [250])
    line.drive.blocked = False
    cyclic_positions(line, [250])  # gone before its time of 5 ms was over
    line.drive.blocked = True
    cyclic_positions(line, [400, 400])
    assert (line.drive.state, line.word & 0x2000) == (S.OPERATION_ENABLED, 0)
    cyclic_positions(line, [400, 400])
    assert line.drive.state is S.FAULT
    assert line.word & 0x2000
    assert line.emergencies == [Emergency.FOLLOWING]
    assert line.drive.dictionary.get(key_of(0x1001)) == 0x01  # generic: not of communication
    line.drive.blocked = False
    assert line.write(0x6040, 0x80, 2) == 0
    line.pass_time(1)
    assert (line.drive.state, line.word & 0x2000) == (S.SWITCH_ON_DISABLED, 0)


@pytest.mark.parametrize("window", [0xFFFFFFFF, None])
def test_without_a_window_nothing_is_compared(window: int | None, tmp_path: Path) -> None:
    line = Line(tmp_path, more=HAS_OPTIONS if window else {})
    if window:
        assert line.write(0x6065, window, 4) == 0
    line.enable(CSP)
    line.drive.blocked = True
    cyclic_positions(line, [0, 10_000, 20_000, 30_000, 40_000])
    assert (line.drive.state, line.position) == (S.OPERATION_ENABLED, 0)


def test_a_limit_is_no_following_error(line: Line) -> None:
    line.enable(CSP)
    assert line.write(0x607D, -100, 4, 1) == line.write(0x607D, 300, 4, 2) == 0
    cyclic_positions(line, [0, 5000, 5000, 5000, 5000, 5000])
    assert (line.drive.state, line.position) == (S.OPERATION_ENABLED, 300)


def test_inputs_are_read_and_the_interlock_keeps_power_away(line: Line) -> None:
    running(line)
    line.drive.inputs = HOME_SWITCH | 0xAB0000
    line.pass_time(1)
    assert line.drive.dictionary.get(key_of(0x60FD)) == HOME_SWITCH | 0xAB0000
    assert line.drive.state is S.OPERATION_ENABLED
    line.drive.inputs = INTERLOCK
    line.pass_time(1)
    assert line.drive.state is S.SWITCH_ON_DISABLED
    for word, state in ((0x06, S.READY_TO_SWITCH_ON), (0x0F, S.READY_TO_SWITCH_ON)):
        assert line.write(0x6040, word, 2) == 0
        assert line.drive.state is state
    line.drive.inputs = 0
    assert line.write(0x6040, 0x0F, 2) == 0
    assert line.drive.state is S.OPERATION_ENABLED
