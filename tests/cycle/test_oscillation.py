"""A loop that swings by itself is told from one that is disturbed, follows slowly, or measures noise."""

import math
from collections.abc import Iterable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.cycle.oscillation import LONGEST_SWING_S, OscillationDetector

RATE = 1000.0
AMPLITUDE = 1e-5


def first_seen(errors: Iterable[float], rate: float = RATE) -> int:
    """Tick of the first alarm, -1: none."""
    detector = OscillationDetector(AMPLITUDE, 1 / rate)
    for k, error in enumerate(errors):
        if k == 0:
            detector.restart(error)
        if detector.seen(error):
            return k
    return -1


def sine(frequency: float, amplitude: float, seconds: float, phase: float = 0.0, growth: float = 0.0) -> list[float]:
    """growth: of the amplitude's logarithm, 1/s."""
    return [
        amplitude * math.exp(growth * k / RATE) * math.sin(2 * math.pi * frequency * k / RATE + phase)
        for k in range(int(seconds * RATE))
    ]


@pytest.mark.requirement(id="SR-4.3")
@given(st.floats(6.0, 200.0), st.floats(0.0, 6.28), st.floats(1.15, 50.0))
def test_a_lasting_swing_is_seen_within_three_periods(frequency: float, phase: float, over: float) -> None:
    seen = first_seen(sine(frequency, over * AMPLITUDE, 1.0, phase))
    assert 0 < seen <= 3.0 * RATE / frequency + 2


@given(st.floats(60.0, 499.0), st.floats(0.0, 6.28), st.floats(2.0, 50.0))
def test_up_to_half_the_rate_it_takes_50_ms(frequency: float, phase: float, over: float) -> None:
    """Samples fall beside the turning points up there, and beat with them."""
    assert 0 < first_seen(sine(frequency, over * AMPLITUDE, 1.0, phase)) <= 50


@given(st.floats(0.1, 499.0), st.floats(0.0, 6.28), st.floats(0.0, 0.99))
def test_a_swing_below_the_amplitude_is_none(frequency: float, phase: float, under: float) -> None:
    assert first_seen(sine(frequency, under * AMPLITUDE, 0.5, phase)) == -1


def test_a_force_that_alternates_from_tick_to_tick_is_seen() -> None:
    assert 0 < first_seen([AMPLITUDE * 1.1 * (-1) ** k for k in range(20)]) <= 5


@pytest.mark.requirement(id="SR-4.3")
@given(st.floats(10.0, 200.0), st.floats(0.0, 6.28))
def test_a_growing_swing_is_seen_within_50_ms_of_reaching_the_amplitude(frequency: float, phase: float) -> None:
    growth = 0.2 * frequency  # a tenth in a swing
    errors = sine(frequency, 1e-2 * AMPLITUDE, 25.0 / frequency + 0.05, phase, growth)
    reached = next(k for k, error in enumerate(errors) if abs(error) >= 1.1 * AMPLITUDE)
    assert 0 < first_seen(errors) <= reached + 50 + RATE / frequency


@given(st.floats(0.1, 4.8), st.floats(0.0, 6.28))
def test_what_turns_more_slowly_than_five_hertz_is_the_task(frequency: float, phase: float) -> None:
    assert first_seen(sine(frequency, 100 * AMPLITUDE, 3.0, phase)) == -1


@given(st.floats(5.0, 300.0), st.floats(0.0, 6.28), st.floats(0.13, 1.0))
def test_what_a_disturbance_leaves_behind_fades_and_is_none(frequency: float, phase: float, damping: float) -> None:
    decay = -damping * 2 * math.pi * frequency  # phase margin of 15 degrees and more
    assert first_seen(sine(frequency, 100 * AMPLITUDE, 1.0, phase, decay)) == -1


@given(st.lists(st.floats(-0.49, 0.49), min_size=50, max_size=500))
def test_noise_of_half_the_amplitude_is_none_on_whatever_slow_error(noise: list[float]) -> None:
    errors = [AMPLITUDE * (n + 5 * math.sin(k / 200)) for k, n in enumerate(noise)]
    assert first_seen(errors) == -1


def plainly_seen(errors: list[float], longest: int) -> list[tuple[int, float]]:
    """The rules of hil/cycle/oscillation.py over a whole record, in amplitudes: ticks of the alarms, and how large."""
    alarms = []
    begin, turned_at, rising, before, count = 0, errors[0], 1, 0.0, 0
    for k in range(1, len(errors)):
        extreme = rising * max(rising * error for error in errors[begin:k])
        if rising * (extreme - errors[k]) < 0.25:
            continue
        swing = abs(extreme - turned_at)
        if swing < 1.0 or k - begin - 1 > longest:
            count = 0
        else:
            count = count + 1 if swing >= 0.8 * before else 1
        if count >= 3 and swing >= 2.0:
            alarms.append((k, swing / 2.0))
        begin, turned_at, rising, before = k, extreme, -rising, swing
    return alarms


EIGHTHS = st.lists(st.tuples(st.integers(-20, 20), st.integers(1, 6)), max_size=40)  # of the amplitude; ticks


@given(EIGHTHS)
@example([(8, 1), (7, 1), (6, 1), (-8, 1), (8, 1), (-8, 1), (-7, 1), (-6, 1)])  # a quarter back, and no less
@example([(8, 1), (-8, 5), (8, 4), (-8, 4), (8, 1), (-8, 5), (8, 6), (-8, 5), (8, 5), (-8, 5)])  # as slow as it may be
@example([(10, 1), (-10, 1), (6, 1), (-7, 1), (4, 1), (-7, 1), (10, 1), (-6, 1), (2, 1), (-9, 1), (7, 1), (-9, 1)])
@example([(4, 1), (-4, 1), (8, 1), (-8, 1), (9, 1), (3, 1), (-4, 1), (4, 1), (-12, 1), (12, 1)])
def test_the_detector_sees_what_its_rules_say_when_they_say_it(moves: list[tuple[int, int]]) -> None:
    errors = [0.0, *(value / 8.0 for value, ticks in moves for _ in range(ticks))]
    detector = OscillationDetector(1.0, LONGEST_SWING_S / 4.0)
    detector.restart(errors[0])
    seen = [(k, detector.swing) for k, error in enumerate(errors) if k and detector.seen(error)]
    assert seen == plainly_seen(errors, 4)


def test_a_new_beginning_forgets() -> None:
    detector = OscillationDetector(AMPLITUDE, 1 / RATE)
    errors = sine(50.0, 2 * AMPLITUDE, 1.0)
    seen = first_seen(errors)
    assert seen > 0
    for k, error in enumerate(errors[: 3 * seen]):
        if k % (seen // 2) == 0:
            detector.restart(error)
        assert not detector.seen(error)


@pytest.mark.parametrize("rate", [500.0, 2000.0])
def test_the_slowest_swing_is_the_same_time_at_any_rate(rate: float) -> None:
    def at(frequency: float) -> int:
        return first_seen(
            (AMPLITUDE * 3 * math.sin(2 * math.pi * frequency * k / rate) for k in range(int(2 * rate))), rate
        )

    assert at(4.8) == -1
    assert at(5.3) > 0
