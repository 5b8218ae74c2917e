"""What a sound run of a rig and task is like, so that later runs can be held against it. Per axis and phase, over the
windows of hil.events.accuracy, the median and the largest of each figure.

Figures, SI units (rad, N m for rotary axes): rms, bias: of the following error, its RMS and its mean's size. fast,
slow: its tremble (accuracy.py). innovation, force: RMS. counts: share of ticks with a new encoder count. drag_up,
drag_down: force along the motion beyond the model's, by direction. bands: RMS of the following error in octaves up to
BANDS_HZ.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.events.axis_model import AxisModel, Floats
from hil.events.forces import drag_of
from hil.events.windows import SETTLED, Windows

PHASES: Final = ("rest", "move", "reversal")
FIGURES: Final = ("rms", "bias", "fast", "slow", "innovation", "force", "counts", "drag_up", "drag_down")
BANDS_HZ: Final = (16.0, 32.0, 64.0, 125.0, 250.0, 500.0)
BEYOND: Final = 2.0  # times the largest of a baseline of many windows
_FEW: Final = 4.0  # of a baseline of few windows, this over their number more
_GAUSS: Final = 0.6745 * 6.0**0.5  # of the median of |second difference| of white noise

Baseline = Mapping[str, Mapping[str, Mapping[str, Any]]]  # axis, phase, figure: [median, most]; windows: their number


def phase_of(velocity: Floats) -> str:
    """Of a window, by the set-point's velocity: at rest, there and back, or on its way."""
    if not velocity.any():
        return "rest"
    return "reversal" if velocity.min() < 0.0 < velocity.max() else "move"


def tremble(error: Floats, lag: int) -> float:
    """Second difference over `lag` ticks of a following error, (n,): RMS of the white noise it would be, m."""
    return float(np.median(np.abs(error[2 * lag :] - 2.0 * error[lag:-lag] + error[: -2 * lag]))) / _GAUSS


def figures(axis: Mapping[str, Floats], model: AxisModel, period_s: float, lag: int) -> dict[str, float]:
    """Of a whole window of one axis' fields."""
    error = axis["following_error"]
    found = {
        "rms": _rms(error),
        "bias": abs(float(error.mean())),
        "fast": tremble(error, 1),
        "slow": tremble(error, lag),
        "innovation": _rms(axis["innovation"]),
        "force": _rms(axis["force"]),
        "counts": np.count_nonzero(np.diff(axis["position"])) / (len(error) - 1),
    }
    if (drag := drag_of(model, period_s, axis)) is not None:
        found["drag_up" if drag[0] > 0.0 else "drag_down"] = drag[1]
    return found


def bands(error: Floats, period_s: float) -> list[float]:
    """RMS of a window's following error in each octave, m."""
    power = np.abs(np.fft.rfft((error - error.mean()) * np.hanning(len(error)))) ** 2
    power *= 2.0 / float(np.sum(np.hanning(len(error)) ** 2)) / len(error)
    hz = np.fft.rfftfreq(len(error), period_s)
    edges = (0.0, *BANDS_HZ)
    return [float(np.sqrt(power[(hz > low) & (hz <= high)].sum())) for low, high in itertools.pairwise(edges)]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def baseline_of(
    columns: NDArray[np.void] | Mapping[Any, NDArray[Any]],
    names: Sequence[str],
    models: Sequence[AxisModel],
    period_s: float,
) -> dict[str, dict[str, dict[str, Any]]]:
    """The Baseline of a run. columns: by name, or records; names, models: of its axes."""
    windows, found = Windows(period_s), {name: Gathered() for name in names}
    rested = dict.fromkeys(names, 0)
    for window in windows.take(columns):
        for number, (name, model) in enumerate(zip(names, models, strict=True)):
            axis = window.axis(number) if window else None
            phase = phase_of(axis["setpoint_velocity"]) if axis else ""
            rested[name] = rested[name] + 1 if phase == "rest" else 0
            if axis and (phase != "rest" or rested[name] > SETTLED):
                octaves = bands(axis["following_error"], period_s)
                found[name].add(phase, figures(axis, model, period_s, windows.lag), octaves)
    return {name: gathered.document for name, gathered in found.items()}


class Gathered:
    """Figures of one axis, window by window, by phase."""

    def __init__(self) -> None:
        self._figures: dict[str, list[dict[str, float]]] = {phase: [] for phase in PHASES}
        self._bands: dict[str, list[list[float]]] = {phase: [] for phase in PHASES}

    def add(self, phase: str, found: dict[str, float], octaves: list[float]) -> None:
        """A window."""
        self._figures[phase].append(found)
        self._bands[phase].append(octaves)

    @property
    def document(self) -> dict[str, dict[str, Any]]:
        """An axis of a Baseline: phases that had windows alone."""
        return {
            phase: {
                "windows": len(rows),
                **{name: _spread([row[name] for row in rows if name in row]) for name in FIGURES},
                "bands": np.median(self._bands[phase], axis=0).tolist(),
            }
            for phase, rows in self._figures.items()
            if rows
        }


def _spread(values: Sequence[float]) -> list[float] | None:
    return [float(np.median(values)), float(np.max(values))] if values else None


def known_of(phases: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """By phase and figure, the bound beyond which an axis is not as it was."""
    found = {}
    for phase, row in phases.items():
        factor = BEYOND + _FEW / float(row["windows"])
        found[phase] = {name: factor * abs(row[name][1]) for name in FIGURES if row.get(name)}
    return found
