"""Does learning converge? What is left of a disturbance from one repeat to the next, frequency by frequency.

What the observer finds of a force that it is not told of, H, does not depend on the feedback, as it knows all forces
that the law asks for. A residual r is smoothed and moved by the lag as hil/control/laws/repeat_memory.py does; what
changed of it from one repeat to the next changes in the one after by

    1 - q (2 - 2 cos w) - rate S(w) e^(i w lag) H(w)

of that: below 1 at every frequency, learning converges. On the nominal model; a mass that is off scales H.
"""

from typing import Any, NamedTuple

import numpy as np

from hil.control.laws import make_law
from hil.control.laws.base import Array
from hil.control.laws.repeat_memory import LAG, RATE, SAMPLES, SMOOTHING
from hil.control.nominal_model import rig_model
from hil.rig.schema import RigConfig

TICKS = 2048


class LearningFinding(NamedTuple):
    """left: of a slow disturbance after one repeat; most: of that of which most is left, and its frequency, Hz."""

    axis: str
    left: float
    most: float
    frequency_hz: float

    def problem(self) -> str:
        """Why it must not be tried; empty where it converges."""
        if self.most < 1.0:
            return ""
        return (
            f"law.iterative_learning: axis '{self.axis}': learning does not converge; from one repeat to the next it "
            f"grows by {self.most:.2f} at {self.frequency_hz:.0f} Hz"
        )

    def note(self) -> str:
        """For people."""
        return (
            f"learning, axis '{self.axis}': a repeat leaves {self.left:.2f} of a slow disturbance, at most "
            f"{self.most:.2f} ({self.frequency_hz:.0f} Hz)"
        )

    def as_json(self) -> dict[str, Any]:
        """Keys: as the fields."""
        return self._asdict()


def left_per_repeat(found: Array) -> tuple[Array, Array]:
    """Part of a residual that the next repeat leaves, (k, n_axes), and its angular frequency per period, (k,).

    found: what the observer finds after a pulse of 1 N, (ticks, n_axes).
    """
    answer = np.fft.rfft(found, axis=0)
    omega = np.linspace(0.0, np.pi, answer.shape[0])
    reach = SAMPLES // 2
    weights = [(reach + 1 - abs(k)) / (reach + 1) ** 2 for k in range(-reach, reach + 1)]
    smooth = sum(w * np.cos(omega * (k - reach)) for k, w in enumerate(weights))
    taken = RATE * smooth * np.exp(1j * omega * LAG)
    left: Array = np.abs((1.0 - SMOOTHING * (2.0 - 2.0 * np.cos(omega)))[:, None] - taken[:, None] * answer)
    return left, omega


def check_learning(rig: RigConfig) -> list[LearningFinding]:
    """Every axis, where the rig's law learns repeats by itself and is to. Raises ValueError as the law does."""
    if not rig.law.iterative_learning:
        return []
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    plain = rig.law.model_copy(update={"iterative_learning": False})
    made = make_law(plain, rig_model(rig), rig.period_ns * 1e-9, limit)
    if not made.learns_repeats:
        return []
    left, omega = left_per_repeat(np.array(made.found_of_pulse(TICKS)))
    at = left.argmax(axis=0)
    return [
        LearningFinding(
            name, float(left[0, i]), float(left[at[i], i]), float(omega[at[i]]) / (2.0 * np.pi) * rig.rate_hz
        )
        for i, name in enumerate(rig.axes)
    ]
