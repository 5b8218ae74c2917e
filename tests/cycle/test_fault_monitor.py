"""The fault monitor where a mistake is seen by nobody but a person at a rig: what it forgets, whom it names, and how
far an axis may go that is on its way back.
"""

import math
from collections.abc import Sequence

import pytest

from drivers.bus.counters import PortCounters
from drivers.protocols.base import DriveStatus, Sample
from hil.cycle.fault_evidence import AxisLimits
from hil.cycle.fault_monitor import RECORDER_FIRST_NS, FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.rest_watch import SETTLED_S
from hil.cycle.state_machine import State
from hil.cycle.tick import Tick
from tests.cycle.test_fault_thresholds import (
    AXIS,
    INNOVATION,
    LIMIT,
    LIMITS,
    PERIOD_NS,
    SAFETY,
    WELL,
    Bench,
    Seen,
    beyond,
)

SWITCHED = int(DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH)
ENABLED = int(DriveStatus.ENABLED)


def of_axes(limits: Sequence[AxisLimits]) -> Bench:
    """A bench whose axes have these limits."""
    bench = Bench()
    bench.monitor = FaultMonitor(SAFETY, limits, PERIOD_NS, INNOVATION)
    return bench


def says(bench: Bench, fault: Fault) -> list[tuple[int, float]]:
    """Axis and measured value of each time that the fault was flagged in this tick."""
    return [(found.axis, found.value) for found in bench.monitor.evidence if found.fault is fault]


# what is believed, and what is forgotten ------------------------------------------------------------------------------


def test_a_sample_beyond_what_the_axis_can_do_is_not_believed() -> None:
    monitor = Bench().monitor
    assert monitor.implausible(AXIS, beyond(LIMIT.jump_step), 1.0)
    assert not monitor.implausible(AXIS, LIMIT.jump_step, 1.0)


def test_behind_a_reset_two_leaps_are_a_jump_as_ever() -> None:
    bench, leap = Bench(), Seen(step=beyond(LIMIT.jump_step))
    bench.monitor.restart()
    assert [bench.show(leap) for _ in range(2)] == [{Fault.ENCODER_GLITCH}, {Fault.ENCODER_JUMP}]
    bench.monitor.restart()
    assert bench.show(leap) == {Fault.ENCODER_GLITCH}, "the leaps before it do not count"


@pytest.mark.parametrize("counter", ["no_ack", "refused"])
def test_traffic_without_trouble_is_no_part_of_a_streak(counter: str) -> None:
    bench, streak = Bench(), {"no_ack": 2, "refused": SAFETY.transmit_refused_limit}[counter]
    mild = {Fault.TRANSMIT_REFUSED} if counter == "refused" else set()
    for between in (WELL, Seen(counted={"sent": 1})):
        assert bench.show(between) == set()
        for _ in range(streak - 1):
            assert bench.show(Seen(counted={counter: 1})) == mild
    assert bench.show(Seen(counted={counter: 1})) > mild


@pytest.mark.requirement(id="SR-4.3")
def test_swings_of_the_run_before_do_not_make_an_oscillation_of_this_one() -> None:
    bench, off = Bench(), LIMIT.oscillation
    for k in range(3):  # the third turning point would be enough
        for _ in range(10):
            assert bench.show(Seen(setpoint=-off if k % 2 else off)) == set()
    bench.monitor.restart()
    assert bench.show(Seen(setpoint=-off)) == set()


@pytest.mark.parametrize(("half_period_s", "seen"), [(0.09, True), (0.11, False)])
def test_what_turns_more_slowly_than_five_hertz_is_the_task_at_the_rigs_own_rate(
    half_period_s: float, seen: bool
) -> None:
    bench, off, ticks = Bench(), LIMIT.oscillation, round(half_period_s * 1e9 / PERIOD_NS)
    shown = [bench.show(Seen(setpoint=-off if k // ticks % 2 else off)) for k in range(5 * ticks)]
    assert set().union(*shown) == ({Fault.OSCILLATION} if seen else set())


def test_a_run_that_begins_at_a_later_index_has_missed_nothing() -> None:
    monitor = FaultMonitor(SAFETY, LIMITS, PERIOD_NS, INNOVATION)
    for index in (7, 8):
        monitor.check_timing(Tick(index, index * PERIOD_NS, index * PERIOD_NS, PortCounters()))
    assert monitor.active == 0
    monitor.check_timing(Tick(10, 10 * PERIOD_NS, 10 * PERIOD_NS, PortCounters()))
    assert [(found.fault, found.value) for found in monitor.evidence] == [(Fault.OVERRUN, 1.0)]


@pytest.mark.requirement(id="SR-5.2")
def test_where_an_axis_is_seen_first_after_a_reset_is_where_it_rests() -> None:
    bench, window = Bench(), round(LIMIT.rest_window / LIMIT.resolution)

    def rests(position: int) -> list[tuple[int, float]]:
        bench.inbox.samples = [None, Sample(AXIS, position, 0, 0, 0)]
        bench.monitor.begin()
        bench.monitor.check_rest(bench.inbox)
        assert len(says(bench, Fault.AXIS_MOVED)) == len(says(bench, Fault.STANDSTILL)), "it is no run's coasting"
        return says(bench, Fault.STANDSTILL)

    for start in (0, 100 * window):
        assert [rests(start), rests(start), rests(start)] == [[], [], []]
        bench.monitor.restart()
    assert rests(0) == []
    moved = [rests(2 * window * k) for k in range(1, 4)]
    assert moved[-1] == [(AXIS, pytest.approx(6 * window * LIMIT.resolution))]
    settled = round(SETTLED_S * 1e9) // PERIOD_NS
    assert [bool(rests(6 * window)) for _ in range(settled + 2)] == [True] * settled + [False] * 2
    assert [rests(8 * window), bool(rests(10 * window))] == [[], True]
    bench.inbox.fresh[AXIS] = False  # a tick that brings no sample is a tick all the same
    assert [bool(rests(0)) for _ in range(settled + 2)] == [True] * (settled - 1) + [False] * 3


def test_an_axis_that_coasts_behind_a_run_has_moved_and_is_no_fault_of_standstill() -> None:
    bench, window = Bench(), round(LIMIT.rest_window / LIMIT.resolution)
    bench.monitor.watch_rest(coasting=True)
    for k in range(20):
        bench.inbox.samples = [None, Sample(AXIS, 2 * window * k, 0, 0, 0)]
        bench.monitor.begin()
        bench.monitor.check_rest(bench.inbox)
        assert says(bench, Fault.STANDSTILL) == []
    assert says(bench, Fault.AXIS_MOVED) != []


def test_a_recorder_has_a_second_to_begin_and_then_none_to_be_silent_in() -> None:
    late, present = FaultMonitor(SAFETY, LIMITS, PERIOD_NS, INNOVATION), Tick(0, 0, 0, PortCounters())
    absent = Tick(0, 0, 0, PortCounters(), recorder_ok=False)

    def lost(monitor: FaultMonitor, tick: Tick) -> bool:
        monitor.begin()
        monitor.check_grants(tick)
        return bool(monitor.active >> Fault.RECORDER_LOST & 1)

    first = RECORDER_FIRST_NS // PERIOD_NS
    assert first * PERIOD_NS == 1_000_000_000
    assert [lost(late, absent) for _ in range(first + 2)] == [False] * first + [True] * 2
    assert not lost(late, present)
    assert lost(late, absent), "its second is over"


def test_every_fault_is_counted_under_its_own_name() -> None:
    bench = Bench()
    before = bench.monitor.named_counts()
    assert before == {fault.name.lower(): 0 for fault in Fault if fault is not Fault.NONE}
    for _ in range(3):
        bench.show(Seen(age=1))
        bench.monitor.worst_fault(State.ACTIVE)
    assert bench.monitor.named_counts() == {**before, "encoder_gap": 3}


# who is named ---------------------------------------------------------------------------------------------------------


def test_of_two_drives_that_stay_enabled_the_first_is_named() -> None:
    bench = Bench()
    bench.inbox.samples = [Sample(axis, 0, ENABLED, 0, 0) for axis in range(2)]
    bench.inbox.fresh = [True, True]
    for _ in range(SAFETY.disable_timeout_ticks):
        bench.monitor.begin()
        bench.monitor.check_released(bench.inbox)
    assert says(bench, Fault.DRIVE_STAYS_ENABLED) == [(0, SAFETY.disable_timeout_ticks)]


@pytest.mark.parametrize("other", [None, Sample(AXIS, 0, 0, 0, 0)])
def test_only_a_drive_that_does_not_say_it_applies_torque_is_waited_for(other: Sample | None) -> None:
    bench = Bench()
    bench.inbox.samples = [Sample(0, 0, ENABLED, 0, 0), other]
    bench.monitor.begin()
    bench.monitor.flag_not_enabled(77, bench.inbox)
    assert says(bench, Fault.ENABLE_TIMEOUT) == [(AXIS, 77.0)]


def test_an_axis_that_never_answered_hides_no_other_ones_switch_or_status() -> None:
    bench = of_axes([LIMITS[0]._replace(switches=SWITCHED), LIMIT])
    bench.inbox.samples = [None, Sample(AXIS, 0, SWITCHED | DriveStatus.FAULT, 0, 0)]
    bench.monitor.begin()
    bench.monitor.check_switches(bench.inbox, homing=False)
    bench.monitor.check_samples(bench.inbox, enabled_seen=True)
    for fault in (Fault.LIMIT_SWITCH, Fault.DRIVE_FAULT, Fault.DRIVE_DISABLED):
        assert [axis for axis, _ in says(bench, fault)] == [AXIS]
    assert bench.monitor.closed == [0, SWITCHED], "of an axis that never answered no switch is closed"


# how far an axis may go -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", [LIMIT.position_low, LIMIT.position_high])
def test_where_braking_ends_is_told_although_the_plan_ends_with_the_travel(end: float) -> None:
    bench, v = Bench(), math.copysign(0.5, end)
    assert bench.show(Seen(q=end, setpoint=end, planned=end, v=v)) == {Fault.TRAVEL_PLANNED}
    assert says(bench, Fault.TRAVEL_PLANNED) == [(AXIS, end + v * 0.5 / (2.0 * LIMIT.braking))]


@pytest.mark.requirement(id="SR-4.6")
@pytest.mark.parametrize("end", [LIMIT.position_low, LIMIT.position_high])
def test_an_axis_on_its_way_back_does_not_get_again_what_it_has_come_back(end: float) -> None:
    bench, out = Bench(), math.copysign(1.0, end)

    def at(q: float) -> set[Fault]:
        return bench.show(Seen(q=q, setpoint=q, planned=q))

    bench.monitor.allow_way_back([0.0, end + out * 0.03])
    assert [at(end + out * further) for further in (0.03, 0.02, 0.01)] == [set()] * 3
    assert at(end + out * 0.02) == {Fault.TRAVEL, Fault.TRAVEL_PLANNED}
    assert at(end) == set()
    assert at(0.0) == set()
    assert at(beyond(end)) == {Fault.TRAVEL, Fault.TRAVEL_PLANNED}, "it is back"


@pytest.mark.requirement(id="SR-4.6")
def test_the_way_back_is_of_one_activation() -> None:
    bench, q = Bench(), LIMIT.position_high + 0.03
    bench.monitor.allow_way_back([0.0, q])
    assert bench.show(Seen(q=q, setpoint=q, planned=q)) == set()
    bench.monitor.restart()
    assert bench.show(Seen(q=q, setpoint=q, planned=q)) == {Fault.TRAVEL, Fault.TRAVEL_PLANNED}


def test_an_axis_that_homes_keeps_its_room_wherever_in_it_it_goes() -> None:
    bench, place = Bench(), LIMIT.position_high + 0.03
    bench.monitor.travel[AXIS].enclose(place - 0.01, place + 0.01)
    for q in (place, place - 0.01, place + 0.01):
        assert bench.show(Seen(q=q, setpoint=q, planned=q)) == set()
    q = LIMIT.position_high
    assert bench.show(Seen(q=q, setpoint=q, planned=q)) == {Fault.TRAVEL, Fault.TRAVEL_PLANNED}
