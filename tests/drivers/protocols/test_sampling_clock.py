"""When drives have sampled, by the times at which their answers came: to the nanosecond, over lost and late answers."""

import pytest

from drivers.frame import BRS, FD, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.protocols.sampling_clock import DELAY_LEAK_NS, DELAY_SPREAD_NS, SamplingClock

MS = 1_000_000
DATA = bytes(6)
FRAME = Frame(0x181, DATA)
ALONE = round(frame_bits(FRAME)[0] * 1000)  # ns on the wire at 1 Mbit/s
WITH_GAP = round((frame_bits(FRAME)[0] + INTERMISSION) * 1000)  # between the starts of two answers that follow


def clock(axes: int = 3) -> SamplingClock:
    return SamplingClock(axes, 1_000_000, 4_000_000, MS)


def at(time_ns: int) -> Frame:
    return FRAME._replace(timestamp_ns=time_ns)


def ticks(made: SamplingClock, count: int, delay_ns: int = 0) -> list[int]:
    """Instants found in ticks 1 to count, whose first answer comes as soon as it can after the tick's start."""
    found = []
    for tick in range(1, count + 1):
        made.trigger()
        found.append(made.instant(0, at(tick * MS + WITH_GAP + delay_ns)))
    return found


@pytest.mark.parametrize("begun", [True, False])
def test_a_sample_was_taken_before_the_first_answer_went_out(begun: bool) -> None:
    made = clock()
    if begun:
        made.trigger()
    assert made.instant(0, at(5 * MS)) == 5 * MS - WITH_GAP
    assert made.instant(1, at(5 * MS + WITH_GAP)) == 5 * MS - WITH_GAP, "that of the tick, whoever answers"
    made.trigger()
    assert made.instant(0, at(6 * MS)) == 6 * MS - WITH_GAP


def test_the_echo_of_the_trigger_says_it_exactly_until_the_next_trigger() -> None:
    made = clock()
    made.trigger()
    made.triggered(123_456)
    assert [made.instant(axis, at(900_000)) for axis in range(3)] == [123_456] * 3
    made.trigger()
    assert made.instant(0, at(2 * MS)) == 2 * MS - WITH_GAP


def test_without_a_time_of_reception_there_is_none_of_sampling() -> None:
    made = clock()
    made.trigger()
    assert made.instant(0, at(0)) == made.instant(0, at(-5)) == -1
    assert made.instant(0, at(1)) == 1 - WITH_GAP
    assert made.begun(0, at(0), MS) == made.begun(0, at(-1), MS) == -1
    assert made.begun(0, at(1), MS) == 1 - ALONE


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_where_the_usual_first_answer_is_lost_the_instant_is_that_of_the_period(lost: int) -> None:
    made = clock()
    assert ticks(made, 3) == [MS, 2 * MS, 3 * MS]
    made.trigger()
    first_to_come = at(4 * MS + (lost + 1) * WITH_GAP)
    assert made.instant(lost, first_to_come) == 4 * MS
    made.trigger()
    assert made.instant(0, at(5 * MS + WITH_GAP)) == 5 * MS


def test_more_answers_than_there_are_axes_cannot_have_gone_before() -> None:
    made = clock(axes=2)
    ticks(made, 2)
    made.trigger()
    assert made.instant(1, at(3 * MS + 3 * WITH_GAP)) == 3 * MS + DELAY_LEAK_NS  # at most one: then it was held up


@pytest.mark.parametrize("late", [0, DELAY_SPREAD_NS, DELAY_SPREAD_NS + DELAY_LEAK_NS])
def test_an_answer_that_is_a_little_late_is_believed(late: int) -> None:
    made = clock()
    ticks(made, 4)
    made.trigger()
    assert made.instant(0, at(5 * MS + WITH_GAP + late)) == 5 * MS + late


def test_an_answer_that_was_held_up_is_replaced_by_the_usual_one() -> None:
    made = clock()
    ticks(made, 4)
    made.trigger()
    assert made.instant(0, at(5 * MS + WITH_GAP + DELAY_SPREAD_NS + DELAY_LEAK_NS + 1)) == 5 * MS + DELAY_LEAK_NS


def test_a_delay_that_stays_is_followed_slowly_and_one_that_shrinks_at_once() -> None:
    made = clock()
    ticks(made, 4)
    late = DELAY_SPREAD_NS + 50 * DELAY_LEAK_NS
    found = []
    for tick in range(5, 105):
        made.trigger()
        found.append(made.instant(0, at(tick * MS + WITH_GAP + late)) - tick * MS)
    assert found[0] == DELAY_LEAK_NS
    usual = [offset for offset in found if offset != late]
    assert usual == [DELAY_LEAK_NS * k for k in range(1, len(usual) + 1)]
    assert found[-1] == late, "the leak has reached it"
    made.trigger()
    assert made.instant(0, at(105 * MS + WITH_GAP)) == 105 * MS


def test_a_bus_of_two_rates_counts_each_part_of_a_frame_at_its_own() -> None:
    frame = Frame(0x181, bytes(16), FD | BRS, 9 * MS)
    nominal, data = frame_bits(frame)
    made = SamplingClock(1, 500_000, 4_000_000, MS)
    made.trigger()
    assert made.instant(0, frame) == 9 * MS - round((nominal + INTERMISSION) * 2000 + data * 250)
    assert made.begun(0, frame, MS) == 9 * MS - round(nominal * 2000 + data * 250)


# drives that send in their own time ---------------------------------------------------------------------------------


def test_of_a_drive_in_its_own_time_the_least_delay_that_the_period_allows_is_believed() -> None:
    made = clock()
    assert made.begun(1, at(10 * MS + ALONE), 2 * MS) == 10 * MS
    assert made.begun(1, at(12 * MS + ALONE + 70_000), 2 * MS) == 12 * MS + DELAY_LEAK_NS
    assert made.begun(1, at(14 * MS + ALONE - 500), 2 * MS) == 14 * MS - 500, "earlier than thought"
    assert made.begun(1, at(18 * MS + ALONE + 10_000), 2 * MS) == 18 * MS - 500 + DELAY_LEAK_NS, "one was lost"
    assert made.begun(0, at(18 * MS + ALONE + 9), 2 * MS) == 18 * MS + 9, "each axis has its own"


@pytest.mark.parametrize(("off", "followed"), [(900_000, False), (MS - 1, False), (MS, True)])
def test_a_drive_that_begins_anew_is_followed_from_half_a_period_on(off: int, followed: bool) -> None:
    made = clock()
    made.begun(0, at(10 * MS + ALONE), 2 * MS)
    found = made.begun(0, at(12 * MS + ALONE + off), 2 * MS)
    assert found == (12 * MS + off if followed else 12 * MS + DELAY_LEAK_NS)
