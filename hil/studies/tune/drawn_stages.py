"""Candidates on stages as `hil evidence --measured` draws them, on the rig's own task.

A candidate is judged by its peak and RMS error once the law has learnt, stage by stage against what the gains that the
rig has leave there. Two batches say more so than their medians would: stages differ far more than gains do. It keeps
the margins that `hil check` asks for, on the model and in every corner; one that does not is not even simulated. What
is found counts on stages of other seeds alone.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.analysis.loop_corners import ANSWER, CornerFinding, CornerTrial
from hil.analysis.pulse_loop import loop_of, try_together
from hil.control.laws.base import Array
from hil.control.trajectories import make_trajectory
from hil.rig.schema import RigConfig, RigError
from hil.studies.evidence.stages import OWN, plant_of
from hil.studies.tune import objective
from hil.studies.tune.candidate_simulation import LOST, Figures, Trial
from hil.studies.tune.objective import ANY, NO_MARGINS, PER_DB, PLAN_DWELL_S, Bench, Margins, Outcome

STAGES, FRESH = 10, 60  # of the search, and those that the gains found are judged on
FRESH_SEEDS = (20_000, 20_001, 20_002, 20_003)  # three of them: never the search's
LEARN_S = 4.0  # of a task that repeats
PLAN_CELLS = 3  # of an injection plan; the first is for learning
HARDEST = 0.5  # weight of the stage with the largest error, beside the mean over all
REFUSED = 100.0  # cost of short margins, beside what is missing
CONFIDENCE = 0.95
LARGER = 1.1  # times: so well do 60 stages know a 95 % at best


class OwnTask(NamedTuple):
    """changes: of [task]. learns: s from where its statistics begin that do not count."""

    changes: Mapping[str, Any]
    learns: float


def own_task(rig: RigConfig) -> OwnTask:
    """The rig's task, as long as a search needs it: an injection plan over fewer cells with shorter dwells."""
    if rig.task.kind == "injection" and (plan := rig.task.injection) is not None:
        changes = {"cells": PLAN_CELLS, "dwell_s": min(plan.dwell_s, PLAN_DWELL_S)}
        return OwnTask(
            {"injection": plan.model_copy(update=changes)},
            plan.transfer_s + plan.strike_s + changes["dwell_s"] + plan.withdraw_s,
        )
    path = make_trajectory(rig.task, rig.axis_names, [0.0] * len(rig.axes), rig.period_ns, rig.counts)
    judged = ((path.duration_ns or 0) - path.steady_from_ns) * 1e-9
    return OwnTask({}, min(LEARN_S, 0.5 * judged) if path.duration_ns else LEARN_S)


def drawn_trials(rig: RigConfig, seeds: Sequence[int], count: int) -> list[Trial]:
    """The rig's own task on so many stages, drawn from the seeds in turn."""
    changes, learns = own_task(rig)
    found = []
    for index in range(count):
        seed, number = seeds[index % len(seeds)], index // len(seeds)
        plant = plant_of(rig, seed, number, None)
        stage = {name: getattr(plant, name) for name in type(plant).model_fields if name not in OWN}
        found.append(Trial(f"stage {seed}-{number}", changes, 1.0, plant=stage, brief=True, learns=learns))
    return found


def fresh_seeds(seed: int) -> list[int]:
    """Of the stages that gains found from that seed are judged on."""
    return [other for other in FRESH_SEEDS if other != seed][:3]


def shortfall(finding: CornerFinding, slack: Margins = ANY) -> float:
    """Decibels that an axis lacks there to what `hil check` asks for; as Margins.short."""
    gain_db, phase_deg = finding.asked
    met = Margins(finding.gain_db, finding.phase_deg) if finding.stable else NO_MARGINS
    return met.short(Margins(gain_db + slack.gain_db, phase_deg + slack.phase_deg if phase_deg else 0.0))


class Loop(NamedTuple):
    """Of one candidate: on the model as it is, and in the first corner that lacks margins, if one does; what it lacks
    there, dB.
    """

    nominal: CornerFinding
    short: CornerFinding | None
    lacks_db: float


class DrawnBench(Bench):
    """Runs candidates of one law for one axis on drawn stages. Raises RigError where the rig has no gains to compare
    with. slack: beyond the margins asked for.
    """

    def __init__(
        self, rig: RigConfig, law: str, axis: int, chosen: Sequence[Trial], only: Sequence[str] = (),
        slack: Margins = ANY,
    ) -> None:  # fmt: skip
        super().__init__(rig, law, axis, chosen, ANY, only)
        self._slack = slack
        if lacking := self.space.keys() - self.known_gains().keys():
            raise RigError(
                [f"--trials drawn: {law} has no {', '.join(sorted(lacking))} to compare with; try --trials stage first"]
            )

    def lost(self, figures: Figures) -> NDArray[np.bool_]:
        """Which stages a run would have ended on, (candidates, stages): by the following error that the rig allows."""
        found: NDArray[np.bool_] = figures.ever >= list(self.rig.axes.values())[self.axis].limits.following_error
        return found

    def loops(self, gains: Mapping[str, Array], ticks: int = ANSWER) -> list[Loop]:
        """Of every candidate, as `hil check` tries them. ticks: of the answers."""
        copied = self.copies(gains)
        trial = CornerTrial(copied, ticks)
        try_together(loop_of(copied, [trial]), [trial])
        return [self._loop(trial.of_axis(index)) for index in range(len(copied.axes))]

    def _loop(self, corners: Iterator[CornerFinding]) -> Loop:
        """The nominal one comes first. Not all are worked out: an unfit candidate costs a tenth of a fit one."""
        nominal = next(corners)
        for finding in chain([nominal], corners):
            if (lacks_db := shortfall(finding, self._slack)) > 0.0:
                return Loop(nominal, finding, lacks_db)
        return Loop(nominal, None, 0.0)

    def judge(self, gains: Mapping[str, Array]) -> Outcome:
        """See Bench. ratio, median: error against that of the rig's own gains, mean and median over the stages
        (geometric, of peak and RMS).
        """
        loops = self.loops(gains, objective.ANSWER)
        short = np.array([loop.lacks_db for loop in loops])
        nominal = [loop.nominal for loop in loops]
        gain_db, phase_deg = np.array([(one.gain_db, one.phase_deg) if one.stable else NO_MARGINS for one in nominal]).T
        sound = np.flatnonzero(short == 0.0)
        error, ratio, median, chatter = (np.full(short.shape, LOST) for _ in range(4))
        cost = REFUSED + PER_DB * short
        if sound.size:
            tried = {name: np.concatenate([own, gains[name][sound]]) for name, own in self.known_gains().items()}
            figures = self.figures(tried)
            peak, rms = (np.where(self.lost(figures), LOST, each) for each in (figures.largest, figures.rms))
            logs = log_ratios(peak, rms)
            hardest = log_ratios(*(each.max(axis=1, keepdims=True) for each in (peak, rms)))
            error[sound] = peak[1:].max(axis=1)
            ratio[sound], median[sound] = np.exp(logs.mean(axis=1)), np.exp(np.median(logs, axis=1))
            chatter[sound] = figures.chatter[1:].max(axis=1)
            cost[sound] = logs.mean(axis=1) + HARDEST * hardest[:, 0] + 2.0 * self.loud(chatter[sound])
        return Outcome(error, ratio, median, chatter, gain_db, phase_deg, cost)


def log_ratios(peak: Array, rms: Array) -> Array:
    """Of all rows but the first (candidates, stages) against the first: logarithms, mean of peak and RMS."""
    found: Array = 0.5 * sum(np.log(each[1:] / each[0]) for each in (peak, rms))
    return found


class StageFigures(NamedTuple):
    """Of one candidate's gains: peak and RMS error (stages,), m, and which stages its following error lost."""

    peak: Array
    rms: Array
    lost: NDArray[np.bool_]

    def quantile(self, figure: str, share: float) -> float:
        """Of "peak" or "rms", m; as `hil evidence` has it: a lost stage is worse than all others."""
        return float(np.quantile(np.where(self.lost, np.inf, getattr(self, figure)), share, method="higher"))


class Paired(NamedTuple):
    """How much less or more error, logarithmic: mean over the stages, and its interval by CONFIDENCE."""

    mean: float
    low: float
    high: float


def paired(before: StageFigures, after: StageFigures) -> Paired:
    """Over the stages that neither lost; at least 2, else it is anything."""
    from scipy.special import stdtrit  # it takes long to import

    both = ~(before.lost | after.lost)
    if both.sum() < 2:
        return Paired(0.0, -np.inf, np.inf)
    logs = log_ratios(*(np.stack([getattr(one, name)[both] for one in (before, after)]) for name in ("peak", "rms")))[0]
    half = float(stdtrit(logs.size - 1, 0.5 + 0.5 * CONFIDENCE) * logs.std(ddof=1) / np.sqrt(logs.size))
    return Paired(float(logs.mean()), float(logs.mean()) - half, float(logs.mean()) + half)


class Compared(NamedTuple):
    """The rig's own gains and the best found: on the search's stages, on fresh ones; their loops."""

    searched: tuple[StageFigures, StageFigures]
    fresh: tuple[StageFigures, StageFigures]
    loops: tuple[Loop, Loop]

    @property
    def change(self) -> Paired:
        """On the fresh stages."""
        return paired(*self.fresh)

    def reasons_to_keep(self) -> list[str]:
        """Why the rig's own gains stand; empty: those found are better."""
        old, new = self.fresh
        (_, lacked, _), (_, lacking, _) = self.loops
        if lacking is not None:
            return [f"those found lack margins, {lacking.corner}: {lacking.shortfall()}"]
        if new.lost.sum() > old.lost.sum():
            return [f"those found lost {new.lost.sum()} fresh stages, not {old.lost.sum()}"]
        if lacked is not None:
            return []
        found = [] if self.change.high < 0.0 else ["the mean error on fresh stages is not surely less"]
        for figure, name in (("peak", "peak"), ("rms", "RMS error")):
            if new.quantile(figure, 0.95) > LARGER * old.quantile(figure, 0.95):
                found.append(f"the 95 % of the {name} on fresh stages is more than a tenth larger")
        return found


def compared(searched: DrawnBench, fresh: DrawnBench, found: Mapping[str, Array]) -> Compared:
    """Benches with the stages of the search, and with fresh ones. found: gains, (1,) each."""
    both = {name: np.concatenate([own, found[name]]) for name, own in fresh.known_gains().items()}
    (before, after), (old, new), loops = _figures(searched, both), _figures(fresh, both), fresh.loops(both)
    return Compared((before, after), (old, new), (loops[0], loops[1]))


def _figures(bench: DrawnBench, gains: Mapping[str, Array]) -> list[StageFigures]:
    """Of every candidate."""
    found = bench.figures(gains)
    return list(map(StageFigures, found.largest, found.rms, bench.lost(found)))
