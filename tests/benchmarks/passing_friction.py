"""What friction of passing rolling elements costs: `python -m tests.benchmarks.passing_friction --mode 150 --seed 7`.

Hard stages as `hil evidence --hard` draws them, but with no resonance that the model does not know: 10 mm at 1 Hz with
friction that varies over 5 to 20 mm (smooth), over 0.6 to 2 mm, and the latter where the model states each stage's
period, off by up to --off of it. Prints peak and RMS error, nm, median / 95 % / worst.
"""

import argparse
from dataclasses import fields
from pathlib import Path

import numpy as np

from hil.control.laws.base import Array
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.rig.shipped import by_name
from hil.studies.evidence.stages import columns, nominal, only, plant_of
from hil.studies.evidence.trials import LONG, TRIALS, trajectory_of
from hil.studies.population import run, truth_of
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from sim_plant.physics.truth import Truth
from tests.benchmarks.first_strokes import beside

AXIS = "x"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mode", type=float, default=0.0, help="Hz of the free axis; 0: rigid")
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--off", type=float, default=0.0, help="part of the period that the model is off by")
    words = parser.parse_args()
    whole = nominal(load_rig(by_name("rigs", Path("microscope"))), words.mode)
    one, at, random = only(whole, [AXIS]), whole.axis_names.index(AXIS), np.random.default_rng(words.seed)
    for name in ("smooth", "fine", "fine, stated"):
        truths = []
        for number in range(words.stages):
            plant = plant_of(whole, words.seed, number, words.mode, hard=True)
            update: dict[str, object] = {"modes": [mode for mode in plant.modes if mode.tool]}
            if name == "smooth":
                update["friction_period"] = plant_of(whole, words.seed, number, words.mode).friction_period
            truths.append(columns(truth_of(whole, plant.model_copy(update=update)), [at]))
        truth = Truth(**{key.name: np.array([[getattr(t, key.name)[0] for t in truths]]) for key in fields(Truth)})
        off = 1.0 + words.off * random.uniform(-1.0, 1.0, words.stages)
        periods = truth.friction_period[0] * off if name == "fine, stated" else np.zeros(words.stages)
        error = errors([stated(one, float(period)) for period in periods], truth) * 1e9
        print(f"{name}: peak {shown(np.abs(error).max(axis=0))}, RMS {shown(np.sqrt((error**2).mean(axis=0)))} nm")


def stated(rig: RigConfig, period: float) -> RigConfig:
    """The rig of one axis whose model states this period, m."""
    axis = rig.axes[AXIS]
    model = axis.model.model_copy(update={"friction_period": period})
    return rig.model_copy(update={"axes": {AXIS: axis.model_copy(update={"model": model})}})


def errors(rigs: list[RigConfig], truth: Truth) -> Array:
    """Of the judged ticks, (ticks, stages), m."""
    rig, trial = beside(rigs), next(each for each in TRIALS if each.name == LONG)
    batch = BatchRun(rig, truth, trajectory_of(rig, trial))
    first, count = round(trial.judged_from * rig.rate_hz), round(trial.seconds * rig.rate_hz)
    error = np.zeros((count - first, len(rigs)))

    def after(tick: int) -> None:
        if tick >= first:
            error[tick - first] = batch.error[0]

    run(batch, range(-FIRST_ON_TASK, count), lambda tick: None, after)
    return error


def shown(values: Array) -> str:
    """Median / 95 % / worst."""
    return f"{np.median(values):.4g} / {np.quantile(values, 0.95):.4g} / {values.max():.4g}"


if __name__ == "__main__":
    main()
