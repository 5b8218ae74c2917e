"""What detectors keep from tick to tick, and of which axis: switches that open again, samples that are old, slots that
were skipped. Each case is one in which an old value or another axis' would do nearly as well.
"""

from pathlib import Path

import pytest

from drivers.bus.counters import PortCounters
from drivers.config import BusConfig
from drivers.protocols import host_protocol
from drivers.protocols.base import DriveStatus, Sample
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.inbox import Inbox
from hil.cycle.rest_watch import RestWatch
from hil.cycle.tick import Tick
from tests.cycle.test_fault_thresholds import INNOVATION, LIMITS, PERIOD_NS, SAFETY

LOW, HIGH, ENABLED = (int(bit) for bit in (DriveStatus.LIMIT_LOW, DriveStatus.LIMIT_HIGH, DriveStatus.ENABLED))
COUNT = LIMITS[0].resolution
LEAP = round(LIMITS[0].jump_step / COUNT)  # counts a tick that an axis may just go


class Bench:
    """A monitor of two axes and an inbox that says what it is told to."""

    def __init__(self) -> None:
        self.monitor = FaultMonitor(SAFETY, [LIMITS[0], LIMITS[1]._replace(home_switch=LOW)], PERIOD_NS, INNOVATION)
        self.inbox = Inbox(host_protocol(BusConfig(), 2, [5.0, 5.0], Path()), 100)
        self._index = -1
        self.inbox.samples = [Sample(axis, 0, 0, 0, 0) for axis in range(2)]

    def faults(self) -> set[Fault]:
        return {fault for fault in Fault if self.monitor.active >> fault & 1}

    def switches(self, closed: int, *, homing: bool = False) -> set[Fault]:
        """A tick in which axis 1's drive shows these."""
        self.inbox.samples[1] = Sample(1, 0, closed, 0, 0)
        self.monitor.begin()
        self.monitor.check_switches(self.inbox, homing=homing)
        return self.faults()

    def rests(self, position: int | None, *, slots: int = 1) -> set[Fault]:
        """A tick at rest with axis 0 there, or without an answer of it."""
        self._index += slots
        now_ns = self._index * PERIOD_NS
        self.inbox.fresh = [position is not None, True]
        if position is not None:
            self.inbox.samples[0] = Sample(0, position, 0, 0, 0)
        self.monitor.begin()
        self.monitor.check_timing(Tick(self._index, now_ns, now_ns, PortCounters()))
        self.monitor.check_rest(self.inbox)
        return self.faults() & {Fault.AXIS_MOVED, Fault.STANDSTILL}


@pytest.mark.requirement(id="SR-4.1")
def test_a_switch_that_was_forgiven_counts_again_once_it_has_opened() -> None:
    bench = Bench()
    assert bench.switches(HIGH) == {Fault.LIMIT_SWITCH}
    bench.monitor.forgive_switches()
    assert bench.switches(HIGH) == set()
    assert bench.switches(0) == set()
    assert bench.switches(HIGH) == {Fault.LIMIT_SWITCH}


@pytest.mark.requirement(id="SR-4.1")
def test_homing_excuses_the_switch_it_homes_on_and_not_the_other() -> None:
    bench = Bench()
    assert bench.switches(LOW, homing=True) == set()
    assert bench.switches(LOW) == set(), "the axis still stands on it"
    assert bench.switches(HIGH, homing=True) == {Fault.LIMIT_SWITCH}


def test_a_drive_that_said_it_is_enabled_and_fell_silent_does_not_go_on_saying_it() -> None:
    bench = Bench()
    bench.inbox.samples[0] = Sample(0, 0, ENABLED, 0, 0)
    bench.inbox.fresh = [False, True]
    for _ in range(2 * SAFETY.disable_timeout_ticks):
        bench.monitor.begin()
        bench.monitor.check_released(bench.inbox)
        assert bench.faults() == set()


@pytest.mark.parametrize("axis", [0, 1])
def test_silence_is_of_the_axis_that_is_silent(axis: int) -> None:
    bench = Bench()
    bench.inbox.age[axis] = SAFETY.silent_zero_ticks
    bench.monitor.begin()
    bench.monitor.check_samples(bench.inbox, enabled_seen=False)
    assert {(one.fault, one.axis) for one in bench.monitor.evidence} == {
        (fault, axis) for fault in (Fault.ENCODER_GAP, Fault.ENCODER_LOST, Fault.ENCODER_DEAD)
    }


def test_a_force_that_is_no_number_is_held_against_its_own_axis_limit() -> None:
    monitor = FaultMonitor(SAFETY, [LIMITS[0], LIMITS[1]._replace(force=7.0)], PERIOD_NS, INNOVATION)
    monitor.flag_requests([0.0, float("inf")])
    assert [(one.axis, one.limit) for one in monitor.evidence] == [(1, 7.0)]


@pytest.mark.requirement(id="SR-5.2")
def test_an_axis_whose_every_other_answer_is_lost_moves_by_what_two_ticks_allow() -> None:
    """A fast push is no leap of the encoder, as nobody takes the old sample for a new one."""
    bench = Bench()
    bench.rests(0)
    seen = [bench.rests(position) for position in (None, 2 * LEAP - 2, None, 4 * LEAP - 4, None, 6 * LEAP - 6)]
    assert Fault.AXIS_MOVED in set().union(*seen[:4])


def test_an_axis_that_came_to_rest_in_slots_that_were_skipped_rests() -> None:
    bench = Bench()
    bench.rests(0)
    moved = [bench.rests(position) for position in (400, 800, 900)]
    assert Fault.AXIS_MOVED in moved[-1]
    assert Fault.AXIS_MOVED not in bench.rests(900, slots=200)


@pytest.mark.requirement(id="SR-5.2")
def test_ticks_without_a_sample_count_in_what_a_sample_may_differ_by() -> None:
    watch = RestWatch(3e-5, 4e-4, 0.0, 1e-3)
    watch.take(0.0)
    for position in (7e-4, 1.4e-3):
        watch.pass_ticks(1)
        watch.take(position)
    assert watch.moving
