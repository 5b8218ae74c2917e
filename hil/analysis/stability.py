"""Is the sampled loop stable? The rig's own filter and law around the nominal mass, with the real one-period delay.

A unit pulse is added to one axis' measured position and the loop answers (pulse_loop.py). From that answer the poles
are realised (eigensystem realisation: Juang and Pappa, J. Guidance 8(5), 1985) and, as it is the impulse response of
the sensitivity S, the loop gain L = 1/S - 1 and its margins follow. Another copy is kicked: where it is left then, it
has to come back from. Friction is left out: what it does to a loop is
damp it. The same around the axis a stage really has is in loop_corners.py.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.analysis.pulse_loop import DECAYED, GROWN, Trial, pulse_and_kick, pulse_response
from hil.analysis.restoring import Held
from hil.control.estimator.gains import keep_design
from hil.control.laws.base import Array
from hil.rig.schema import RigConfig, RigError

REALISED = 240  # ticks of the answer from which poles are realised
GONE = 1e-3  # of its peak: an answer that is all but gone
ANSWER = 4000  # ticks of the answer from which margins are taken
STABLE_RADIUS = 1.0 - 1e-6
NEGLIGIBLE = 1e-5  # singular values below this fraction of the greatest are rounding, or drift of a settling filter
OFFSET_S = 600.0  # within which a kicked axis has to be back
OFFSET_LEFT = 0.01  # of the greatest offset: it is back
SLOW = 0.5  # of a swing: its mean over an eighth of the motion is more than this
ROUNDING = 1e-9  # of a pole: one that is nearer to 1 is 1
RATES_HZ = (50.0, 10_000.0)  # looked at
RATE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class AxisStability:
    """One axis. poles: discrete, by falling magnitude. gain_margin: factor on the loop's gain, up, None where unbounded
    or unstable; gain_margin_down likewise, below 1. phase_margin_deg: smallest. lowest_stable_rate_hz: with these
    gains and this filter, None if not asked for; RATES_HZ[0] means "at any rate looked at", inf none.
    finite_difference_rate_hz: the same for kp, kd on a finite difference without prediction, as in the paper; None
    where the law has no kp, kd. offset_s: until a kicked axis is back, inf where it does not come back; an axis that
    takes longer than OFFSET_S is not stable.
    """

    stable: bool
    poles: list[complex]
    gain_margin: float | None
    gain_margin_down: float | None
    phase_margin_deg: float | None
    lowest_stable_rate_hz: float | None = None
    finite_difference_rate_hz: float | None = None
    offset_s: float = 0.0

    @property
    def radius(self) -> float:
        """Largest magnitude of a pole."""
        return max((abs(pole) for pole in self.poles), default=0.0)

    @property
    def gain_db(self) -> float:
        """Least gain margin, up or down; infinite where none is met."""
        return decibels(self.gain_margin, self.gain_margin_down)

    @property
    def phase_deg(self) -> float:
        """Phase margin, infinite where none is met."""
        return math.inf if self.phase_margin_deg is None else self.phase_margin_deg


@dataclass(frozen=True)
class StabilityReport:
    """Every axis of a rig by name."""

    law: str
    rate_hz: float
    axes: dict[str, AxisStability]

    @property
    def stable(self) -> bool:
        """Every axis is."""
        return all(axis.stable for axis in self.axes.values())

    def problems(self) -> list[str]:
        """One line per unstable axis."""
        drifting = [
            f"law '{self.law}' does not hold axis '{name}' at {self.rate_hz:g} Hz: after a push it "
            + (f"takes {axis.offset_s:.3g} s to come back" if axis.offset_s < math.inf else "does not come back")
            + f" to {OFFSET_LEFT:.0%} (limit {OFFSET_S:g} s); raise law.gains or run `hil tune`"
            for name, axis in self.axes.items()
            if axis.offset_s > OFFSET_S
        ]
        return drifting + [
            f"law '{self.law}' is unstable on axis '{name}' at {self.rate_hz:g} Hz: a pole at |z| = {axis.radius:.4f}"
            + (f"; it is stable from {rate:.0f} Hz on" if rate < math.inf else "")
            + "; lower law.gains or run `hil tune`"
            for name, axis in self.axes.items()
            for rate in [axis.lowest_stable_rate_hz or math.inf]
            if not axis.stable and axis.offset_s <= OFFSET_S
        ]

    def as_json(self) -> dict[str, Any]:
        """Keys: law, rate_hz, stable, axes.<name>.{stable, radius, poles[[re, im]], margins, lowest rates}."""
        return {
            "law": self.law,
            "rate_hz": self.rate_hz,
            "stable": self.stable,
            "axes": {
                name: {
                    "stable": axis.stable,
                    "radius": axis.radius,
                    "poles": [[pole.real, pole.imag] for pole in axis.poles],
                    "gain_margin": axis.gain_margin,
                    "gain_margin_down": axis.gain_margin_down,
                    "phase_margin_deg": axis.phase_margin_deg,
                    "lowest_stable_rate_hz": axis.lowest_stable_rate_hz,
                    "finite_difference_rate_hz": axis.finite_difference_rate_hz,
                }
                for name, axis in self.axes.items()
            },
        }


def realise_poles(answer: Array) -> list[complex]:
    """Poles of the system whose impulse response is `answer` (ticks,), largest first."""
    grown = np.flatnonzero(~(np.abs(answer) < GROWN))
    markov = answer[1 : grown[0] if grown.size else None]  # the direct term has no dynamics
    rows = len(markov) // 2
    if rows < 2 or (grown.size and not markov.any()):
        return [complex(GROWN)]  # out of the linear range at once, or so far out already that no pulse showed
    hankel = np.lib.stride_tricks.sliding_window_view(markov, rows)[: len(markov) - rows + 1]
    u, s, v = np.linalg.svd(hankel[:-1])
    order = int(np.sum(s > NEGLIGIBLE * s[0]))
    root = np.sqrt(s[:order])
    a = (u[:, :order] / root).T @ hankel[1:] @ (v[:order].T / root)
    return sorted((complex(z) for z in np.linalg.eigvals(a)), key=lambda z: (-abs(z), z.real, z.imag))


def decibels(up: float | None, down: float | None) -> float:
    """How many decibels a gain may rise or fall, whichever is less, of the two factors; infinite where none is met."""
    factor = min(up or math.inf, 1.0 / down if down else math.inf)
    return 20.0 * math.log10(factor) if factor < math.inf else math.inf


class LoopMargins(NamedTuple):
    """Gain margin up and down (factors), phase margin (degrees), None where none is met; and where the margins are
    smallest: cycles per sample, 0 where none is met.
    """

    gain_up: float | None
    gain_down: float | None
    phase_deg: float | None
    gain_at: float = 0.0
    phase_at: float = 0.0

    @property
    def gain_db(self) -> float:
        """See decibels."""
        return decibels(self.gain_up, self.gain_down)

    @property
    def phase_margin(self) -> float:
        """Degrees, infinite where none is met."""
        return math.inf if self.phase_deg is None else self.phase_deg

    @property
    def tightest_at(self) -> float:
        """Where the margin lies that is the smaller part of the textbook's 6 dB and 30 degrees."""
        return self.gain_at if self.gain_db / 6.0 < self.phase_margin / 30.0 else self.phase_at


def margins(answer: Array) -> LoopMargins:
    """From the pulse response of the sensitivity S, (ticks,)."""
    spectrum = np.fft.rfft(answer)
    return margins_of_loop(1.0 / spectrum[1:] - 1.0, np.arange(1, len(spectrum)) / len(answer))


def _where_real(value: NDArray[np.complex128], crossing: NDArray[np.int64]) -> Array:
    """What it is where it becomes real after the numbers `crossing`, on a straight line."""
    here, there = value[crossing], value[crossing + 1]
    share = here.imag / (here.imag - there.imag)
    real: Array = here.real + share * (there.real - here.real)
    return real


def margins_of_loop(loop: NDArray[np.complex128], frequency: Array) -> LoopMargins:
    """Of the loop gain L, (k,), at these rising frequencies, (k,), in whose unit the answer's are.

    Between two of them a straight line is taken: of L near -1, else of S = 1 / (1 + L). That is 0 where a law learns a
    wave of one frequency, and L turns round there within a fraction of a step.
    """
    sensitivity = 1.0 / (1.0 + loop)
    imag = loop.imag
    crossing = np.flatnonzero(np.sign(imag[:-1]) != np.sign(imag[1:]))
    near = np.maximum(np.abs(sensitivity[crossing]), np.abs(sensitivity[crossing + 1])) > 1.0
    with np.errstate(divide="ignore"):  # S may be 0
        real = np.where(near, _where_real(loop, crossing), 1.0 / _where_real(sensitivity, crossing) - 1.0)
    factors = -1.0 / real
    size = np.log(np.abs(loop))
    unity = np.flatnonzero(size[:-1] * size[1:] <= 0)
    share = size[unity] / np.where(size[unity] == size[unity + 1], 1.0, size[unity] - size[unity + 1])
    turned = share * np.angle(loop[unity + 1] / loop[unity])
    angles = np.abs(np.degrees(np.angle(-loop[unity] * np.exp(1j * turned))))
    up, down = factors[factors > 1.0], factors[(factors > 0.0) & (factors < 1.0)]
    met = np.where(factors > 0.0, np.abs(np.log(np.abs(factors))), np.inf)
    return LoopMargins(
        float(up.min()) if up.size else None,
        float(down.max()) if down.size else None,
        float(angles.min()) if angles.size else None,
        float(frequency[crossing[met.argmin()]]) if met.size and met.min() < np.inf else 0.0,
        float(frequency[unity[angles.argmin()]]) if angles.size else 0.0,
    )


def finite_difference_poles(mass: float, kp: float, kd: float, period: float) -> list[complex]:
    """Poles of m ë = u(k-1) with u = -Kp e - Kd (e(k) - e(k-1)) / T: the paper's gains sampled, force one period late.

    (z - 1)^2 z^2 + T^2 / (2 m) (z + 1) ((Kp + Kd/T) z - Kd/T) = 0.
    """
    gain = period * period / (2.0 * mass)
    inertia = np.polymul([1.0, -2.0, 1.0], [1.0, 0.0, 0.0])
    control = np.polymul([1.0, 1.0], [kp + kd / period, -kd / period])
    return [complex(z) for z in np.roots(np.polyadd(inertia, gain * control))]


def finite_difference_lowest_rate(mass: float, kp: float, kd: float) -> float:
    """Lowest rate (Hz) at which those poles are stable."""

    def stable(rate: float) -> bool:
        return max(map(abs, finite_difference_poles(mass, kp, kd, 1.0 / rate))) < STABLE_RADIUS

    return _lowest(stable, RATES_HZ[1])


def _lowest(stable: Callable[[float], bool], rate: float) -> float:
    """The rate above which a loop is stable, searched downwards from `rate` where it is stable there, else upwards."""
    low, high = (RATES_HZ[0], rate) if stable(rate) else (rate, RATES_HZ[1])
    if not stable(high):
        return float("inf")
    if stable(low):
        return low
    while high / low > 1.0 + RATE_TOLERANCE:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    return high


def is_stable(answer: Array, poles: list[complex]) -> bool:
    """Of an axis' motion after a pulse, (ticks,), and its poles: it neither grows nor circles for ever."""
    size = np.abs(answer)
    if not np.all(size < GROWN) or size[-(len(size) // 4) :].max() > DECAYED * size[1:].max():
        return False  # grows, or circles for ever
    return max(map(abs, poles), default=0.0) < STABLE_RADIUS or _fades(size)


def _fades(size: Array) -> bool:
    """Whether an answer is all but gone long after the ticks that poles are realised from, and fades on. Where a law
    learns a wave of friction the loop varies with time, and a realised pole may be none of it.
    """
    quarter = len(size) // 4
    before, last = size[-2 * quarter : -quarter].max(), size[-quarter:].max()
    return bool(quarter >= REALISED and last < 0.5 * before and last < GONE * size.max())


def offset_s(motion: Array, period: float) -> float:
    """When (s) a kicked axis is back, of its motion (ticks,); inf where it does not come nearer. 0 where it is back by
    the end, or swings quickly, which its poles tell. period: s.

    Beyond the end by the two slowest modes, fitted to means over eighths (Prony's method): how it came to where it is,
    and how it leaves.
    """
    width, half = len(motion) // 8, motion[len(motion) // 2 :]
    if not np.all(np.abs(motion) < np.inf):
        return 0.0
    averages = motion[-7 * width :].reshape(7, width).mean(axis=1)
    if half.min() * half.max() <= 0.0 and np.abs(averages[-4:]).max() < SLOW * np.abs(half).max():
        return 0.0
    left, allowed = np.abs(half).max(), OFFSET_LEFT * np.abs(motion).max()
    if left <= allowed:
        return 0.0
    fitted, *_ = np.linalg.lstsq(np.stack([averages[1:-1], averages[:-2]], axis=1), averages[2:], rcond=1e-9)
    kept = max(float(np.abs(np.roots([1.0, *-fitted])).max()), ROUNDING)
    if kept >= 1.0 - ROUNDING:
        return math.inf
    return (len(motion) + width * math.log(left / allowed) / -math.log(kept)) * period


def _judged(motion: Array, kicked: Array, period: float, away: bool = False) -> AxisStability:
    """Of one axis, (ticks,) each; its margins are still to be found. away: the law pushes it off, however slowly."""
    poles = realise_poles(motion[:REALISED])
    stable = is_stable(motion, poles)
    back = (math.inf if away else offset_s(kicked, period)) if stable else 0.0
    return AxisStability(stable and back <= OFFSET_S, poles, None, None, None, offset_s=back)


def refuse_unstable(rig: RigConfig) -> None:
    """For a process about to move something: raises RigError (exit status 78) naming every axis that is unstable or
    that the law does not hold.
    """
    report = _report(rig, REALISED)
    if any(axis.offset_s > OFFSET_S for axis in report.axes.values()):
        report = _report(rig, ANSWER)  # a slow loop is still on its way after so few ticks
    if problems := report.problems():
        raise RigError(problems)


def _report(rig: RigConfig, ticks: int) -> StabilityReport:
    held = Held()
    _, motion, kicked = pulse_and_kick(rig, ticks, [held])
    columns = zip(motion.T, kicked.T, held.verdict(rig), strict=True)
    found = [_judged(moved, back, rig.period_ns * 1e-9, bool(away)) for moved, back, away in columns]
    return StabilityReport(rig.law.name, rig.rate_hz, dict(zip(rig.axes, found, strict=True)))


def _stable_axes(rig: RigConfig) -> Array:
    _, motion = pulse_response(rig, REALISED)
    return _stable_columns(motion)


def _stable_columns(motion: Array) -> Array:
    return np.array([is_stable(column, realise_poles(column)) for column in motion.T])


def _lowest_rates(rig: RigConfig, motion: Array) -> list[float]:
    """Per axis; every rate tried serves all axes. motion: at the rig's own rate, (ticks, n_axes)."""
    tried = {rig.rate_hz: _stable_columns(motion[:REALISED])}

    def stable(axis: int, rate: float) -> bool:
        if rate not in tried:
            try:
                at_rate = rig.model_copy(update={"rate_hz": rate})
                keep_design(at_rate)
                tried[rate] = _stable_axes(at_rate)
            except ValueError:  # a law or an estimator of users that refuses such a rate
                tried[rate] = np.zeros(len(rig.axes), dtype=bool)
        return bool(tried[rate][axis])

    return [_lowest(partial(stable, axis), rig.rate_hz) for axis in range(len(rig.axes))]


def _finite_difference_rates(rig: RigConfig) -> list[float | None]:
    gains = rig.law.effective_gains()
    n = len(rig.axes)
    if "kp" not in gains or "kd" not in gains:
        return [None] * n
    kp, kd = (np.broadcast_to(gains[key], (n,)).tolist() for key in ("kp", "kd"))
    masses = [axis.model.mass for axis in rig.axes.values()]
    return [finite_difference_lowest_rate(*values) for values in zip(masses, kp, kd, strict=True)]


def check_stability(
    rig: RigConfig,
    *,
    lowest_rate: bool = False,
    kicked: bool = True,
    ticks: int = ANSWER,
    beside: Sequence[Trial] = (),
) -> StabilityReport:
    """Poles and margins of every axis of the rig's sampled loop; lowest_rate: also search the lowest stable rates.
    kicked: also whether it comes back from a push. ticks: of the answer, at least REALISED; the more, the finer the
    frequencies at which margins are taken. beside: other trials of the same loop, where it is kicked.

    Raises ValueError where the law cannot be made from its gains.
    """
    held = Held()
    if kicked:
        answer, motion, offset = pulse_and_kick(rig, ticks, [held, *beside])
        away = held.verdict(rig)
    else:
        answer, motion = pulse_response(rig, ticks)
        offset, away = np.zeros(motion.shape), np.zeros(len(rig.axes), dtype=bool)
    rates: list[float | None] = [*_lowest_rates(rig, motion)] if lowest_rate else [None] * len(rig.axes)
    differences = _finite_difference_rates(rig) if lowest_rate else rates
    axes = {}
    for index, name in enumerate(rig.axes):
        axis = _judged(motion[:, index], offset[:, index], rig.period_ns * 1e-9, bool(away[index]))
        found = margins(answer[:, index]) if axis.stable else LoopMargins(None, None, None)
        axes[name] = replace(
            axis,
            gain_margin=found.gain_up,
            gain_margin_down=found.gain_down,
            phase_margin_deg=found.phase_deg,
            lowest_stable_rate_hz=rates[index],
            finite_difference_rate_hz=differences[index],
        )
    return StabilityReport(rig.law.name, rig.rate_hz, axes)
