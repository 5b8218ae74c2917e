"""The jitter buffer: whatever the way there adds, knots are due as evenly as they were sent, or dropped and counted."""

from hypothesis import given
from hypothesis import strategies as st

from hil.telemetry.jitter_buffer import FIRST_NS, INTERVALS, NEW_NS, JitterBuffer

MS = 1_000_000
CLOCK = 10**15  # the sender's clock is another one


def test_a_stream_of_even_delay_is_due_two_intervals_later_than_it_asks_for() -> None:
    buffer, dues = JitterBuffer(), []
    for k in range(20):
        due = buffer.due(CLOCK + 10 * MS * k, 5 * MS, 3 * MS + 10 * MS * k)
        assert due is not None
        dues.append(due)
    assert dues[0] == 5 * MS + INTERVALS * FIRST_NS
    assert set(dues[1:]) == {5 * MS + INTERVALS * 10 * MS}
    assert buffer.delay_ns == 20 * MS
    assert (buffer.late, buffer.disordered) == (0, 0)


@given(st.lists(st.integers(0, 19 * MS), min_size=3, max_size=100))
def test_what_the_way_adds_is_taken_out_again(ways: list[int]) -> None:
    """Once a quick knot has come, all that come within two intervals are due exactly when they should."""
    buffer, absolute = JitterBuffer(), []
    for k, way in enumerate([0, 0, *ways]):
        sent = 10 * MS * k
        due = buffer.due(CLOCK + sent, 0, sent + way)
        if k < 60 and k >= 2:  # as long as the first ones are remembered
            assert due is not None
            absolute.append(sent + way + due - sent)
    assert set(absolute) == {20 * MS}
    assert buffer.late == 0 or len(ways) > 60


def test_a_knot_that_comes_after_its_time_or_behind_a_newer_one_is_dropped_and_counted() -> None:
    buffer = JitterBuffer()
    for k in range(5):
        assert buffer.due(CLOCK + 10 * MS * k, 0, 10 * MS * k)
    assert buffer.due(CLOCK + 50 * MS, 0, 50 * MS + 20 * MS) is None
    assert (buffer.late, buffer.disordered) == (1, 0)
    assert buffer.due(CLOCK + 40 * MS, 0, 71 * MS) is None  # that was on the way longer still
    assert buffer.due(CLOCK + 50 * MS, 0, 71 * MS) is None  # the same once more
    assert (buffer.late, buffer.disordered) == (1, 2)
    assert buffer.due(CLOCK + 80 * MS, 0, 80 * MS) == 20 * MS  # it goes on as if nothing had been


def test_after_a_silence_or_another_sender_it_begins_anew() -> None:
    buffer = JitterBuffer()
    buffer.due(CLOCK, 0, 0)
    buffer.due(CLOCK + 10 * MS, 0, 10 * MS)
    later = NEW_NS + 20 * MS
    assert buffer.due(CLOCK + later, 0, later + 500 * MS) == INTERVALS * FIRST_NS  # half a second more on the way
    buffer.forget()
    assert buffer.delay_ns == 0
    assert buffer.due(7, 0, later + 600 * MS) == INTERVALS * FIRST_NS


@given(st.lists(st.tuples(*[st.integers(-(2**63), 2**63 - 1)] * 2, st.integers(0, 2**62)), max_size=50))
def test_nothing_that_a_client_may_send_raises_or_is_due_in_the_past(knots: list[tuple[int, int, int]]) -> None:
    buffer, taken = JitterBuffer(), 0
    for sent, due, arrived in knots:
        left = buffer.due(sent, due, arrived)
        assert left is None or left > 0
        taken += left is not None
    assert taken + buffer.late + buffer.disordered == len(knots)
