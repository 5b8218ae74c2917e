"""Is the sampled loop stable? The rig's own filter and law around the nominal mass, with the real one-period delay.

The law's code is not transcribed into equations: a unit pulse is added to one axis' measured position and the loop (rig
filter, law, zero-order hold, double integrator of the nominal mass) answers. From that answer the poles are realised
(eigensystem realisation: Juang and Pappa, J. Guidance 8(5), 1985) and, as it is the impulse response of the sensitivity
S, the loop gain L = 1/S - 1 and its margins follow. Friction is left out: what it does to a loop is damp it.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hil.control.estimator.gains import design_gains
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws import make_law
from hil.control.laws.base import Array, LawInputs, Model, Reference
from hil.control.nominal_model import blank_inputs, rig_model
from hil.rig.schema import RigConfig, RigError

PULSE = 1e-8  # m: small enough for every law's linear range
SETTLE = 400  # ticks until time-varying filters have settled
REALISED = 240  # ticks of the answer from which poles are realised
ANSWER = 4000  # ticks of the answer from which margins are taken
STABLE_RADIUS = 1.0 - 1e-6
DECAYED = 0.5  # of its peak: the last quarter of a stable loop's answer
NEGLIGIBLE = 1e-5  # singular values below this fraction of the greatest are rounding, or drift of a settling filter
RATES_HZ = (50.0, 10_000.0)  # looked at
RATE_TOLERANCE = 1e-3
CRUISE = 2.0**-5  # m/s: friction's sign is known, as in motion; a power of two keeps rounding out of the answer
GROWN = 1e3  # an answer beyond this many pulses has left the linear range


@dataclass(frozen=True)
class AxisStability:
    """One axis. poles: discrete, by falling magnitude. gain_margin: factor on the loop's gain, up, None where unbounded
    or unstable; gain_margin_down likewise, below 1. phase_margin_deg: smallest. lowest_stable_rate_hz: with these
    gains and this filter, None if not asked for; RATES_HZ[0] means "at any rate looked at", inf none.
    finite_difference_rate_hz: the same for kp, kd on a finite difference without prediction, as in the paper; None
    where the law has no kp, kd.
    """

    stable: bool
    poles: list[complex]
    gain_margin: float | None
    gain_margin_down: float | None
    phase_margin_deg: float | None
    lowest_stable_rate_hz: float | None = None
    finite_difference_rate_hz: float | None = None

    @property
    def radius(self) -> float:
        """Largest magnitude of a pole."""
        return max((abs(pole) for pole in self.poles), default=0.0)


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
        return [
            f"law '{self.law}' is unstable on axis '{name}' at {self.rate_hz:g} Hz: a pole at |z| = {axis.radius:.4f}"
            + (f"; it is stable from {axis.lowest_stable_rate_hz:.0f} Hz on" if axis.lowest_stable_rate_hz else "")
            + "; lower law.gains or run `hil tune`"
            for name, axis in self.axes.items()
            if not axis.stable
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


class _Loop:
    """Filter and law as in the cycle, around m a = force - (what the reference needs); plants (rows, n_axes): all axes
    of the first to pulse, or each axis of one of its own where the law looks at all of them; the last is left alone.
    """

    def __init__(self, rig: RigConfig, model: Model) -> None:
        n = model.mass.size
        self.mass = model.mass  # of the plant
        self._period = rig.period_ns * 1e-9
        gains, _ = design_gains(rig)
        self._filter = MotionFilter(list(gains), model.mass)
        limit = np.array([axis.limits.force for axis in rig.axes.values()])
        plain = rig.law.model_copy(update={"iterative_learning": False})
        self._law = make_law(plain, model, self._period, limit)
        self.pulsed = np.arange(n) if self._law.coupled else np.zeros(n, dtype=int)  # the plant, for each axis
        self.shape = shape = (int(self.pulsed.max()) + 2, n)
        self._inputs: LawInputs = blank_inputs(shape)
        self._inputs.fresh = np.ones(n)
        self._inputs.sample_interval = self._inputs.ahead = np.full(n, self._period)
        self._speed = np.full(n, CRUISE)
        self._inputs.mean_velocity = self._speed
        self._inputs.mean_sign = np.ones(n)
        self._needed = (
            model.coulomb + model.viscous * self._speed + model.quadratic * (self._speed * self._speed) + model.gravity
        )  # N, friction along the reference
        self._error, self._rate = np.zeros(shape), np.zeros(shape)
        self._net = [np.zeros(shape) for _ in range(2)]  # force less what the reference needs: last, before
        self._index = 0
        self._filter.reseed(np.zeros(shape))
        self._law.reset(np.zeros(shape), model.gravity)

    def _reference(self) -> None:
        inputs, k = self._inputs, self._index
        for reference, instant in ((inputs.sample, k - 1), (inputs.start, k), (inputs.end, k + 1)):
            reference.position = self._speed * self._period * instant
            reference.velocity = self._speed.copy()
            reference.acceleration = np.zeros(self._needed.shape)
        if self._law.preview:
            still = np.zeros(self._needed.shape)
            inputs.preview = [
                Reference(self._speed * self._period * (k + ahead), self._speed.copy(), still.copy())
                for ahead in range(self._law.preview + 1)
            ]

    def step(self, pulse: Array) -> Array:
        """One tick with `pulse` (m) added to the measured error; the measured error."""
        inputs, motion = self._inputs, self._filter
        self._reference()
        last, before = self._net
        seen = self._error + pulse
        inputs.position = inputs.sample.position + seen
        # The rig's filter works on the error here: the loop is linear, and the reference moves without acceleration.
        motion.correct(before, inputs.sample_interval, seen)
        motion.look_ahead(last, inputs.ahead)
        inputs.position_estimate = motion.ahead_position + inputs.start.position
        inputs.velocity_estimate = motion.ahead_velocity + inputs.start.velocity
        inputs.disturbance_estimate = motion.disturbance
        inputs.force_last, inputs.force_before = last + self._needed, before + self._needed
        asked = self._law.force(inputs) - self._needed
        # The sample is from the start of the last period: its force moves the plant to the next sample.
        change = last / self.mass * self._period
        self._error = self._error + (self._rate + 0.5 * change) * self._period
        self._rate = self._rate + change
        self._net = [asked.copy(), last]
        self._index += 1
        return seen

    def motion(self) -> Array:
        """True error after the latest tick, moved on by one period at its rate (m)."""
        return self._error + self._rate * self._period


def pulse_response(rig: RigConfig, ticks: int, plant_gain: float | Array = 1.0) -> tuple[Array, Array]:
    """After a unit pulse on an axis' own measurement: its measured error, and its motion, each (ticks, n_axes).

    The motion is the true error moved on by one period at its rate: a force that alternates from tick to tick shows in
    the speed alone, as every sample falls on a node of the position. plant_gain: nominal mass over the true one, for
    all axes or each (n_axes,), from the pulse on: before, the loop settles from a start that no rig has, at full speed.
    Both less those of a loop without the pulse: an integrator or an observer that has not settled yet still moves.
    """
    model = rig_model(rig)
    n = model.mass.size
    loop = _Loop(rig, model)
    own = (loop.pulsed, np.arange(n))
    quiet, pulse = np.zeros(loop.shape), np.zeros(loop.shape)
    pulse[own] = PULSE

    def beyond(errors: Array) -> Array:
        """Of every axis where it is pulsed, beyond the plant left alone, in pulses."""
        answer: Array = (errors[own] - errors[-1]) / PULSE
        return answer

    with np.errstate(all="ignore"):
        for _ in range(SETTLE):
            loop.step(quiet)
        loop.mass = model.mass / plant_gain
        answer, motion, alone = np.empty((3, ticks, n))
        for k in range(ticks):
            errors = loop.step(pulse if k == 0 else quiet)
            answer[k], alone[k] = beyond(errors), errors[-1]
            motion[k] = beyond(loop.motion())
    unseen = _circles(alone) & (np.abs(motion).max(axis=0) < GROWN)
    answer[:, unseen] = motion[:, unseen] = np.inf
    return answer, motion


def _circles(error: Array) -> Any:
    """Axes (n_axes,) whose loop moves to and fro by itself, of its errors (ticks, n_axes): a limit cycle forgets a
    pulse as a stable loop does. Second differences, for a slow integrator may still be on its way.
    """
    swing = np.abs(np.diff(error, 2, axis=0))
    quarter = max(len(swing) // 4, 1)
    bearable = np.maximum(PULSE, DECAYED * swing[:quarter].max(axis=0))
    return np.logical_not(swing[-quarter:].max(axis=0) <= bearable)


def realise_poles(answer: Array) -> list[complex]:
    """Poles of the system whose impulse response is `answer` (ticks,), largest first."""
    grown = np.flatnonzero(~(np.abs(answer) < GROWN))
    markov = answer[1 : grown[0] if grown.size else None]  # the direct term has no dynamics
    rows = len(markov) // 2
    if rows < 2:
        return [complex(GROWN)]  # out of the linear range at once
    hankel = np.lib.stride_tricks.sliding_window_view(markov, rows)[: len(markov) - rows + 1]
    u, s, v = np.linalg.svd(hankel[:-1])
    order = int(np.sum(s > NEGLIGIBLE * s[0]))
    root = np.sqrt(s[:order])
    a = (u[:, :order] / root).T @ hankel[1:] @ (v[:order].T / root)
    return sorted((complex(z) for z in np.linalg.eigvals(a)), key=lambda z: (-abs(z), z.real, z.imag))


def margins(answer: Array) -> tuple[float | None, float | None, float | None]:
    """Gain margin up and down (factors) and phase margin (degrees) from the pulse response of S; None: none met."""
    loop = 1.0 / np.fft.rfft(answer)[1:] - 1.0
    imag = loop.imag
    crossing = np.flatnonzero((np.sign(imag[:-1]) != np.sign(imag[1:])) & (loop.real[:-1] < 0))
    share = imag[crossing] / (imag[crossing] - imag[crossing + 1])
    real = loop.real[crossing] + share * (loop.real[crossing + 1] - loop.real[crossing])
    factors = -1.0 / real
    size = np.abs(loop)
    unity = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) <= 0)
    angles = np.abs(np.degrees(np.angle(-loop[unity])))
    up, down = factors[factors > 1.0], factors[(factors > 0.0) & (factors < 1.0)]
    return (
        float(up.min()) if up.size else None,
        float(down.max()) if down.size else None,
        float(angles.min()) if angles.size else None,
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
    if high > rate and not stable(high):
        return float("inf")
    if high == rate and stable(low):
        return low
    while high / low > 1.0 + RATE_TOLERANCE:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    return high


def _is_stable(answer: Array, poles: list[complex]) -> bool:
    size = np.abs(answer)
    if not np.all(size < GROWN) or size[-(len(size) // 4) :].max() > DECAYED * size[1:].max():
        return False  # grows, or circles for ever
    return max(map(abs, poles), default=0.0) < STABLE_RADIUS


def refuse_unstable(rig: RigConfig) -> None:
    """For a process about to move something: raises RigError (exit status 78) naming every unstable axis."""
    _, motion = pulse_response(rig, REALISED)
    axes = {}
    for index, name in enumerate(rig.axes):
        poles = realise_poles(motion[:, index])
        axes[name] = AxisStability(_is_stable(motion[:, index], poles), poles, None, None, None)
    problems = StabilityReport(rig.law.name, rig.rate_hz, axes).problems()
    if problems:
        raise RigError(problems)


def _stable_axes(rig: RigConfig) -> Array:
    _, motion = pulse_response(rig, REALISED)
    return np.array([_is_stable(column, realise_poles(column)) for column in motion.T])


def _lowest_rates(rig: RigConfig) -> list[float]:
    """Per axis; every rate tried serves all axes."""
    importlib.import_module("hil.control.estimator.filterpy_design")  # once: every rate needs a filter of its own
    tried: dict[float, Array] = {}

    def stable(axis: int, rate: float) -> bool:
        if rate not in tried:
            tried[rate] = _stable_axes(rig.model_copy(update={"rate_hz": rate}))
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


def check_stability(rig: RigConfig, *, lowest_rate: bool = False, ticks: int = ANSWER) -> StabilityReport:
    """Poles and margins of every axis of the rig's sampled loop; lowest_rate: also search the lowest stable rates.
    ticks: of the answer, at least REALISED; the more, the finer the frequencies at which margins are taken.

    Raises ValueError where the law cannot be made from its gains.
    """
    answer, motion = pulse_response(rig, ticks)
    rates: list[float | None] = [*_lowest_rates(rig)] if lowest_rate else [None] * len(rig.axes)
    differences = _finite_difference_rates(rig) if lowest_rate else rates
    axes = {}
    for index, name in enumerate(rig.axes):
        poles = realise_poles(motion[:REALISED, index])
        stable = _is_stable(motion[:, index], poles)
        found = margins(answer[:, index]) if stable else (None, None, None)
        axes[name] = AxisStability(stable, poles, *found, rates[index], differences[index])
    return StabilityReport(rig.law.name, rig.rate_hz, axes)
