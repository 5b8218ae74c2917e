"""Waypoints passed without stopping: as quick as allowed, and no corner shorter than a period."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.control.trajectories.blends import lines
from hil.control.trajectories.segments import Segments


def whole(period_ns: int) -> Callable[[float], int]:
    """Seconds as ns, up to whole periods."""
    return lambda seconds: max(1, math.ceil(seconds * 1e9 / period_ns)) * period_ns


@pytest.mark.parametrize(
    ("reached", "limits"),
    [("speed", (0.05, 100.0, 1e6)), ("acceleration", (5.0, 0.5, 1e6)), ("jerk", (5.0, 100.0, 40.0))],
)
@pytest.mark.parametrize("points", [
    [[0.0, 0.0], [0.03, 0.04]],
    [[0.0, 0.0], [0.004, 0.003], [0.4, 0.301]],  # up to speed in the short line, on in the long one
    [[0.4, 0.301], [0.004, 0.003], [0.0, 0.0]],
    [[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]],
], ids=["alone", "short, long", "long, short", "corners"])  # fmt: skip
def test_a_blended_path_is_as_quick_as_one_of_its_limits_allows(
    points: list[list[float]], reached: str, limits: tuple[float, float, float]
) -> None:
    """Seen in the axis that moves most, to within the rounding to whole periods."""
    parts = lines(points, limits, 5e-3, whole(10_000))
    run = Segments(parts, repeat=False, phase_names=("path",))
    length = sum(part.duration_ns for part in parts)
    times = np.unique(np.linspace(0, length, 20_001).astype(np.int64))
    sampled = run.sample(np.repeat(times[:, None], 2, axis=1))
    jerk = np.diff(sampled.acceleration, axis=0) / (np.diff(times)[:, None] * 1e-9)
    peaks = [float(np.abs(values).max()) for values in (sampled.velocity, sampled.acceleration, jerk)]
    shares = dict(
        zip(("speed", "acceleration", "jerk"), (p / q for p, q in zip(peaks, limits, strict=True)), strict=True)
    )
    assert max(shares.values()) == shares[reached] == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("period_ns", [500_000, 1_000_000, 4_000_000])
def test_a_corner_that_nothing_else_slows_lasts_one_period(period_ns: int) -> None:
    parts = lines([[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]], (10.0, 1e9, 1e15), 1e-3, whole(period_ns))
    corner = [part for part in parts if not any(part.still)]
    assert [part.duration_ns for part in corner] == [pytest.approx(period_ns, rel=0.05)]  # stretched to whole periods
    assert sum(part.duration_ns for part in parts) % period_ns == 0
