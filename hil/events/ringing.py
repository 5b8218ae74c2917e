"""At what frequency a loop rings: a line in the spectrum of its error and of its force alike, which does not fade.

The change of the following error from tick to tick shows a quick swing beside a slow drift. Noise has no line. A
runaway has no swing. A push fades. A task that swings by itself has the line in its set-point, too.
"""

from typing import Final

import numpy as np

from hil.events.axis_model import Floats

LONGEST: Final = 512  # ticks looked at
_WINDOWS: Final = (48, 96, 192, 384, LONGEST)  # the shortest that shows it
_PERIODS: Final = 3  # in such a window, at least
_NEAR: Final = 2  # bins beside the peak that a windowed line fills
_LINE: Final = 0.6  # of the error's power, at least: the rest is what began the swing
_OF_FORCE: Final = 0.85  # of the force's; less of both is noise
_LASTING: Final = 0.8  # of the first half's amplitude, in the second
_TASK: Final = 0.25  # of the error's power there, that the set-point may have
_FINE: Final = 8  # points of the spectrum in a bin
_COUNTS: Final = 5.0  # of the encoder a tick, RMS: less is its rounding
_MOVES: Final = 0.01  # of the largest force, RMS: less is no part of a loop


def ringing_hz(error: Floats, force: Floats, setpoint: Floats, resolution: float, period_s: float) -> float | None:
    """Hz, of the ticks up to now, (n,), m and N (rad, N m); None where the axis does not ring. resolution: m (rad) a
    count. period_s: of a tick.
    """
    for ticks in _WINDOWS:
        if ticks >= len(error):
            return None
        swing, task = (np.diff(values[-ticks - 1 :]) for values in (error, setpoint))
        acting = force[-ticks:]
        if np.std(swing) <= _COUNTS * resolution or np.std(acting) <= _MOVES * np.abs(acting).max():
            continue
        peak = int(_spectrum(swing).argmax()) / _FINE
        if peak < _PERIODS or _share(swing, peak) < _LINE or _share(acting, peak) < _OF_FORCE:
            continue
        if _power(task, peak) > _TASK * _power(swing, peak):
            continue
        first, second = (float(np.std(half)) for half in np.split(swing, 2))
        if second >= _LASTING * first:
            return peak / (ticks * period_s)
    return None


def _spectrum(values: Floats) -> Floats:
    """Power over frequency, _FINE points a period in the window."""
    ticks = np.arange(len(values))
    level = values - np.polyval(np.polyfit(ticks, values, 1), ticks)
    power: Floats = np.abs(np.fft.rfft(level * np.hanning(len(values)), _FINE * len(values))) ** 2
    return power


def _power(values: Floats, peak: float) -> float:
    """Of the line at `peak` periods in the window."""
    low, high = round((peak - _NEAR) * _FINE), round((peak + _NEAR) * _FINE)
    return float(_spectrum(values)[max(0, low) : high + 1].sum())


def _share(values: Floats, peak: float) -> float:
    """Of that line in all power."""
    return _power(values, peak) / float(_spectrum(values).sum())
