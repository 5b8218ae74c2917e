"""What candidates of `hil tune` are tried on, tasks and plants, and the cost of what they do there.

The simulation is hil/studies/tune/candidate_simulation.py: a whole generation of candidates, times all trials, is one
batch through the cycle's own arithmetic. The margins are those of `hil check`.
"""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from hil.analysis.stability import AxisStability, check_stability
from hil.control.estimator.gains import per_axis
from hil.control.gain import Knob, declared
from hil.control.law_registry import law_class
from hil.control.laws.base import Array
from hil.rig.schema import InjectionConfig, RigConfig, RigError
from hil.studies.population import CORNERS
from hil.studies.tune.candidate_simulation import CandidateSimulation, Figures, Trial
from hil.studies.tune.search_space import knob_scale, law_gains, law_of, own_gains, space_of
from hil.studies.tune.stage_trials import StageTrials

SETTLE_S = 4.0
WINDOW_S = 4.0
PLAN_DWELL_S = 0.3  # of the injection plan's dwells, where they need not be as long as they are
PLAN_COUNTS, FAR_COUNTS = 4.0, 30.0  # RMS over the plan, encoder counts: near the rig's own plant, and in its corners
UNSEEN_SEED = 20_000  # of the plants found gains are judged on: no option, so that nobody searches for a lucky one
SMALLER = 0.05  # from one repeat of the figures to the next
QUIET = 0.03  # of the force limit: RMS change of force from tick to tick that costs nothing
PER_DB = 3.0  # cost of a decibel of gain margin too few: what an error e times as large in every trial costs
ANSWER = 1000  # ticks of the loops' answers: what a candidate is worth; the gains found are checked as by `hil check`
DB_PER_DEGREE = 0.2  # 6 dB and 30 degrees are the textbook's least margins: each as dear as the other


class Kind(StrEnum):
    """On what candidates are tried: the rig's task and its like alone; forces, cogging, a Stribeck peak and small moves
    as well; or friction by distance, lag and mode, too. Or on stages as `hil evidence --measured` draws them
    (hil/studies/tune/drawn_stages.py).
    """

    TASK = "task"
    IDEAL = "ideal"
    STAGE = "stage"
    DRAWN = "drawn"


def kind_for(rig: RigConfig, law: str = "") -> Kind:
    """What the rig says its stage is like. A law whose gains follow from the model has those of every such stage: what
    is left to gain is on this one. law: "" is the rig's own.
    """
    if any(knob.scale == "own" for knob in space_of(rig, law or rig.law.name).values()):
        return Kind.DRAWN
    real = any(StageTrials(rig, axis).is_real for axis in range(len(rig.axes)))
    return Kind.STAGE if real else Kind.IDEAL


def trials(rig: RigConfig, repeats: int = 1) -> list[Trial]:
    """The rig's own task, variations of it in size and speed, light and heavy plants, for figures other kinds of task
    and commands lost as well. Gains found on one task alone do not generalise (docs/paper.md).

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


def trials_of(rig: RigConfig, axis: int, kind: Kind, repeats: int = 1) -> list[Trial]:
    """What one axis' candidates are searched on. Raises RigError as `trials`."""
    found, stage = trials(rig, repeats), StageTrials(rig, axis)
    found += stage.ideal() if kind is not Kind.TASK else []
    return found + (stage.real() if kind is Kind.STAGE else [])


def unseen_trials(rig: RigConfig, axis: int, kind: Kind, count: int) -> list[Trial]:
    """As many plants as `count`, none of which is among `trials_of`: the rig's own task, and moves, on plants drawn
    from a seed of their own.
    """
    if kind is not Kind.TASK:
        return StageTrials(rig, axis).unseen(count, UNSEEN_SEED, real=kind is Kind.STAGE)
    random, known = np.random.default_rng([UNSEEN_SEED, axis]), trials(rig)
    off = list(rig.axes.values())[axis].tolerances

    def scale(share: float) -> float:
        return float(random.uniform(1.0 - share, 1.0 + share))

    return [
        known[index % len(known)]._replace(name=f"unseen {index}", mass=scale(off.mass), friction=scale(off.friction))
        for index in range(count)
    ]


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
        "light, sticky": Trial("", own, 4.0, *CORNERS["light, sticky"]),
        "heavy, slippery": Trial("", own, 4.0, *CORNERS["heavy, slippery"]),
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
        *(Trial(f"far, {plant}", cells(1), FAR_COUNTS, *plant, rms=True) for plant in CORNERS.values()),
    ]


class Margins(NamedTuple):
    """Of a loop: how many decibels its gain may rise or fall, whichever is less, and degrees of phase it may lose."""

    gain_db: float
    phase_deg: float

    def short(self, least: "Margins") -> float:
        """What is missing to the least margins, in decibels; a degree counts as DB_PER_DEGREE."""
        phase = max(least.phase_deg - self.phase_deg, 0.0) * DB_PER_DEGREE
        return max(least.gain_db - self.gain_db, 0.0) + phase


ANY = Margins(0.0, 0.0)
DIGITS = 4  # of gains
SLACK = Margins(0.05, 0.3)  # beyond the margins asked for: the gains are rounded to DIGITS
NO_MARGINS = Margins(-20.0, 0.0)  # of an unstable loop: dearer than any error


def rounded_to(digits: int, value: float) -> float:
    """The value with so many significant digits."""
    return float(f"{float(value):.{digits}g}")


def margins_of(axis: AxisStability) -> Margins:
    """Infinite where nothing is met; NO_MARGINS where the axis is unstable."""
    if not axis.stable:
        return NO_MARGINS
    return Margins(axis.gain_db, axis.phase_deg)


class Outcome(NamedTuple):
    """Per candidate: error in the trial that did worst by its own measure (m), and as a multiple of what is good there;
    the median of those multiples. Then chatter (N); gain margin (dB, NO_MARGINS' where unstable) and phase margin
    (degrees); cost.
    """

    error: Array
    ratio: Array
    median: Array
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
        own = own_gains(rig, law)
        known = {name: values.tolist() for name, values in own.items()} | law_gains(rig, law)
        self._known = {name: value for name, value in known.items() if name in self.space}
        self._fixed = {
            name: value if isinstance(value, str) else float(per_axis(value, len(rig.axes))[axis])
            for name, value in known.items()
            if name not in self.space
        }
        first = last = None
        if rig.task.kind != "injection":
            first, last = (round(seconds * rig.rate_hz) for seconds in (SETTLE_S, SETTLE_S + WINDOW_S))
        # Trials of the rig's task together, and those of the stage, which are much shorter.
        self.trials.sort(key=lambda trial: trial.brief)
        self._law = law_of(rig, law)
        ahead = law_class(self._law).preview
        self._simulations = []
        for brief, window in ((False, (first, last)), (True, (None, None))):
            if together := [trial for trial in self.trials if trial.brief is brief]:
                self._simulations.append(CandidateSimulation(rig, axis, together, *window, 1, preview=ahead))
        model, self._limit = self._simulations[0].model, self._simulations[0].limit
        resolution = [*rig.axes.values()][axis].encoder_resolution
        self._good = np.array([trial.good for trial in self.trials]) * resolution
        self._scale = [
            float(own[name][axis])
            if name in own
            else float(knob_scale(knob, model, rig.period_ns * 1e-9, self._limit, resolution)[0])
            for name, knob in self.space.items()
        ]
        defaults: dict[str, Any] = {key: gain.default for key, gain in declared(law_class(self._law).GAINS).items()}
        self._apart = self._fixed | {key: value for key, value in defaults.items() if key not in known}

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

    def known_gains(self) -> dict[str, Array]:
        """The same gains as they are, (1,) each, within the ranges or not; without those that the file has not."""
        return {name: per_axis(value, len(self.rig.axes))[[self.axis]] for name, value in self._known.items()}

    def run(self, points: Array) -> Outcome:
        """Every trial of every point (candidates, knobs)."""
        return self.judge(self.gains(points))

    def judge(self, gains: Mapping[str, Array]) -> Outcome:
        """Every trial of every candidate; gains: (candidates,) each, of a knob that is not named the law's default."""
        figures = self.figures(gains)
        by_rms = np.array([trial.rms for trial in self.trials])
        errors = np.where(by_rms, figures.rms, figures.largest)
        ratios = errors / self._good
        worst = ratios.argmax(axis=1)
        rows = np.arange(len(errors))
        chatter = figures.chatter.max(axis=1)
        loud = self.loud(chatter)
        logs = np.log(ratios)
        margins = self.margins(gains)
        short = np.array([PER_DB * each.short(self._least) for each in margins])
        cost = logs.mean(axis=1) + 2.0 * logs.max(axis=1) + 2.0 * loud + short
        gain_db, phase_deg = np.array(margins).T
        median = np.median(ratios, axis=1)
        return Outcome(errors[rows, worst], ratios[rows, worst], median, chatter, gain_db, phase_deg, cost)

    def figures(self, gains: Mapping[str, Array]) -> Figures:
        """What every candidate does in every trial; gains as in `judge`."""
        found = [simulation.run(self._law, gains, self._fixed) for simulation in self._simulations]
        return Figures(*(np.concatenate(parts, axis=1) for parts in zip(*found, strict=True)))

    def loud(self, chatter: Array) -> Array:
        """Noise that shakes the drives is no price for accuracy: N beyond a few per cent of the limit, logarithmic."""
        found: Array = np.log(np.maximum(chatter / (QUIET * self._limit), 1.0))
        return found

    def margins(self, gains: Mapping[str, Array]) -> list[Margins]:
        """One per candidate: `hil check` on a rig that has one copy of the axis for every candidate."""
        report = check_stability(self.copies(gains), kicked=False, ticks=ANSWER)
        return [margins_of(axis) for axis in report.axes.values()]

    def copies(self, gains: Mapping[str, Array]) -> RigConfig:
        """The rig with one copy of the axis for every candidate."""
        rig, count = self.rig, next(iter(gains.values())).size if gains else 1
        lists = {name: values.tolist() for name, values in gains.items()}
        law = self._law.model_copy(update={"gains": {**self._fixed, **lists}, "tuned": {}})
        noises = ("disturbance_noise", "acceleration_noise")
        estimator = rig.estimator.model_copy(
            update={name: float(per_axis(getattr(rig.estimator, name), len(rig.axes))[self.axis]) for name in noises}
            | {"parameters": rig.estimator.parameters_of(self.axis)}
        )
        copies = dict.fromkeys((f"c{index}" for index in range(count)), [*rig.axes.values()][self.axis])
        return rig.model_copy(update={"law": law, "estimator": estimator, "axes": copies})
