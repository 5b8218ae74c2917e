"""A spline that is fitted to its limits: none is exceeded, and the one that binds is nearly reached."""

import numpy as np
import pytest

from hil.control.trajectories.paths import fitted_spline

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
