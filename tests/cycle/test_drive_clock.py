"""A drive's clock: any offset, wrap and drift are followed; a stamp that cannot be true never becomes an instant."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.cycle.drive_clock import LEARNING, DriveClock

PERIOD_NS = 1_000_000
WRAPS = (1 << 32, 4_096_000)
SEND_NS, ANSWER_NS = 90_000, 60_000


def play(
    clock: DriveClock, wrap: int, ticks: range, offset: int, ppm: int = 0, jitter: int = 0
) -> list[tuple[int, int]]:
    """(error of the instant, how far outside) of every tick, on a drive whose clock runs by ppm too fast."""
    seen = []
    for tick in ticks:
        sent = tick * PERIOD_NS
        true = sent + SEND_NS + tick * 7919 % (jitter + 1)
        stamp = (offset + true + true * ppm // 1_000_000) % wrap
        instant = clock.instant(stamp, sent, true + ANSWER_NS)
        seen.append((instant - true, clock.outside_ns))
    return seen


@pytest.mark.requirement(id="SR-3.4")
@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from(WRAPS), st.integers(0, 1 << 62), st.sampled_from([-500, -100, 0, 100, 500]), st.integers(0, 50_000)
)
def test_any_offset_is_learnt_and_a_drift_followed_over_every_wrap(
    wrap: int, offset: int, ppm: int, jitter: int
) -> None:
    seen = play(DriveClock(wrap), wrap, range(1, 6000), offset, ppm, jitter)
    assert all(outside == 0 for _, outside in seen)
    assert max(abs(error) for error, _ in seen) <= SEND_NS + ANSWER_NS + jitter + 2000


@pytest.mark.parametrize("wrap", WRAPS)
def test_on_a_shared_clock_instants_are_the_stamps_themselves(wrap: int) -> None:
    assert {error for error, _ in play(DriveClock(wrap), wrap, range(1, 2000), 0, jitter=40_000)} == {0}


@pytest.mark.requirement(id="SR-3.4")
@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("jump", [60_000, -60_000, 100_000, -100_000, 1_000_000, -1_000_000])
def test_a_jump_is_seen_in_its_tick_and_what_comes_after_is_believed_again(wrap: int, jump: int) -> None:
    clock = DriveClock(wrap)
    play(clock, wrap, range(1, LEARNING + 100), 12_345)
    (wrong,) = play(clock, wrap, range(LEARNING + 100, LEARNING + 101), 12_345 + jump)
    assert wrong[1] > 0
    after = play(clock, wrap, range(LEARNING + 101, LEARNING + 200), 12_345)
    assert {outside for _, outside in after} == {0}
    for tick in (200, 201):  # for good: the second one is taken for a new clock
        (last,) = play(clock, wrap, range(LEARNING + tick, LEARNING + tick + 1), 12_345 + jump)
    assert last[1] == 0
    assert abs(last[0]) <= SEND_NS // 2, "the offset takes the jump up"


def test_before_enough_answers_the_window_is_the_whole_one() -> None:
    clock = DriveClock(WRAPS[0])
    play(clock, WRAPS[0], range(1, 50), 0)
    assert clock.margin_ns == 0
    play(clock, WRAPS[0], range(50, LEARNING + 10), 0)
    assert clock.margin_ns == (SEND_NS + ANSWER_NS) * 3 // 4
    clock.restart()
    assert (clock.margin_ns, clock.outside_ns) == (0, 0)


@pytest.mark.requirement(id="SR-3.4")
def test_single_jumps_far_apart_are_each_refused() -> None:
    """A new clock is two of them in a row, however many there were before."""
    clock, wrap = DriveClock(WRAPS[0]), WRAPS[0]
    play(clock, wrap, range(1, LEARNING + 100), 12_345)
    for tick in range(LEARNING + 100, LEARNING + 200, 20):
        (wrong,) = play(clock, wrap, range(tick, tick + 1), 12_345 + 1_000_000)
        assert wrong[1] > 0
        play(clock, wrap, range(tick + 1, tick + 20), 12_345)
