"""Many stages under one rig: how far they are off, how they are drawn, and how they run.

What a study draws beyond mass and friction is its own. A stage follows from the seed and its number alone, so that each
can be made again, by whichever process runs it.
"""

from collections.abc import Callable, Iterable
from random import Random

import numpy as np

from hil.rig.schema import RigConfig
from hil.virtual.batch import BatchRun
from sim_plant.config import PlantConfig
from sim_plant.physics.truth import Truth

Range = tuple[float, float]

MASS: Range = (0.8, 1.2)  # a stage's own, as a part of the model's
FRICTION: Range = (0.7, 1.3)
CORNERS = {  # parts of mass and friction
    "light, slippery": (MASS[0], FRICTION[0]),
    "light, sticky": (MASS[0], FRICTION[1]),
    "heavy, slippery": (MASS[1], FRICTION[0]),
    "heavy, sticky": (MASS[1], FRICTION[1]),
}


def drawn(seed: int, number: int) -> Random:
    """Where the numbers of one stage come from."""
    return Random(f"{seed}/{number}")


def between(limits: Range, part: float) -> float:
    """The value at `part`, 0 to 1, of a range on a scale of logarithms."""
    low, high = limits
    value: float = low * (high / low) ** part
    return value


def truth_of(rig: RigConfig, plant: PlantConfig) -> Truth:
    """What one stage is really like, (n_axes,)."""
    return Truth.from_config(plant, len(rig.axes), rig.axis_names)


def stacked(rig: RigConfig, plants: Iterable[PlantConfig]) -> Truth:
    """What many are like, (plants, n_axes)."""
    return Truth.stack([truth_of(rig, plant) for plant in plants])


def run(batch: BatchRun, ticks: range, before: Callable[[int], None], after: Callable[[int], None]) -> None:
    """Let all stages of a batch run together for these ticks; `before` and `after` are called around each.

    A stage that diverges becomes infinite and ends as NaN; the others go on.
    """
    with np.errstate(all="ignore"):
        for tick in ticks:
            before(tick)
            batch.tick()
            after(tick)
