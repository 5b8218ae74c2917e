"""The search of `hil tune --trials drawn`: around the gains that the rig has, judged on drawn stages."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hil.control.laws.base import Array
from hil.rig.schema import RigConfig
from hil.studies.tune import drawn_stages
from hil.studies.tune.drawn_stages import Compared, DrawnBench, compared, drawn_trials, fresh_seeds
from hil.studies.tune.evolution import evolve
from hil.studies.tune.objective import DIGITS, SLACK, Outcome, rounded_to
from hil.studies.tune.search_space import law_gains


class DrawnFound(NamedTuple):
    """One axis: the rig's own gains against the best found, the gains to have from now on, (1,) each, and whether they
    are the rig's own. stated: by the rig file.
    """

    compared: Compared
    gains: Mapping[str, Array]
    kept: bool
    stated: bool


def tune_drawn(
    rig: RigConfig, law: str, axis: int, size: tuple[int, int], seed: int, report: Callable[[Outcome], None],
    *, only: Sequence[str] = (), fresh: int,
) -> DrawnFound:  # fmt: skip
    """Search one axis' gains. size: candidates per generation, and generations. fresh: stages to judge by at the end.
    Raises RigError as DrawnBench.
    """
    searched = DrawnBench(rig, law, axis, drawn_trials(rig, [seed], drawn_stages.STAGES), only, SLACK)

    def cost(points: Array) -> Array:
        outcome = searched.run(points)
        report(outcome)
        return outcome.cost

    best = evolve(cost, searched.known(), *size, np.random.default_rng([seed, axis]))
    found = {name: np.array([rounded_to(DIGITS, value)]) for name, (value,) in searched.gains(best[None]).items()}
    unseen = DrawnBench(rig, law, axis, drawn_trials(rig, fresh_seeds(seed), fresh), only)
    result = compared(searched, unseen, found)
    kept = bool(result.reasons_to_keep())
    return DrawnFound(result, searched.known_gains() if kept else found, kept, bool(found.keys() & law_gains(rig, law)))
