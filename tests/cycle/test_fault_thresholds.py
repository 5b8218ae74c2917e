"""Every row of the fault table alone, at its exact threshold: one step below nothing is flagged, at it the fault is,
with its own name, in the states it is armed in, and with its reaction.

What is expected is written down here a second time, independently of the table: a row changed by mistake, a threshold
off by one tick or by the smallest number there is, or one fault flagged in another's place turns a case red.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from drivers.bus.counters import BusState, PortCounters
from drivers.config import BusConfig
from drivers.protocols import host_protocol
from drivers.protocols.base import DriveStatus, Sample
from hil.cycle import fault_monitor
from hil.cycle.fault_evidence import AxisLimits
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.inbox import Inbox
from hil.cycle.state_machine import State
from hil.cycle.tick import Tick
from hil.rig.schema import SafetyConfig
from tests.cycle.expected_faults import BITS, DRIVES_OWN, EXPECTED

Reference = vars(fault_monitor)["Reference"]  # in the compiled build, that of native floats
PERIOD_NS = 1_000_000
SAFETY = SafetyConfig(
    silent_stop_ticks=3, silent_zero_ticks=10, bad_frame_limit=5, stuck_ticks=50, nis_ticks=20, flood_frames=12,
    transmit_refused_limit=4, overrun_streak=6, overrun_zero_s=0.02, disable_timeout_ticks=30,
)  # fmt: skip
SWITCHES = DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH
LIMITS = [
    AxisLimits(-0.5, 0.5, 0.25, 1e-3, 5e-4, 4e-4, 3.0, 8.0, 5.0),
    AxisLimits(-0.125, 0.25, 0.5, 2e-3, 1.25e-3, 8e-4, 2.0, 4.0, 5.0, int(SWITCHES)),
]
INNOVATION = [1e-4, 2e-4]
AXIS = 1  # the one that a case is about; the other one is well
LIMIT = LIMITS[AXIS]


def beyond(limit: float) -> float:
    """The next number away from zero."""
    return math.nextafter(limit, math.copysign(math.inf, limit))


@dataclass(frozen=True)
class Seen:
    """What one tick shows the detectors; the defaults are those of a tick in which all is well.

    counted: what the port's counters grew by. step: of the axis' new sample, m; None: no sample came.
    """

    slots: int = 1
    late_ns: int = 0
    bus: BusState = BusState.ERROR_ACTIVE
    counted: dict[str, int] = field(default_factory=dict)
    useless: int = 0
    realtime_ok: bool = True
    recorder_ok: bool = True
    rig_ok: bool = True
    age: int = 0
    bad_frames: int = 0
    status: int = 0
    enabled_seen: bool = False
    fresh: bool = True
    step: float = 0.0
    periods: float = 1.0
    foreign_id: int = -1
    differ: bool = False
    innovation: float = 0.0
    q: float = 0.0
    v: float = 0.0
    force: float = 0.0
    setpoint: float = 0.0
    speed: float = 0.0  # the setpoint's
    planned: float = 0.0
    following: bool = True


WELL = Seen()
LOSSES = Seen(counted={"overflow": 1}), Seen(counted={"discarded": 1})


class Bench:
    """One fault monitor, shown one tick after the other in the order of ControlCycle."""

    def __init__(self) -> None:
        self.monitor = FaultMonitor(SAFETY, LIMITS, PERIOD_NS, INNOVATION)
        self.inbox = Inbox(host_protocol(BusConfig(), 2, [5.0, 5.0], Path()), 100)
        self._index, self._now_ns, self._port = -1, 0, PortCounters()
        self.show(WELL)

    def show(self, seen: Seen, *, resting: bool = False) -> set[Fault]:
        """One tick; the faults it flags, armed or not."""
        self._index += seen.slots
        self._now_ns += seen.slots * PERIOD_NS + seen.late_ns
        counts = {name: getattr(self._port, name) + more for name, more in seen.counted.items()}
        self._port = self._port._replace(**counts, state=seen.bus)
        tick = Tick(
            self._index, self._index * PERIOD_NS, self._now_ns, self._port,
            recorder_ok=seen.recorder_ok, realtime_ok=seen.realtime_ok, rig_ok=seen.rig_ok,
        )  # fmt: skip
        inbox, monitor = self.inbox, self.monitor
        inbox.age[AXIS], inbox.bad_frames, inbox.fresh[AXIS] = seen.age, seen.bad_frames, seen.fresh
        inbox.samples = [Sample(0, 0, int(DriveStatus.ENABLED) if seen.enabled_seen else 0, 0, 0), None]
        inbox.samples[AXIS] = Sample(AXIS, 0, int(seen.status), 0, 0)
        inbox.foreign_id, inbox.differ_axis = seen.foreign_id, AXIS if seen.differ else -1
        monitor.begin()
        monitor.implausible(0, 0.0, 1.0)
        monitor.implausible(AXIS, seen.step, seen.periods)
        monitor.check_bus(tick, seen.useless)
        monitor.check_timing(tick)
        monitor.check_grants(tick)
        monitor.check_switches(inbox, homing=False)
        monitor.check_samples(inbox, seen.enabled_seen)
        if resting:
            monitor.check_released(inbox)
        else:
            still = Reference(0.0, 0.0, 0.0)
            monitor.check_filter(0, 0.0)
            monitor.check_motion(0, 0.0, 0.0, 0.0, still, 0.0, following=True)
            monitor.check_filter(AXIS, seen.innovation)
            setpoint = Reference(seen.setpoint, seen.speed, 0.0)
            monitor.check_motion(AXIS, seen.q, seen.v, seen.force, setpoint, seen.planned, following=seen.following)
        return {fault for fault in Fault if monitor.active >> fault & 1}


@dataclass(frozen=True)
class Case:
    """One way to a fault. at: what a tick shows that counts. below: the nearest that does not. ticks: how many of them
    in a row make it a fault. others: milder faults that the same sight means as well.
    """

    fault: Fault
    at: Seen
    below: Seen
    ticks: int = 1
    others: tuple[Fault, ...] = ()

    @property
    def resting(self) -> bool:
        return self.fault is Fault.DRIVE_STAYS_ENABLED


# Not the monitor's, or not of one tick: test_cycle_faults.py, test_commissioning.py, the last test here.
WHOLE_CYCLE = {
    Fault.ENABLE_TIMEOUT,
    Fault.HEARTBEAT_LOST,
    Fault.AXIS_NOT_AS_STATED,
    Fault.OSCILLATION,
    Fault.STAMP,
    Fault.STAMP_GLITCH,
    Fault.STANDSTILL,
    Fault.AXIS_MOVED,
    Fault.SENSOR_SILENT,  # those of sensors: tests/cycle/test_readings.py
    Fault.SENSOR_STUCK,
    Fault.SENSOR_RANGE,
    Fault.SENSOR_SEQUENCE,
    Fault.HOMING_FAILED,  # tests/cycle/test_homing.py
}


def motion_cases() -> Iterator[Case]:
    """Positions, speeds and forces: equal to the limit is allowed."""
    yield Case(Fault.ENCODER_GLITCH, Seen(step=beyond(LIMIT.jump_step)), Seen(step=LIMIT.jump_step))
    yield Case(Fault.ENCODER_GLITCH, Seen(step=beyond(-LIMIT.jump_step)), Seen(step=-LIMIT.jump_step))
    three = 3.0 * LIMIT.jump_step
    yield Case(Fault.ENCODER_GLITCH, Seen(step=beyond(three), periods=3.0), Seen(step=three, periods=3.0))
    early = Seen(step=beyond(LIMIT.jump_step), periods=0.5)  # a stamp that comes too soon asks for no smaller step
    yield Case(Fault.ENCODER_GLITCH, early, replace(early, step=LIMIT.jump_step))
    for end in (LIMIT.position_low, LIMIT.position_high):
        out, at_end = Seen(q=beyond(end), setpoint=end), Seen(q=end, setpoint=end)
        yield Case(Fault.TRAVEL, out, at_end, others=(Fault.TRAVEL_PLANNED,))
        yield Case(Fault.TRAVEL, replace(out, following=False), replace(at_end, following=False))
        yield Case(Fault.TRAVEL_PLANNED, Seen(planned=beyond(end)), Seen(planned=end))
        v = math.copysign(0.5, end)
        reach = end - v * 0.5 / (2.0 * LIMIT.braking)  # m: from here, at 0.5 m/s, braking ends where the travel does
        further = Seen(q=reach + (beyond(end) - end), setpoint=reach, v=v)
        yield Case(Fault.TRAVEL_PLANNED, further, replace(further, q=reach))
    for fast in (LIMIT.speed, -LIMIT.speed):
        yield Case(Fault.SPEED, Seen(v=beyond(fast)), Seen(v=fast))
        yield Case(Fault.SPEED_PLANNED, Seen(speed=beyond(fast)), Seen(speed=fast))
    yield Case(Fault.SPEED, Seen(v=math.nan, following=False), WELL)
    for off in (LIMIT.following_error, -LIMIT.following_error):
        yield Case(Fault.FOLLOWING_ERROR, Seen(setpoint=beyond(off)), Seen(setpoint=off))
        fast = Seen(speed=0.5 * LIMIT.speed)  # the limit grows with speed
        yield Case(Fault.FOLLOWING_ERROR, replace(fast, setpoint=beyond(1.5 * off)), replace(fast, setpoint=1.5 * off))
    for wrong in (INNOVATION[AXIS], -INNOVATION[AXIS]):
        at, below = Seen(innovation=beyond(wrong)), Seen(innovation=wrong)
        yield Case(Fault.FILTER_DIVERGED, at, below, ticks=SAFETY.nis_ticks)
    yield Case(Fault.NOT_FINITE, Seen(innovation=math.nan), Seen(innovation=math.inf))
    for force in (LIMIT.stuck_force, -LIMIT.stuck_force):
        weaker = Seen(force=math.nextafter(force, 0.0))
        yield Case(Fault.ENCODER_STUCK, Seen(force=force), weaker, ticks=SAFETY.stuck_ticks)


def bus_cases() -> Iterator[Case]:
    """What the port says, and what came in."""
    yield Case(Fault.BUS_PASSIVE, Seen(bus=BusState.ERROR_PASSIVE), WELL)
    yield Case(Fault.BUS_OFF, Seen(bus=BusState.BUS_OFF), WELL)
    yield Case(Fault.BUS_OFF, Seen(counted={"bus_off": 1}), Seen(counted={"errors": 1}))
    yield Case(Fault.INTERFACE_DOWN, Seen(bus=BusState.DOWN), WELL)
    yield Case(Fault.INTERFACE_DOWN, Seen(counted={"down": 1}), Seen(counted={"received": 1}))
    yield Case(Fault.NO_ACK, Seen(counted={"no_ack": 1}), Seen(counted={"sent": 1}), ticks=2)
    refused = Seen(counted={"refused": 1})
    yield Case(Fault.TRANSMIT_REFUSED, refused, Seen(counted={"restarted": 1}))
    limit, mild = SAFETY.transmit_refused_limit, (Fault.TRANSMIT_REFUSED,)
    yield Case(Fault.TRANSMIT_BLOCKED, refused, Seen(counted={"echo": 1}), ticks=limit, others=mild)
    flood = SAFETY.flood_frames
    yield Case(Fault.RECEIVE_FLOOD, Seen(useless=flood), Seen(useless=flood - 1))
    late = Seen(slots=3, useless=3 * flood)  # what piles up behind a stall is late, not a flood
    yield Case(Fault.RECEIVE_FLOOD, late, replace(late, useless=3 * flood - 1), others=(Fault.OVERRUN,))
    for lost in LOSSES:
        yield Case(Fault.RECEIVE_FLOOD, lost, Seen(counted={"sent": 1}))


def other_cases() -> Iterator[Case]:
    """Answers, drives, time and grants."""
    stop, zero, gap = SAFETY.silent_stop_ticks, SAFETY.silent_zero_ticks, Fault.ENCODER_GAP
    yield Case(Fault.ENCODER_GAP, Seen(age=1), WELL)
    yield Case(Fault.ENCODER_LOST, Seen(age=stop), Seen(age=stop - 1), others=(gap,))
    yield Case(Fault.ENCODER_DEAD, Seen(age=zero), Seen(age=zero - 1), others=(gap, Fault.ENCODER_LOST))
    limit = SAFETY.bad_frame_limit
    yield Case(Fault.BAD_FRAMES, Seen(bad_frames=limit), Seen(bad_frames=limit - 1))
    harmless = DriveStatus.TORQUE_LIMITED | DriveStatus.HOMED | DriveStatus.BRAKE
    for fault, bit in BITS.items():
        yield Case(fault, Seen(status=harmless | bit), Seen(status=harmless))
    for bit in SWITCHES:
        yield Case(Fault.LIMIT_SWITCH, Seen(status=harmless | bit), Seen(status=harmless | DriveStatus.HOME))
    yield Case(Fault.FOREIGN_COMMAND, Seen(foreign_id=0), WELL)  # NMT has identifier 0
    yield Case(Fault.ANSWERS_DIFFER, Seen(differ=True), WELL)
    enabled = Seen(enabled_seen=True, status=harmless | DriveStatus.ENABLED)
    yield Case(Fault.DRIVE_DISABLED, replace(enabled, status=harmless), enabled)
    old = replace(enabled, enabled_seen=False, fresh=False)
    yield Case(Fault.DRIVE_STAYS_ENABLED, replace(old, fresh=True), old, ticks=SAFETY.disable_timeout_ticks)
    missed, counted = Seen(slots=2), (Fault.OVERRUN,)
    yield Case(Fault.OVERRUN, missed, WELL)
    yield Case(Fault.OVERRUN_BURST, missed, WELL, ticks=SAFETY.overrun_streak, others=counted)
    long = Seen(slots=round(SAFETY.overrun_zero_s * 1e9) // PERIOD_NS)
    yield Case(Fault.OVERRUN_LONG, replace(long, late_ns=1), long, others=counted)
    yield Case(Fault.REALTIME_DENIED, Seen(realtime_ok=False), WELL)
    yield Case(Fault.RECORDER_LOST, Seen(recorder_ok=False), WELL)
    yield Case(Fault.RIG_CHANGED, Seen(rig_ok=False), WELL)


CASES = [*motion_cases(), *bus_cases(), *other_cases()]
every_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.fault.name)


def test_every_row_of_the_table_has_a_case() -> None:
    jump = {Fault.ENCODER_JUMP}  # the second glitch in a row: below
    assert {case.fault for case in CASES} | WHOLE_CYCLE | jump == set(ROWS) == set(EXPECTED)
    assert set(Fault) - set(ROWS) == {Fault.NONE}
    assert [int(fault) for fault in Fault] == list(range(1 + len(EXPECTED))), "recordings keep their meaning"


@pytest.mark.parametrize("fault", ROWS, ids=lambda fault: fault.name)
def test_every_row_says_what_is_written_here(fault: Fault) -> None:
    rule = ROWS[fault]
    assert (rule.reaction, rule.states) == EXPECTED[fault]
    assert rule.drive_latched is (fault in DRIVES_OWN)


def flagged(bench: Bench, case: Case, seen: Seen, ticks: int) -> list[set[Fault]]:
    """Milder faults of the same sight left out."""
    return [bench.show(seen, resting=case.resting) - set(case.others) for _ in range(ticks)]


@pytest.mark.requirement(id="SR-4.2")
@every_case
def test_just_below_its_threshold_it_is_never_flagged_however_long(case: Case) -> None:
    bench = Bench()
    for tick, faults in enumerate(flagged(bench, case, case.below, 3 * case.ticks + 3)):
        allowed = {Fault.OVERRUN} if case.below.slots > 1 else set()
        assert case.fault not in faults, tick
        if case.below.slots == 1 and case.fault is not Fault.NOT_FINITE:
            assert faults <= allowed, tick


@pytest.mark.requirement(id="SR-6.1")
@pytest.mark.requirement(id="SR-4.2")
@pytest.mark.requirement(id="SR-3.1")
@every_case
def test_at_its_threshold_it_is_flagged_in_that_tick_and_alone(case: Case) -> None:
    bench = Bench()
    assert flagged(bench, case, case.at, case.ticks - 1) == [set()] * (case.ticks - 1)
    assert bench.show(case.at, resting=case.resting) == {case.fault, *case.others}
    if case.fault is not Fault.ENCODER_GLITCH:
        assert case.fault in bench.show(case.at, resting=case.resting), "and stays"


@every_case
def test_a_streak_that_breaks_off_begins_anew(case: Case) -> None:
    bench = Bench()
    for clear in (lambda: bench.show(WELL, resting=case.resting), bench.monitor.restart):
        assert flagged(bench, case, case.at, case.ticks - 1) == [set()] * (case.ticks - 1)
        clear()
        assert flagged(bench, case, case.at, case.ticks - 1) == [set()] * (case.ticks - 1)
        assert bench.show(case.at, resting=case.resting) == {case.fault, *case.others}, "and is as long as ever"
        bench.show(WELL, resting=case.resting)


@every_case
def test_it_is_the_worst_where_it_is_armed_and_nothing_elsewhere(case: Case) -> None:
    bench = Bench()
    for _ in range(case.ticks):
        bench.show(case.at, resting=case.resting)
    monitor, seen = bench.monitor, bench.monitor.active
    reaction, armed = EXPECTED[case.fault]
    for state in State:
        monitor.active, counted = seen, monitor.counts[case.fault]
        worst = monitor.worst_fault(state)
        assert monitor.counts[case.fault] - counted == (state in armed)
        if state in armed:
            assert worst == (case.fault, reaction)
            blocks = reaction >= Reaction.STOP and case.fault not in DRIVES_OWN
            assert monitor.blocks_reset() is blocks
        else:
            assert worst[0] is not case.fault
            assert not monitor.active >> case.fault & 1


@pytest.mark.requirement(id="SR-3.3")
def test_the_second_glitch_in_a_row_is_a_jump_and_the_third_still_is() -> None:
    bench, off = Bench(), Seen(step=beyond(LIMIT.jump_step))
    assert [bench.show(off) for _ in range(3)] == [{Fault.ENCODER_GLITCH}, {Fault.ENCODER_JUMP}, {Fault.ENCODER_JUMP}]
    assert bench.monitor.worst_fault(State.ACTIVE)[0] is Fault.ENCODER_JUMP
    bench.show(WELL)
    assert bench.show(off) == {Fault.ENCODER_GLITCH}, "a believed sample in between ends the row"


@pytest.mark.requirement(id="SR-4.1")
def test_each_axis_has_a_streak_and_limits_of_its_own() -> None:
    """A sight that is a fault of this axis is none of the other, whose limits differ, and counts for this one alone."""
    monitor = FaultMonitor(SAFETY, LIMITS, PERIOD_NS, INNOVATION)
    for _ in range(SAFETY.nis_ticks - 1):
        monitor.check_filter(AXIS, beyond(INNOVATION[AXIS]))
    monitor.check_filter(0, beyond(INNOVATION[0]))
    assert monitor.active == 0
    monitor.check_filter(AXIS, beyond(INNOVATION[AXIS]))
    assert monitor.active == 1 << Fault.FILTER_DIVERGED


def test_a_position_that_moves_by_one_count_is_not_stuck() -> None:
    bench = Bench()
    for tick in range(3 * SAFETY.stuck_ticks):
        moved = 1e-9 * (tick // (SAFETY.stuck_ticks - 1))
        assert bench.show(Seen(force=LIMIT.stuck_force, q=moved)) == set()
    stands = [bench.show(Seen(force=LIMIT.stuck_force, q=moved)) for _ in range(SAFETY.stuck_ticks)]
    assert {Fault.ENCODER_STUCK} in stands, "until it stands still"


def test_of_two_faults_the_graver_one_counts_and_among_equals_the_first() -> None:
    pairs = [
        (Seen(status=DriveStatus.FAULT, setpoint=1.0, age=1), Fault.DRIVE_FAULT),
        (Seen(status=DriveStatus.FAULT | DriveStatus.WATCHDOG, bus=BusState.BUS_OFF), Fault.BUS_OFF),
        (Seen(status=DriveStatus.FAULT | DriveStatus.WATCHDOG), Fault.DRIVE_FAULT),
        (Seen(v=1.0, planned=1.0), Fault.SPEED),
    ]
    for seen, expected in pairs:
        bench = Bench()
        bench.show(seen)
        assert bench.monitor.worst_fault(State.ACTIVE)[0] is expected


@pytest.mark.parametrize("lost", LOSSES)
def test_frames_lost_behind_a_stall_are_no_flood_until_an_answer_has_come_after_it(lost: Seen) -> None:
    bench = Bench()  # a bus tells what was lost with the first frame after it
    assert bench.show(replace(lost, slots=2)) == {Fault.OVERRUN}
    told = [WELL, lost, replace(lost, counted={**lost.counted, "received": 1}), lost]
    assert [bench.show(seen) for seen in told] == [set(), set(), set(), {Fault.RECEIVE_FLOOD}]


@pytest.mark.parametrize("times", [1.0, math.nextafter(1.0, 0.0)])
def test_a_swing_of_just_the_limit_is_an_oscillation_and_one_below_is_none(times: float) -> None:
    bench, off = Bench(), times * LIMIT.oscillation
    shown = [bench.show(Seen(setpoint=-off if k // 10 % 2 else off)) for k in range(60)]
    first = next((k for k, flagged in enumerate(shown) if flagged), -1)
    assert first == (30 if times == 1.0 else -1)  # three swings, the first of them from the middle
    assert set().union(*shown) == ({Fault.OSCILLATION} if times == 1.0 else set())


@pytest.mark.requirement(id="SR-3.2")
@pytest.mark.parametrize("axis", range(len(LIMITS)))
def test_answers_that_differ_are_told_of_any_axis_the_first_one_included(axis: int) -> None:
    bench = Bench()
    bench.monitor.begin()
    bench.inbox.differ_axis = axis
    bench.monitor.check_samples(bench.inbox, enabled_seen=False)
    assert [(found.fault, found.axis) for found in bench.monitor.evidence] == [(Fault.ANSWERS_DIFFER, axis)]
