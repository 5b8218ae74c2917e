"""Sampling by numbers: instants, intervals, latency and shares of every axis, against the rules written down."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.protocols import host_protocol
from drivers.protocols.base import DriveStatus, Sample
from hil.control.error_map import ErrorMap
from hil.cycle.axes import axis_inputs  # in the compiled build, those that a rig's cycle works with
from hil.cycle.drive_clock import ROUNDING_NS
from hil.cycle.fault_evidence import Evidence
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.inbox import Inbox
from hil.cycle.sampling import LATENCY_STEP_NS, Sampling
from tests.cycle.test_fault_thresholds import INNOVATION, LIMITS, PERIOD_NS, SAFETY

AXES = 2
RESOLUTION = [1e-6, 2e-6]
JUMP = [round(limit.jump_step / step) for limit, step in zip(LIMITS, RESOLUTION, strict=True)]  # counts a period


class Bench:
    """Sampling of two axes, shown one tick after the other. acts_ns: of drives that sample in their own time. wraps_ns:
    of those with clocks of their own.
    """

    def __init__(self, *acts_ns: int, wraps_ns: tuple[int, ...] = (), one_command: bool = True) -> None:
        self.inputs = [axis_inputs() for _ in range(AXES)]
        self.inbox = Inbox(host_protocol(BusConfig(), AXES, [5.0, 5.0], Path()), 100)
        self.monitor = FaultMonitor(SAFETY, LIMITS, PERIOD_NS, INNOVATION)
        self.sampling = Sampling(
            self.inputs, self.inbox, RESOLUTION, PERIOD_NS, acts_ns, wraps_ns, one_command=one_command
        )

    def tick(self, now_ns: int, *samples: tuple[int, int] | None, sent_ns: int = -1) -> None:
        """samples: stamp and counts of each axis, or None where no answer came."""
        self.monitor.begin()
        self.inbox.samples = [None if s is None else Sample(axis, s[1], 0, 0, s[0]) for axis, s in enumerate(samples)]
        self.inbox.fresh = [s is not None for s in samples]
        self.sampling.take(now_ns, now_ns - PERIOD_NS if sent_ns < 0 else sent_ns, self.monitor)

    def faults(self) -> list[Fault]:
        return [fault for fault in Fault if self.monitor.active >> fault & 1]


def test_before_the_first_sample_nothing_is_known() -> None:
    bench = Bench()
    for clock in bench.sampling.clocks:
        assert (clock.instant, clock.latency, clock.known, clock.stretch) == (0, 0, False, 1.0)
        assert (clock.trusted, clock.offset, clock.awaits_index) == (0.0, 0, False)
    assert (bench.sampling.instants, bench.sampling.starts) == ([0, 0], [0, 0])
    assert (bench.sampling.shares, bench.sampling.tracked) == ([0.0, 0.0], False)


def test_a_sample_s_instant_is_its_stamp_and_a_missing_one_s_a_period_later() -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 10), (301_000, 20))
    assert bench.sampling.instants == [300_000, 301_000]
    assert [x.position for x in bench.inputs] == [10 * RESOLUTION[0], 20 * RESOLUTION[1]]
    assert [(x.sample_interval, x.fresh, x.answered) for x in bench.inputs] == [(1e-3, 1.0, 1.0)] * 2
    bench.sampling.tracked = True
    bench.tick(2_000_000, (1_300_500, 11), None)
    assert bench.sampling.instants == [1_300_500, 1_301_000]
    assert [x.sample_interval for x in bench.inputs] == [pytest.approx(1.0005e-3, rel=1e-12), 1e-3]
    assert [(x.fresh, x.answered) for x in bench.inputs] == [(1.0, 1.0), (0.0, 1.0)]
    bench.tick(3_000_000, None, None)
    assert [(x.fresh, x.answered) for x in bench.inputs] == [(0.0, 0.0)] * 2
    assert [x.position for x in bench.inputs] == [11 * RESOLUTION[0], 20 * RESOLUTION[1]], "left as they were"


@pytest.mark.parametrize(
    ("step_ns", "stretch"),
    [(PERIOD_NS, 1.0), (3 * PERIOD_NS // 2, 1.0), (3 * PERIOD_NS // 2 + 1, 1.500001), (5 * PERIOD_NS, 5.0)],
)
def test_an_interval_is_stretched_where_more_than_half_a_slot_was_skipped(step_ns: int, stretch: float) -> None:
    bench = Bench()
    bench.sampling.tracked = True
    for axis in range(AXES):
        bench.sampling.clocks[axis].instant = 400_000
    bench.tick(1_000_000 + step_ns, (400_000 + step_ns, 0), None)
    assert [clock.stretch for clock in bench.sampling.clocks] == [pytest.approx(stretch, rel=1e-12), 1.0]
    assert bench.inputs[0].sample_interval == pytest.approx(step_ns * 1e-9, rel=1e-12)
    bench.tick(2_000_000 + step_ns, None, None)
    assert [clock.stretch for clock in bench.sampling.clocks] == [1.0, 1.0]
    assert [x.sample_interval for x in bench.inputs] == [1e-3, 1e-3]


def test_a_sample_is_taken_once() -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 10), (300_000, 20))
    bench.inbox.fresh = [False, False]
    bench.sampling.take(2_000_000, 1_000_000, bench.monitor)
    assert [(x.fresh, x.answered) for x in bench.inputs] == [(0.0, 0.0)] * 2
    assert bench.sampling.instants == [1_300_000, 1_300_000]


def test_before_the_axes_are_tracked_every_position_is_believed_and_every_interval_is_a_period() -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 0), (300_000, 0))
    bench.tick(9_000_000, (8_700_000, 9_000_000), (8_700_000, 9_000_000))
    assert bench.faults() == []
    assert [(x.sample_interval, x.fresh) for x in bench.inputs] == [(1e-3, 1.0)] * 2


def test_a_stamp_that_jumps_makes_no_interval_of_hours_and_none_below_zero() -> None:
    bench = Bench()
    bench.sampling.tracked = True
    bench.tick(1_000_000, (300_000, 0), (300_000, 0))
    bench.tick(2_000_000, (10**13, 0), (200_000, 0))
    assert [x.sample_interval for x in bench.inputs] == [0.008, 0.0], "eight periods at most"


@pytest.mark.requirement(id="SR-3.3")
def test_a_step_that_cannot_be_true_is_left_out_and_measured_from_the_last_that_was_believed() -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 0), (300_000, 0))
    bench.sampling.tracked = True
    bench.tick(2_000_000, (1_300_000, JUMP[0] + 2), (1_300_000, JUMP[1] - 2))
    assert bench.faults() == [Fault.ENCODER_GLITCH]
    assert [(x.fresh, x.position, x.answered) for x in bench.inputs] == [
        (0.0, 0.0, 1.0),
        (1.0, (JUMP[1] - 2) * RESOLUTION[1], 1.0),
    ]
    assert bench.sampling.instants == [1_300_000] * 2
    bench.tick(3_000_000, (2_300_000, 2 * JUMP[0] - 2), (2_300_000, JUMP[1]))
    assert bench.faults() == [], "two periods from the last that was believed"
    assert [x.position for x in bench.inputs] == [(2 * JUMP[0] - 2) * RESOLUTION[0], JUMP[1] * RESOLUTION[1]]


def test_a_leap_to_and_fro_leaves_nothing_behind() -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 0), (300_000, 0))
    bench.sampling.tracked = True
    bench.tick(2_000_000, (1_300_000, 9 * JUMP[0]), (1_300_000, 0))
    assert bench.faults() == [Fault.ENCODER_GLITCH]
    bench.tick(3_000_000, (2_300_000, 1), (2_300_000, 0))
    assert bench.faults() == []
    assert bench.inputs[0].position == RESOLUTION[0]


def test_nobody_answered_where_all_that_came_was_left_out() -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 0), (300_000, 0))
    bench.sampling.tracked = True
    bench.tick(2_000_000, (1_300_000, 9 * JUMP[0]), None)
    assert [x.answered for x in bench.inputs] == [0.0, 0.0]
    bench.tick(3_000_000, (2_300_000, 0), (2_300_000, 9 * JUMP[1]))
    assert [x.answered for x in bench.inputs] == [1.0, 1.0], "one believed answer will do"


# latency --------------------------------------------------------------------------------------------------------------


def test_the_first_sample_tells_the_latency_and_a_reset_forgets_it() -> None:
    bench = Bench()
    bench.tick(1_000_000, (250_000, 0), (270_000, 0))
    assert [clock.latency for clock in bench.sampling.clocks] == [250_000, 270_000]
    assert bench.sampling.starts == [1_250_000, 1_270_000]
    assert [x.ahead for x in bench.inputs] == [1e-3, 1e-3]
    bench.sampling.tracked = True
    bench.sampling.restart()
    assert not bench.sampling.tracked
    bench.tick(2_000_000, (1_900_000, 0), (1_900_000, 0))
    assert [clock.latency for clock in bench.sampling.clocks] == [900_000] * 2


@given(st.lists(st.integers(0, 500_000), min_size=1, max_size=60))
def test_the_latency_follows_its_average_in_steps(delays: list[int]) -> None:
    """The average over 64 samples in whole nanoseconds; what is used stays until it is off by more than a step."""
    bench = Bench()
    average = used = delays[0]
    for k, delay in enumerate(delays):
        sent = k * PERIOD_NS
        bench.tick(sent + PERIOD_NS, (sent + delay, 0), None, sent_ns=sent)
        average += (delay - average) // 64 if k else 0
        used = average if abs(average - used) > 1000 else used
        assert bench.sampling.clocks[0].latency == used
        assert bench.sampling.starts[0] == sent + PERIOD_NS + used
        assert bench.inputs[0].ahead == (sent + PERIOD_NS + used - (sent + delay)) * 1e-9
    assert LATENCY_STEP_NS == 1000


@pytest.mark.parametrize(("off", "used"), [(1000, 0), (1001, 1001), (-1000, 0), (-1001, -1001)])
def test_a_latency_is_followed_when_its_average_is_off_by_more_than_a_step(off: int, used: int) -> None:
    bench = Bench()
    bench.tick(1_000_000, (300_000, 0), None)
    bench.tick(2_000_000, (1_300_000 + 64 * off, 0), None)
    assert bench.sampling.clocks[0].latency == 300_000 + used


# drives that sample in their own time ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("latency", "acts", "share"),
    [(300_000, 100_000, 0.2), (300_000, 300_000, 0.0), (100_000, 300_000, 0.0), (1_600_000, 200_000, 1.0)],
)
def test_where_sampling_and_the_force_s_beginning_are_two_instants_both_are_known(
    latency: int, acts: int, share: float
) -> None:
    bench = Bench(acts, acts + 50_000)
    now = 5_000_000
    bench.tick(now, (now - PERIOD_NS + latency, 0), (now - PERIOD_NS + latency, 0))
    sampled = now - PERIOD_NS + latency
    assert bench.sampling.instants == [sampled] * 2
    assert bench.sampling.starts == [now + acts, now + acts + 50_000]
    assert [x.ahead for x in bench.inputs] == [max(0, start - sampled) * 1e-9 for start in bench.sampling.starts]
    assert bench.sampling.shares == [
        pytest.approx(share, rel=1e-12),
        pytest.approx(min(max(latency - acts - 50_000, 0) / PERIOD_NS, 1.0), rel=1e-12),
    ]


def test_of_all_other_drives_the_latest_force_acts_in_no_part_of_the_interval() -> None:
    bench = Bench()
    bench.tick(1_000_000, (900_000, 0), (900_000, 0))
    assert bench.sampling.shares == [0.0, 0.0]


# counts that begin anew -----------------------------------------------------------------------------------------------


def one_clock(*, homed: bool, stamp_ns: int, counts: int, bench: Bench) -> None:
    status = int(DriveStatus.HOMED) if homed else 0
    clock, sample = bench.sampling.clocks[0], Sample(0, counts, status, 0, stamp_ns)
    assert clock.take(0, sample, stamp_ns - 300_000, stamp_ns + 100_000, bench.monitor, tracked=False)


def test_counts_that_begin_at_the_index_go_on_where_the_axis_is_by_then() -> None:
    bench = Bench()
    clock, x = bench.sampling.clocks[0], bench.inputs[0]
    one_clock(homed=True, stamp_ns=300_000, counts=100, bench=bench)
    assert clock.offset == 0, "nobody waits for the index"
    clock.awaits_index, x.velocity_estimate = True, 0.02
    one_clock(homed=False, stamp_ns=1_300_000, counts=100, bench=bench)
    assert (clock.offset, clock.awaits_index) == (0, True), "it is not there yet"
    one_clock(homed=True, stamp_ns=2_300_000, counts=7, bench=bench)
    assert (clock.offset, clock.awaits_index) == (113, False), "20 um further, which are 20 counts"
    assert x.position == clock.trusted == pytest.approx(120e-6, rel=1e-12)
    one_clock(homed=True, stamp_ns=3_300_000, counts=9, bench=bench)
    assert (clock.offset, x.position) == (113, pytest.approx(122e-6, rel=1e-12))


def test_a_step_that_no_axis_makes_is_a_new_zero_once() -> None:
    bench = Bench()
    clock, x = bench.sampling.clocks[0], bench.inputs[0]
    one_clock(homed=False, stamp_ns=300_000, counts=100, bench=bench)
    clock.rebases = 50e-6  # m a period
    one_clock(homed=False, stamp_ns=1_300_000, counts=150, bench=bench)
    assert (clock.offset, clock.trusted) == (0, pytest.approx(150e-6, rel=1e-12)), "just what an axis may make"
    one_clock(homed=False, stamp_ns=3_300_000, counts=249, bench=bench)
    assert clock.offset == 0, "in two periods it may make twice as much"
    x.velocity_estimate = 0.01
    one_clock(homed=False, stamp_ns=4_300_000, counts=-1000, bench=bench)
    assert (clock.offset, clock.rebases) == (1259, 0.0), "10 um further, which are 10 counts"
    assert x.position == pytest.approx(259e-6, rel=1e-12)
    one_clock(homed=False, stamp_ns=5_300_000, counts=-500, bench=bench)
    assert clock.offset == 1259, "a second time it is told as it is"


def test_a_place_that_gets_another_count_stays_where_it_is() -> None:
    bench = Bench()
    clock = bench.sampling.clocks[0]
    one_clock(homed=False, stamp_ns=300_000, counts=100, bench=bench)
    assert clock.shift(5) == pytest.approx(5e-6, rel=1e-12)
    assert (clock.offset, clock.trusted) == (5, pytest.approx(105e-6, rel=1e-12))
    assert clock.shift(-7) == pytest.approx(-7e-6, rel=1e-12)
    assert (clock.offset, clock.trusted) == (-2, pytest.approx(98e-6, rel=1e-12))


# drives with clocks of their own --------------------------------------------------------------------------------------

CLOCKS = (1 << 32, 1 << 32)
EARLY_NS, LATE_NS = 200_000, 250_000  # when axis 0 and axis 1 answer, from the tick's start
OWN_NS = 3_000_000  # that their clocks are ahead by


def own_clocks(first: int, last: int, bench: Bench, *, off_ns: int = 0, sampled_ns: int = 100_000) -> None:
    """Ticks of drives that sample together; off_ns: what axis 0's stamp is wrong by."""
    bench.inbox.received_ns = [0, 0]
    for k in range(first, last):
        sent = k * PERIOD_NS
        bench.inbox.received_ns = [sent + EARLY_NS, sent + LATE_NS]
        stamp = sent + sampled_ns + OWN_NS
        bench.tick(sent + PERIOD_NS, (stamp + off_ns, k), (stamp, k), sent_ns=sent)


@pytest.mark.requirement(id="SR-3.4")
def test_a_sample_whose_stamp_cannot_be_true_is_missed_and_its_instant_is_a_period_later() -> None:
    bench = Bench(wraps_ns=CLOCKS)
    own_clocks(1, 400, bench)
    bench.sampling.tracked = True
    before = list(bench.sampling.instants)
    own_clocks(400, 401, bench, off_ns=1_000_000)
    assert bench.faults() == [Fault.STAMP]
    assert [(x.fresh, x.answered) for x in bench.inputs] == [(0.0, 1.0), (1.0, 1.0)]
    assert bench.sampling.instants == [instant + PERIOD_NS for instant in before]
    assert bench.inputs[0].position == 399 * RESOLUTION[0]


def wrong_stamps(off_ns: int) -> list[Evidence]:
    """What is flagged where axis 0's stamp is wrong by so much."""
    bench = Bench(wraps_ns=CLOCKS)
    own_clocks(1, 400, bench)
    own_clocks(400, 401, bench, off_ns=off_ns)
    return bench.monitor.evidence


@pytest.mark.requirement(id="SR-3.4")
def test_a_stamp_that_is_off_by_no_more_than_half_the_margin_is_a_glitch() -> None:
    """The margin: three quarters of EARLY_NS. How far the bound is from the true stamp, the greatest jump tells."""
    ((_, axis, beyond, limit),) = wrong_stamps(1_000_000)
    assert (axis, limit) == (0, 0.0)
    assert 0.85e-3 < beyond < 1e-3
    at = 1_000_000 - round(beyond * 1e9) + 75_000
    (most,), (more,) = wrong_stamps(at), wrong_stamps(at + 1)
    assert (most.fault, most.value) == (Fault.STAMP_GLITCH, pytest.approx(75e-6, rel=1e-12))
    assert (more.fault, more.value) == (Fault.STAMP, pytest.approx(75.001e-6, rel=1e-12))


def test_nobody_answered_where_no_stamp_can_be_true() -> None:
    bench = Bench(wraps_ns=CLOCKS)
    own_clocks(1, 400, bench)
    sent = 400 * PERIOD_NS
    bench.inbox.received_ns = [sent + EARLY_NS, sent + LATE_NS]
    bench.tick(sent + PERIOD_NS, (sent, 0), (sent, 0), sent_ns=sent)
    assert [(x.fresh, x.answered) for x in bench.inputs] == [(0.0, 0.0)] * 2


@pytest.mark.parametrize(("late_ns", "own"), [(0, True), (1, False)])
def test_an_answer_that_came_no_later_than_the_command_tells_a_clock_nothing(late_ns: int, own: bool) -> None:
    bench = Bench(wraps_ns=CLOCKS)
    bench.inbox.received_ns = [PERIOD_NS + late_ns] * AXES
    stamp = PERIOD_NS + OWN_NS
    bench.tick(2 * PERIOD_NS, (stamp, 0), (stamp, 0), sent_ns=PERIOD_NS)
    assert [instant == stamp for instant in bench.sampling.instants] == [own, own]


def test_on_a_shared_clock_it_is_no_matter_when_an_answer_came() -> None:
    bench = Bench()
    bench.inbox.received_ns = [PERIOD_NS + EARLY_NS] * AXES
    bench.tick(2 * PERIOD_NS, (PERIOD_NS, 0), (PERIOD_NS, 0), sent_ns=PERIOD_NS)
    assert bench.sampling.instants == [PERIOD_NS, PERIOD_NS]


@pytest.mark.requirement(id="SR-3.4")
def test_after_a_reset_the_drives_may_have_other_clocks() -> None:
    bench = Bench(wraps_ns=CLOCKS)
    own_clocks(1, 400, bench)
    bench.sampling.restart()
    own_clocks(400, 401, bench, off_ns=1_000_000)
    assert bench.faults() == []
    assert [x.fresh for x in bench.inputs] == [1.0, 1.0]


@pytest.mark.parametrize(("one_command", "last_ns"), [(True, EARLY_NS), (False, LATE_NS)])
def test_drives_that_sample_at_one_command_have_done_so_before_the_first_answer(
    one_command: bool, last_ns: int
) -> None:
    """So axis 1, which answers later, is held to axis 0's answer. On a segment of its own it has its own command."""
    bench = Bench(wraps_ns=CLOCKS, one_command=one_command)
    own_clocks(1, 2, bench, sampled_ns=LATE_NS - 1_000)
    behind = [instant - PERIOD_NS for instant in bench.sampling.instants]
    assert behind == [EARLY_NS + ROUNDING_NS, last_ns + ROUNDING_NS]


def test_one_drive_with_a_clock_of_its_own_is_held_to_the_first_answer_of_all() -> None:
    bench = Bench(wraps_ns=(0, CLOCKS[1]))
    own_clocks(1, 2, bench, sampled_ns=LATE_NS - 1_000)
    assert bench.sampling.instants[1] - PERIOD_NS == EARLY_NS + ROUNDING_NS


def test_the_error_map_is_of_positions_in_metres() -> None:
    bench = Bench()
    maps = [ErrorMap([0.0, 1e-3], [0.0, 1e-5]), None]
    bench.sampling = Sampling(bench.inputs, bench.inbox, RESOLUTION, PERIOD_NS, one_command=True, maps=maps)
    bench.tick(1_000_000, (300_000, 500), (300_000, 500))
    assert [x.position for x in bench.inputs] == [pytest.approx(5.05e-4, rel=1e-12), 1e-3]
