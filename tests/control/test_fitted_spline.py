"""A spline that is fitted to its limits: none is exceeded, and the one that binds is nearly reached."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from hil.control.trajectories.paths import LOOKS, _peaks, fitted_spline
from hil.control.trajectories.segments import Segments, segment

POINTS = [[0.0, 0.0], [0.02, 0.01], [0.03, -0.01], [0.0, 0.005], [0.01, 0.0]]
LOOSE = 1e9


@pytest.mark.parametrize("repeat", [False, True])
@pytest.mark.parametrize(
    ("limits", "used"), [((0.05, LOOSE, LOOSE), 0.99), ((LOOSE, 0.5, LOOSE), 0.89), ((LOOSE, LOOSE, 20.0), 0.97)]
)
def test_it_is_as_quick_as_its_limits_allow_and_no_quicker(
    limits: tuple[float, float, float], used: float, repeat: bool
) -> None:
    """Peaks are looked for at 32 instants of a piece, with room for what lies between: most for the acceleration."""
    body = fitted_spline(POINTS, limits, lambda seconds: round(seconds * 1e9), 0, repeat=repeat)
    ends = body.repeat_ns or body.duration_ns
    assert ends is not None
    times = np.linspace(0, ends, 20_001).astype(np.int64)
    motion = [body.sample_axis(axis, times) for axis in (0, 1)]
    speed, acceleration = (max(float(np.abs(axis[k]).max()) for axis in motion) for k in (1, 2))
    jerk = max(float(np.abs(np.diff(axis[2]) / np.diff(times * 1e-9)).max()) for axis in motion)
    shares = [peak / limit for peak, limit in zip((speed, acceleration, jerk), limits, strict=True)]
    assert used < max(shares) < 1.0 + 1e-3


COEFFICIENTS = st.tuples(*[st.floats(-1.0, 1.0)] * 6)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(1, 2000), COEFFICIENTS, COEFFICIENTS), min_size=1, max_size=3))
def test_peaks_are_those_of_the_polynomials_or_more_by_what_may_lie_between_two_looks(
    pieces: list[tuple[int, tuple[float, ...], tuple[float, ...]]],
) -> None:
    """Column by column: what a steady axis does is not exaggerated by the jerk of another one."""
    body = [segment(duration * 1_000_000, columns, 0) for duration, *columns in pieces]
    least, most = np.zeros(3), np.zeros(3)
    for duration, *columns in pieces:
        seconds = duration * 1e-3
        t = np.linspace(0.0, seconds, 8 * LOOKS + 1)
        for column in columns:
            derivatives = [Polynomial(column).deriv(order) for order in (1, 2, 3)]
            turns = np.real(derivatives[2].deriv().roots()).clip(0.0, seconds)
            speed, acceleration = (np.abs(of(t)).max() for of in derivatives[:2])
            jerk = np.abs(derivatives[2](np.append(t, turns))).max()
            step = seconds / LOOKS
            least = np.maximum(least, [speed, acceleration, jerk])
            most = np.maximum(most, [speed + step * step * jerk / 8.0, acceleration + 0.5 * step * jerk, jerk])
    found = np.array(_peaks(Segments(body, repeat=False, phase_names=("path",))))
    assert (found >= least * (1.0 - 1e-9) - 1e-12).all()
    assert (found <= most * (1.0 + 1e-9) + 1e-12).all()
