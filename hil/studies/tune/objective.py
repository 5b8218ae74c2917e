"""What `hil tune` searches: every law's knobs, the tasks and plants that candidates are tried on, and their price.

The simulation is hil/studies/tune/rehearsal.py: a whole generation of candidates, times all trials, is one batch
through the cycle's own arithmetic. The margins are those of `hil check`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from hil.control.estimator.gains import per_axis
from hil.control.laws import LAWS
from hil.control.laws.base import Array, Model
from hil.control.stability import AxisStability, check_stability
from hil.rig.schema import InjectionConfig, RigConfig, RigError
from hil.studies.tune.rehearsal import Rehearsal, Trial

CORNERS = ((1.0, 1.0), (0.8, 0.7), (0.8, 1.3), (1.2, 0.7), (1.2, 1.3))  # scales of mass and friction
SETTLE_S = 4.0
WINDOW_S = 4.0
PLAN_DWELL_S = 0.3  # of the injection plan's dwells, where they need not be as long as they are
PLAN_COUNTS, FAR_COUNTS = 4.0, 30.0  # RMS over the plan, encoder counts: near the rig's own plant, and in its corners
SMALLER = 0.05  # from one repeat of the figures to the next
QUIET = 0.03  # of the force limit: RMS change of force from tick to tick that costs nothing
PER_DB = 3.0  # cost of a decibel of gain margin too few: what an error e times as large in every trial costs
ANSWER = 1000  # ticks of the loops' answers: what a candidate is worth; the gains found are checked as by `hil check`
DB_PER_DEGREE = 0.2  # 6 dB and 30 degrees are the textbook's least margins: each as dear as the other


class Knob(NamedTuple):
    """One gain's search range, logarithmic; `scale` makes it a gain, by nominal mass and Coulomb friction, rate, force
    limit and encoder.

    of: another knob, whose gain this one is given in. density: in time (per sqrt(s)), so the same at every rate.
    """

    low: float
    high: float
    scale: str = "1"
    of: str = ""
    density: bool = False


def _pd(**more: Knob) -> dict[str, Knob]:
    return {"kp": Knob(0.01, 0.2, "m/T2"), "kd": Knob(0.1, 0.9, "m/T"), **more}


def _learnt(low: float, high: float, scale: str) -> Knob:
    """Noise of a parameter of the disturbance: how much of a force as large as that of the acceleration's noise is put
    down to it per period.
    """
    return Knob(low, high, scale, "acceleration_noise", density=True)


# Near rest nu is a damping of rho^2 / epsilon.
_ROBUST = {"alpha": Knob(1e-3, 0.2, "1/T"), "epsilon": Knob(0.05, 100.0, "T/m")}
SPACE: dict[str, dict[str, Knob]] = {
    "pd-feedforward": _pd(),
    "pid": _pd(ki=Knob(1e-4, 1e-2, "m/T3")),
    "computed-torque": _pd(sign_width=Knob(1e-3, 0.5)),  # narrower than coulomb over kd it circles at rest
    "robust-pd": _pd(**_ROBUST),
    "robust-pd-filtered-error": _pd(**_ROBUST),
    "robust-pd-alpha-brackets": {  # alpha stands before kp and kd
        "kp": Knob(0.02, 5.0, "m/T"),
        "kd": Knob(0.1, 100.0, "m"),
        "alpha": Knob(5e-3, 0.3, "1/T"),
        "epsilon": _ROBUST["epsilon"],
    },
    "sliding-mode": {"rate": Knob(0.02, 0.4, "1/T"), "reach": Knob(0.02, 0.5, "F"), "layer": Knob(1e-3, 1.0)},
    "super-twisting": {
        "rate": Knob(0.02, 0.4, "1/T"),
        "k1": Knob(1e-3, 1.0, "F"),
        "k2": Knob(0.1, 100.0, "F"),
        "linear": Knob(0.02, 0.5, "m/T"),
        "smooth": Knob(1e-3, 1e-1),
    },
    "slotine-li": {
        "rate": Knob(0.02, 0.4, "1/T"),
        "kd": Knob(0.05, 0.5, "m/T"),
        "mass_gain": Knob(1e-7, 1e-2),
        "coulomb_gain": Knob(0.1, 1e3),
        "viscous_gain": Knob(1e-3, 1e2),
        "bias_gain": Knob(0.1, 1e3),
    },
    "disturbance-observer": _pd(bandwidth=Knob(0.05, 1.5, "1/T")),
    # What a filter does with a sample depends on ratios: of the acceleration's noise to the encoder's, and of a slow
    # parameter's noise to the acceleration's, which is how quickly it is learnt.
    "structured-kalman": {
        "bandwidth": Knob(0.15, 0.45),
        "damping": Knob(0.4, 1.2),
        "acceleration_noise": Knob(1.0, 3e3, "count/T1.5", density=True),
        "reversal_noise": Knob(1e-2, 1.0),
        "bias_noise": _learnt(1e-5, 0.3, "m/T"),
        "coulomb_noise": _learnt(3e-3, 1.0, "m/T"),
        "viscous_noise": _learnt(1e-3, 1.0, "m2/FT2"),
        "mass_noise": _learnt(0.03, 30.0, "m2/FT"),
        "measurement_noise": Knob(0.29, 1.0, "count"),
    },
}
# Injection: a stage believed to a few per cent, at rest again and again, that has to be right at once. So the filter's
# beginnings and its creep up to breakaway count, and everything is sized by the mass and friction believed.
PLAN_SPACE: dict[str, dict[str, Knob]] = {
    "structured-kalman": {
        "bandwidth": Knob(0.15, 0.35),
        "damping": Knob(0.6, 1.0),
        "acceleration_noise": Knob(5e-5, 1e-3),
        "reversal_noise": Knob(5e-3, 0.1),
        "bias_noise": Knob(3e-4, 0.1, "C"),
        "coulomb_noise": Knob(3e-3, 0.1, "C"),
        "mass_noise": Knob(0.01, 1.0, "m"),
        "measurement_noise": Knob(0.5, 1.0, "count"),
        "bias_prior": Knob(1e-3, 1.0, "C"),
        "coulomb_prior": Knob(0.03, 1.0, "C"),
        "viscous_prior": Knob(0.03, 0.5, "C"),
        "mass_prior": Knob(0.01, 0.1, "m"),
        "breakaway_rate": Knob(5.0, 50.0, "C"),
    },
}


def space_of(rig: RigConfig, law: str) -> dict[str, Knob]:
    """A law's knobs on the rig's task."""
    own = PLAN_SPACE if rig.task.kind == "injection" else SPACE
    return own.get(law, SPACE[law])


def knob_scale(knob: Knob, model: Model, period: float, force_limit: Array, resolution: float) -> Array:
    """What a knob's number is multiplied by, (n_axes,); resolution: m per encoder count."""
    one = np.ones_like(model.mass)
    scale: Array = {
        "1": one,
        "1/T": one / period,
        "m": model.mass * one,
        "m/T": model.mass / period,
        "T/m": period / model.mass,
        "m/T2": model.mass / period**2,
        "m/T3": model.mass / period**3,
        "m2/FT": model.mass**2 / (force_limit * period),
        "m2/FT2": model.mass**2 / (force_limit * period**2),
        "F": force_limit * one,
        "C": model.coulomb * one,
        "count": resolution * one,
        "count/T1.5": resolution * one / period**1.5,
    }[knob.scale]
    return scale


def trials(rig: RigConfig, repeats: int = 1) -> list[Trial]:
    """The rig's own task, variations of it in size and speed, light and heavy plants, for figures other kinds of task
    and commands lost as well: gains found on one task alone do not generalise (PAPER.md).

    repeats: of every figure, each SMALLER than the one before. Raises RigError where the task is none.
    """
    task = rig.task
    if task.kind in ("circle", "lissajous"):
        return [trial for turn in range(repeats) for trial in _figure_trials(rig, 1.0 - SMALLER * turn)]
    if repeats > 1:
        raise RigError([f"--repeats {repeats}: task.kind = '{task.kind}' has no sizes; 1 is its only value here"])
    if task.kind == "injection" and task.injection is not None:
        return _plan_trials(task.injection)
    return [Trial("own task", {}, 4.0)]


def _figure_trials(rig: RigConfig, whole: float) -> list[Trial]:
    """whole: size of all of them, 1 for the rig's own."""
    task = rig.task
    error = 0.06  # of the force limit: what friction exceeds the model by; the paper's Delta of 0.3 N at its 5 N

    def figure(size: float, speed: float, **more: Any) -> dict[str, Any]:
        shape = {"radius": whole * size * task.radius, "frequency_hz": speed * task.frequency_hz, "phase": 0.0}
        return {"approach_s": min(task.approach_s, 1.0), **shape, **more}

    def there_and_back(size: float, seconds: float) -> dict[str, Any]:
        target = [whole * size * task.radius] * len(task.axes)
        return {"kind": "point_to_point", "target": target, "move_s": seconds, "dwell_s": 0.5}

    own = figure(1.0, 1.0)
    late = 2.0 * math.pi * task.frequency_hz * 0.3 * rig.period_ns * 1e-9
    chosen = {
        "own task": Trial("", own, 4.0),
        "light, sticky": Trial("", own, 4.0, *CORNERS[2]),
        "heavy, slippery": Trial("", own, 4.0, *CORNERS[3]),
        "own, late commands": Trial("", own, 12.0, jitter=50e-6),
        "own, lost commands": Trial("", own, 8.0, loss=0.01),
        "own, off the grid": Trial("", figure(1.0, 1.0, phase=-late), 20.0),
        "small and quick": Trial("", figure(0.001, 2.0), 7.0),
        "small and slow": Trial("", figure(0.001, 0.4), 7.0),
        "quick": Trial("", figure(0.1, 2.0), 7.0),
        "slow": Trial("", figure(0.2, 0.25), 7.0),
        "slow Lissajous": Trial("", figure(0.5, 0.5, kind="lissajous"), 7.0),
        "long moves": Trial("", there_and_back(0.5, 1.0), 7.0),
        "moves": Trial("", there_and_back(0.1, 1.0), 7.0),
        "short moves": Trial("", there_and_back(0.001, 0.5), 7.0),
    }
    ending = f", {whole:.0%}" if whole < 1.0 else ""
    return [trial._replace(name=name + ending, error=error) for name, trial in chosen.items()]


def _plan_trials(plan: InjectionConfig) -> list[Trial]:
    dwell = min(plan.dwell_s, PLAN_DWELL_S)

    def cells(number: int, scale: float = 1.0, dwell_s: float = dwell) -> dict[str, Any]:
        changes = {
            "cells": number,
            "dwell_s": dwell_s,
            "pitch": [scale * length for length in plan.pitch],
            "approach_s": scale * plan.approach_s,
            "transfer_s": scale * plan.transfer_s,
        }
        return {"injection": plan.model_copy(update=changes)}

    return [
        Trial("two cells", cells(2), PLAN_COUNTS, rms=True),
        Trial("a fifth quicker", cells(2, 0.8), PLAN_COUNTS, rms=True),
        Trial("a fifth slower", cells(1, 1.2, 4.0 * dwell), PLAN_COUNTS, rms=True),
        # A few per cent off the rig's own plant, as a stage is from one day to the next.
        Trial("heavier, stickier", cells(2), PLAN_COUNTS, 1.02, 1.08, rms=True),
        Trial("lighter, late commands", cells(2), PLAN_COUNTS, 0.98, 0.92, jitter=50e-6, rms=True),
        *(Trial(f"far, {plant}", cells(1), FAR_COUNTS, *plant, rms=True) for plant in CORNERS[1:]),
    ]


def law_gains(rig: RigConfig, law: str) -> dict[str, Any]:
    """The rig file's gains for a law; [law.gains] belongs to the law the file names."""
    return rig.law.effective_gains() if law == rig.law.name else dict(rig.law.tuned.get(law, {}))


class Margins(NamedTuple):
    """Of a loop: how many decibels its gain may rise or fall, whichever is less, and degrees of phase it may lose."""

    gain_db: float
    phase_deg: float

    def short(self, least: "Margins") -> float:
        """What is missing to the least margins, in decibels; a degree counts as DB_PER_DEGREE."""
        phase = max(least.phase_deg - self.phase_deg, 0.0) * DB_PER_DEGREE
        return max(least.gain_db - self.gain_db, 0.0) + phase


ANY = Margins(0.0, 0.0)
NO_MARGINS = Margins(-20.0, 0.0)  # of an unstable loop: dearer than any error


def margins_of(axis: AxisStability) -> Margins:
    """Infinite where nothing is met; NO_MARGINS where the axis is unstable."""
    if not axis.stable:
        return NO_MARGINS
    up, down = axis.gain_margin or math.inf, axis.gain_margin_down or 0.0
    factor = min(up, 1.0 / down if down else math.inf)
    phase = math.inf if axis.phase_margin_deg is None else axis.phase_margin_deg
    return Margins(20.0 * math.log10(factor) if factor < math.inf else math.inf, phase)


def at_rate(rig: RigConfig, law: str, gains: Mapping[str, Any], rate_hz: float) -> dict[str, Any]:
    """Gains found at the rig's rate as they are at another: by how their unit scales with the period."""
    n, old, new = len(rig.axes), rig.period_ns * 1e-9, 1.0 / rate_hz
    one = Model(*(np.ones(n) for _ in fields(Model)))
    scaled = dict(gains)
    for name, knob in space_of(rig, law).items():
        if name in gains and not knob.density:
            factor = knob_scale(knob, one, new, np.ones(n), 1.0) / knob_scale(knob, one, old, np.ones(n), 1.0)
            scaled[name] = (per_axis(gains[name], n) * factor).tolist()
    return scaled


class Outcome(NamedTuple):
    """Per candidate: error in the trial that did worst by its own measure (m), and as a multiple of what is good there;
    chatter (N); gain margin (dB, NO_MARGINS' where unstable) and phase margin (degrees); cost.
    """

    error: Array
    ratio: Array
    chatter: Array
    gain_db: Array
    phase_deg: Array
    cost: Array


class Bench:
    """Runs candidates of one law for one axis on every trial. least: margins below which candidates pay. only: knobs
    to turn, all if empty; the others stay as the rig file has them.
    """

    def __init__(
        self, rig: RigConfig, law: str, axis: int, chosen: Sequence[Trial] | None = None, least: Margins = ANY,
        only: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.rig, self.law, self.axis = rig, law, axis
        self.space = {name: knob for name, knob in space_of(rig, law).items() if not only or name in only}
        self.trials = list(chosen or trials(rig))
        self._least = least
        known = law_gains(rig, law)
        self._known = {name: value for name, value in known.items() if name in self.space}
        self._fixed = {
            name: value if isinstance(value, str) else float(per_axis(value, len(rig.axes))[axis])
            for name, value in known.items()
            if name not in self.space
        }
        first = last = None
        if rig.task.kind != "injection":
            first, last = (round(seconds * rig.rate_hz) for seconds in (SETTLE_S, SETTLE_S + WINDOW_S))
        self._rehearsal = Rehearsal(rig, axis, self.trials, first, last, 1)
        resolution = [*rig.axes.values()][axis].encoder_resolution
        self._good = np.array([trial.good for trial in self.trials]) * resolution
        self._scale = [
            float(knob_scale(knob, self._rehearsal.model, rig.period_ns * 1e-9, self._rehearsal.limit, resolution)[0])
            for knob in self.space.values()
        ]
        self._apart = self._fixed | {key: value for key, value in LAWS[law].GAINS.items() if key not in known}

    def gains(self, points: Array) -> dict[str, Array]:
        """Gains (candidates,) of points (candidates, knobs) in the logarithmic unit cube."""
        plain = {
            name: knob.low * (knob.high / knob.low) ** points[..., index] * scale
            for index, ((name, knob), scale) in enumerate(zip(self.space.items(), self._scale, strict=True))
        }
        return {name: values * self._unit(self.space[name], plain) for name, values in plain.items()}

    def _unit(self, knob: Knob, gains: Mapping[str, Array]) -> Any:
        """The gain that a knob's is given in, where there is one; of a knob that is not turned, its value."""
        return (gains if knob.of in self.space else self._apart)[knob.of] if knob.of else 1.0

    def point(self, gains: Mapping[str, Any]) -> Array:
        """The point (knobs,) of known gains (a number or one per axis); the middle where one is not given."""
        point = np.full(len(self.space), 0.5)
        known = {name: per_axis(gains[name], len(self.rig.axes))[self.axis] for name in self.space if name in gains}
        units = self.gains(point) | known
        for index, ((name, knob), scale) in enumerate(zip(self.space.items(), self._scale, strict=True)):
            if name in known:
                ratio = float(known[name] / self._unit(knob, units)) / scale / knob.low
                point[index] = math.log(max(ratio, 1e-12)) / math.log(knob.high / knob.low)
        clipped: Array = np.clip(point, 0.0, 1.0)
        return clipped

    def known(self) -> Array:
        """The point (knobs,) of the rig file's gains for this law."""
        return self.point(self._known)

    def run(self, points: Array) -> Outcome:
        """Every trial of every point (candidates, knobs)."""
        gains = self.gains(points)
        figures = self._rehearsal.run(self.law, gains, self._fixed)
        by_rms = np.array([trial.rms for trial in self.trials])
        errors = np.where(by_rms, figures.rms, figures.largest)
        ratios = errors / self._good
        worst = ratios.argmax(axis=1)
        rows = np.arange(len(points))
        # Noise that shakes the drives is no price for accuracy: chatter counts beyond a few per cent of the limit.
        chatter = figures.chatter.max(axis=1)
        loud = np.log(np.maximum(chatter / (QUIET * self._rehearsal.limit), 1.0))
        logs = np.log(ratios)
        margins = self.margins(gains)
        short = np.array([PER_DB * each.short(self._least) for each in margins])
        cost = logs.mean(axis=1) + 2.0 * logs.max(axis=1) + 2.0 * loud + short
        gain_db, phase_deg = np.array(margins).T
        return Outcome(errors[rows, worst], ratios[rows, worst], chatter, gain_db, phase_deg, cost)

    def margins(self, gains: Mapping[str, Array]) -> list[Margins]:
        """One per candidate: `hil check` on a rig that has one copy of the axis for every candidate."""
        rig, count = self.rig, next(iter(gains.values())).size
        lists = {name: values.tolist() for name, values in gains.items()}
        law = rig.law.model_copy(update={"name": self.law, "gains": {**self._fixed, **lists}, "tuned": {}})
        noises = ("disturbance_noise", "acceleration_noise")
        estimator = rig.estimator.model_copy(
            update={name: float(per_axis(getattr(rig.estimator, name), len(rig.axes))[self.axis]) for name in noises}
        )
        copies = dict.fromkeys((f"c{index}" for index in range(count)), [*rig.axes.values()][self.axis])
        copied = rig.model_copy(update={"law": law, "estimator": estimator, "axes": copies})
        report = check_stability(copied, ticks=ANSWER)
        return [margins_of(axis) for axis in report.axes.values()]
