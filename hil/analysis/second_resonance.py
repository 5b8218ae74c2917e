"""What becomes of the loop on a resonance that the model does not have: a light mass on a spring, at any frequency.

A measured frequency response shows such a resonance, a model does not. So a mass of a stated share is hung on the motor
of each axis, and its frequency swept up to half the rate. The loop is what the corners' trial found, with the response
of that stage in place of the model's. It is stable where it turns round -1 as often as before (Nyquist).
"""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.analysis.flexible_plant import AxisDynamics, hung
from hil.analysis.loop_corners import CornerTrial
from hil.analysis.stability import margins_of_loop
from hil.control.laws.base import Array

Complex = NDArray[np.complex128]
LOADS: Final = (0.02, 0.05)  # parts of the moving mass
DAMPING: Final = 0.01
LOWEST_HZ: Final = 20.0
HIGHEST: Final = 0.49  # of the rate
SWEPT: Final = 48  # frequencies
_FINER: Final = 12  # more of them about the worst
_POINTS: Final = 200  # of the response, beside those about the resonance
_AROUND: Final = np.linspace(-3.0, 3.0, 41)  # asinh of damping ratios beside it: there the response turns
_FOLDED: Final = range(-2, 2)  # images of a frequency that a sampled axis shows, in pairs about half the rate


class SecondResonance(NamedTuple):
    """One axis, sliding or at rest, with the worst of the resonances of that load. gain_db, phase_deg: of the margins
    there, infinite where none is met. unstable_hz: from where to where it rings; None: nowhere.
    """

    axis: str
    at_rest: bool
    load: float
    frequency_hz: float
    gain_db: float
    phase_deg: float
    unstable_hz: tuple[float, float] | None

    def text(self) -> str:
        """For people."""
        rest = ", at rest" if self.at_rest else ""
        what = f"axis '{self.axis}'{rest}, with {self.load:.0%} of its mass on another spring"
        if self.unstable_hz:
            low, high = (f"{edge:.0f}" for edge in self.unstable_hz)
            return f"{what}: the loop rings at a resonance of {low if low == high else f'{low} to {high}'} Hz"
        margin = f"{self.gain_db:.1f} dB and {self.phase_deg:.0f} deg"
        return f"{what}: stable at any resonance; least margin {margin} at {self.frequency_hz:.0f} Hz"

    def as_json(self) -> dict[str, Any]:
        """Keys: as the fields; what is infinite is null."""
        values = self._asdict()
        return {key: None if value == math.inf else value for key, value in values.items()}


def second_resonances(trial: CornerTrial) -> list[SecondResonance]:
    """After the trial: each axis on its nominal model and, where it states presliding, at rest in the middle of that;
    of each load that is swept. Axes whose loop is unstable as it is are left out.
    """
    return [
        _worst(name, at_rest, load, dynamics, answer, trial.period_s)
        for name, at_rest, dynamics, answer in trial.plain()
        for load in LOADS
    ]


def _worst(name: str, at_rest: bool, load: float, axis: AxisDynamics, answer: Array, period: float) -> SecondResonance:
    spectrum = np.fft.rfft(answer)[1:-1]
    known = np.arange(1, len(spectrum) + 1) / (len(answer) * period)
    swept = np.geomspace(LOWEST_HZ, HIGHEST / period, SWEPT)
    for finer in (False, True):
        near = swept[:, None] * (1.0 + DAMPING * np.sinh(_AROUND))
        along = np.broadcast_to(np.geomspace(known[0], known[-1], _POINTS), (len(swept), _POINTS))
        here = np.clip(np.sort(np.concatenate((along, near), axis=1), axis=1), known[0], known[-1])
        without = 1.0 / np.interp(here, known, spectrum)
        changed = _response(axis, here, period, load, swept[:, None]) / _response(axis, here, period)
        with_it = (without - 1.0) * changed
        turned = np.unwrap(np.angle((1.0 + with_it) / without), axis=1)
        rings = np.abs(turned[:, -1] - turned[:, 0]) > np.pi
        closest = np.abs(1.0 + with_it).min(axis=1)
        at = int(closest.argmin())
        if finer or rings.any():
            break
        swept = np.geomspace(swept[max(at - 1, 0)], swept[min(at + 1, SWEPT - 1)], _FINER)
    met = margins_of_loop(with_it[at], here[at])
    where = swept[rings]
    unstable = (float(where[0]), float(where[-1])) if where.size else None
    return SecondResonance(name, at_rest, load, float(swept[at]), met.gain_db, met.phase_margin, unstable)


def _response(
    axis: AxisDynamics, frequency: Array, period: float, load: float = 0.0, resonance: Array | float = 0.0
) -> Complex:
    """Motor position over a force held for a period, sampled (m/N), at `frequency` (Hz, any shape). load: part of the
    mass on another spring, at `resonance` (Hz) on the held motor.
    """
    total = np.zeros(frequency.shape, complex)
    for image in _FOLDED:
        s = np.asarray(2j * np.pi * (frequency + image / period), np.complex128)
        known = [mode for mode in ((axis.mode_hz, axis.mode_damping, axis.mode_load), *axis.others) if mode[0]]
        motor = axis.mass * (1.0 - load - sum([part for _, _, part in known]))
        stiff = motor * s * s + (axis.viscous + axis.damping) * s + axis.stiffness
        for hertz, damping, part in known:
            stiff = stiff + axis.mass * part * hung(s, hertz, damping)
        if load:
            stiff = stiff + axis.mass * load * hung(s, resonance, DAMPING)
        total += 1.0 / (stiff * (1.0 + axis.lag * s) * s)
    answer: Complex = total * (1.0 - np.exp(-2j * np.pi * frequency * period)) / period
    return answer


def second_notes(found: Sequence[SecondResonance]) -> list[str]:
    """Of each axis: what is closest to instability without reaching it, and the lightest that rings."""
    notes = []
    for axis in dict.fromkeys(finding.axis for finding in found):
        own = [finding for finding in found if finding.axis == axis]
        stable = [finding for finding in own if not finding.unstable_hz]
        least = sorted(stable, key=lambda finding: min(finding.gain_db / 3.0, finding.phase_deg / 15.0))
        notes += [finding.text() for finding in (*least[:1], *[one for one in own if one.unstable_hz][:1])]
    return notes
