"""What every fault says it measured, of which axis and against which limit: the numbers a person is told of it."""

import math
from collections.abc import Callable

import pytest

from drivers.bus.counters import BusState
from drivers.protocols.base import DriveStatus
from hil.cycle.fault_evidence import Evidence
from hil.cycle.fault_monitor import NO_ACK_TICKS
from hil.cycle.fault_table import Fault
from hil.cycle.record import MAX_EVIDENCE, NO_AXIS
from hil.cycle.state_machine import State
from tests.cycle.expected_faults import BITS
from tests.cycle.test_fault_thresholds import (
    AXIS,
    CASES,
    INNOVATION,
    LIMIT,
    LIMITS,
    PERIOD_NS,
    SAFETY,
    Bench,
    Case,
    Seen,
)

GRANTS = {Fault.REALTIME_DENIED, Fault.RECORDER_LOST, Fault.RIG_CHANGED}  # there or not: nothing to measure


def end_of(position: float) -> float:
    return LIMIT.position_low if position < 0.0 else LIMIT.position_high


def planned(seen: Seen) -> tuple[float, float]:
    outside = seen.planned or seen.q + seen.v * abs(seen.v) / (2.0 * LIMIT.braking)
    return outside, end_of(outside)


def flood(seen: Seen) -> tuple[float, float]:
    return (seen.useless, SAFETY.flood_frames * seen.slots) if seen.useless else (1.0, 0.0)


def glitch(seen: Seen) -> tuple[float, float]:
    return abs(seen.step), LIMIT.jump_step * max(1.0, seen.periods)


def following(seen: Seen) -> tuple[float, float]:
    return abs(seen.setpoint), LIMIT.following_error * (1.0 + abs(seen.speed) / LIMIT.speed)


def bus(state: BusState) -> Callable[[Seen], tuple[float, float]]:
    return lambda seen: (state, math.nan)


# (measured, limit) in the tick in which it becomes a fault.
OF_AN_AXIS: dict[Fault, Callable[[Seen], tuple[float, float]]] = {
    Fault.ENCODER_GAP: lambda seen: (seen.age, 0.0),
    Fault.ENCODER_LOST: lambda seen: (seen.age, SAFETY.silent_stop_ticks),
    Fault.ENCODER_DEAD: lambda seen: (seen.age, SAFETY.silent_zero_ticks),
    Fault.ENCODER_GLITCH: glitch,
    Fault.ENCODER_STUCK: lambda seen: (SAFETY.stuck_ticks, SAFETY.stuck_ticks),
    Fault.FOLLOWING_ERROR: following,
    Fault.TRAVEL_PLANNED: planned,
    Fault.TRAVEL: lambda seen: (seen.q, end_of(seen.q)),
    Fault.SPEED_PLANNED: lambda seen: (abs(seen.speed), LIMIT.speed),
    Fault.SPEED: lambda seen: (abs(seen.v), LIMIT.speed),
    Fault.NOT_FINITE: lambda seen: (math.nan, INNOVATION[AXIS]),
    Fault.FILTER_DIVERGED: lambda seen: (abs(seen.innovation), INNOVATION[AXIS]),
    **{fault: lambda seen: (1.0, math.nan) for fault in BITS},
    Fault.ANSWERS_DIFFER: lambda seen: (0.0, math.nan),
    Fault.LIMIT_SWITCH: lambda seen: (0.0 if seen.status & DriveStatus.LIMIT_LOW else 1.0, math.nan),
    Fault.DRIVE_DISABLED: lambda seen: (0.0, math.nan),
    Fault.DRIVE_STAYS_ENABLED: lambda seen: (SAFETY.disable_timeout_ticks, SAFETY.disable_timeout_ticks),
}
OF_THE_RIG: dict[Fault, Callable[[Seen], tuple[float, float]]] = {
    Fault.BAD_FRAMES: lambda seen: (seen.bad_frames, SAFETY.bad_frame_limit),
    Fault.FOREIGN_COMMAND: lambda seen: (seen.foreign_id, math.nan),
    Fault.BUS_PASSIVE: bus(BusState.ERROR_PASSIVE),
    Fault.BUS_OFF: bus(BusState.BUS_OFF),
    Fault.INTERFACE_DOWN: bus(BusState.DOWN),
    Fault.NO_ACK: lambda seen: (NO_ACK_TICKS, NO_ACK_TICKS),
    Fault.TRANSMIT_REFUSED: lambda seen: (1.0, 0.0),
    Fault.TRANSMIT_BLOCKED: lambda seen: (SAFETY.transmit_refused_limit, SAFETY.transmit_refused_limit),
    Fault.RECEIVE_FLOOD: flood,
    Fault.OVERRUN: lambda seen: (seen.slots - 1, 0.0),
    Fault.OVERRUN_BURST: lambda seen: (SAFETY.overrun_streak, SAFETY.overrun_streak),
    Fault.OVERRUN_LONG: lambda seen: ((seen.slots * PERIOD_NS + seen.late_ns) * 1e-9, SAFETY.overrun_zero_s),
}


def said(bench: Bench, fault: Fault) -> list[tuple[int, float, float]]:
    return [(found.axis, found.value, found.limit) for found in bench.monitor.evidence if found.fault == fault]


@pytest.mark.requirement(id="SR-9.1")
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.fault.name)
def test_a_fault_says_what_was_measured_against_which_limit_and_of_which_axis(case: Case) -> None:
    bench = Bench()
    for _ in range(case.ticks):
        bench.show(case.at, resting=case.resting)
    found = said(bench, case.fault)
    if case.fault in GRANTS:
        assert found == []
        return
    axis, measure = (AXIS, OF_AN_AXIS) if case.fault in OF_AN_AXIS else (NO_AXIS, OF_THE_RIG)
    value, limit = measure[case.fault](case.at)
    assert found == [(axis, pytest.approx(value, rel=1e-12, nan_ok=True), pytest.approx(limit, rel=1e-12, nan_ok=True))]
    if case.ticks == 1 and case.fault is not Fault.ENCODER_GLITCH:
        before = repr(found)
        bench.show(case.at, resting=case.resting)
        assert repr(said(bench, case.fault)) == before, "of the tick alone, not of the run"


def test_what_one_tick_lost_of_two_kinds_is_added_up_and_of_earlier_ticks_not_counted() -> None:
    bench = Bench()
    bench.show(Seen(counted={"overflow": 7, "discarded": 100}))
    bench.show(Seen(counted={"overflow": 2, "discarded": 3}))
    assert said(bench, Fault.RECEIVE_FLOOD) == [(NO_AXIS, 5.0, 0.0)]
    bench.show(Seen(counted={"refused": 4}))
    assert said(bench, Fault.TRANSMIT_REFUSED) == [(NO_AXIS, 4.0, 0.0)]


def test_what_the_cycle_asks_for_says_its_numbers_too() -> None:
    bench = Bench()
    monitor, inbox = bench.monitor, bench.inbox
    monitor.begin()
    monitor.flag_not_enabled(77, inbox)
    assert said(bench, Fault.ENABLE_TIMEOUT) == [(axis, 77.0, SAFETY.enable_timeout_ticks) for axis in (0, AXIS)]
    monitor.flag_requests([1.0, -math.inf])
    assert said(bench, Fault.NOT_FINITE) == [(AXIS, -math.inf, LIMITS[AXIS].force)]
    monitor.flag_heartbeat(3_500_000_000, 500_000_000)
    monitor.flag_heartbeat(2_000_000_000, None)
    assert said(bench, Fault.HEARTBEAT_LOST) == [(NO_AXIS, s, SAFETY.heartbeat_s) for s in (3.0, 2.0)]


def test_where_a_record_has_no_room_the_gravest_are_kept_and_what_is_not_armed_is_left_out() -> None:
    bench = Bench()
    monitor = bench.monitor
    monitor.begin()
    for k in range(MAX_EVIDENCE):
        monitor.flag(Fault.ENCODER_GAP, float(k), 0.0, 0)
    monitor.flag(Fault.DRIVE_STAYS_ENABLED, 1.0, 1.0, 0)  # counts at rest alone
    monitor.worst_fault(State.ACTIVE)
    assert monitor.armed_evidence() == [Evidence(Fault.ENCODER_GAP, 0, float(k), 0.0) for k in range(MAX_EVIDENCE)]
    monitor.flag(Fault.SPEED, 1.0, 0.5, 1)
    first, *rest = monitor.armed_evidence()
    assert first == Evidence(Fault.SPEED, 1, 1.0, 0.5)
    assert [found.value for found in rest] == [float(k) for k in range(MAX_EVIDENCE)]
