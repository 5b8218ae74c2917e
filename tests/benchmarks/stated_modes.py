"""Hard stages whose further resonances the model states: `python -m tests.benchmarks.stated_modes --seed N --mode 150`.

Each stage is drawn as `hil evidence --hard` draws it, and does 10 mm at 1 Hz. The model states the stage's resonances
beside the first within --off. It is the usual one in everything else, or with --measured it is within that of the
stage in mass, lag and the first resonance, too. --plain: the rest of the stage as without --hard, so that what the
resonances cost shows alone. --told 0: the model states none. Prints the stages lost, and the peak and RMS error of all,
lost ones as the worst. --margins: also the least margins that `hil check` finds on the models.
"""

import argparse
from pathlib import Path
from random import Random

import numpy as np

from hil.analysis.loop_corners import CornerFinding, check_corners
from hil.control.laws import make_law
from hil.control.laws.base import Array, Model
from hil.control.nominal_model import rig_model
from hil.control.trajectories.chosen_axes import ChosenAxes
from hil.rig.file import load_rig
from hil.rig.measured_table import MeasuredConfig
from hil.rig.schema import RigConfig
from hil.rig.shipped import by_name
from hil.studies.evidence.stages import columns, nominal, only, plant_of
from hil.studies.evidence.trials import TRIALS, trajectory_of
from hil.studies.population import run, truth_of
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from sim_plant.config import PlantConfig
from sim_plant.physics.truth import Truth

LAW = "presliding-kalman"


def told(rig: RigConfig, plant: PlantConfig, index: int, random: Random, words: argparse.Namespace) -> RigConfig:
    """The one-axis rig, whose model states that stage's further resonances. index: of the axis on the stage."""
    (name, axis) = next(iter(rig.axes.items()))

    def near(value: float) -> float:
        return value * random.uniform(1.0 - words.off, 1.0 + words.off)

    own = [mode for mode in plant.modes if mode.axis == name]
    others = [[near(mode.frequency_hz), mode.damping, mode.load] for mode in own if not mode.tool]
    changes: dict[str, object] = {"other_modes": others if words.told else []}
    measured = None
    if words.measured:
        known = {"mass": near(plant.mass[index]), "torque_lag": near(plant.torque_lag[index])}  # type: ignore[index]
        for mode in [mode for mode in own if mode.tool]:
            known["mode_frequency_hz"] = near(mode.frequency_hz)
        changes |= known
        measured = MeasuredConfig.model_validate({key: [value, words.off * value] for key, value in known.items()})
    model = axis.model.model_copy(update=changes)
    return rig.model_copy(update={"axes": {name: axis.model_copy(update={"model": model, "measured": measured})}})


def errors(
    whole: RigConfig, rigs: list[RigConfig], plants: list[PlantConfig], index: int, *, measured: bool
) -> tuple[Array, Array]:
    """Error of all stages on every tick from the first judged, and the largest before, m."""
    trial, rig = TRIALS[0], rigs[0]
    models = [rig_model(one) for one in rigs]
    fields = Model.__dataclass_fields__
    model = Model(*(np.array([getattr(one, field) for one in models]) for field in fields))
    if measured:  # of a rigid axis as well: `hil check` does not know yet how well the others were measured
        model.known = np.ones(model.mass.shape)
    truth = Truth.stack([columns(truth_of(whole, plant), [index]) for plant in plants])
    batch = BatchRun(rig, truth, ChosenAxes(trajectory_of(whole, trial), [index]))
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    batch._law = make_law(rig.law, model, rig.period_ns * 1e-9, limit)  # type: ignore[arg-type]
    count = round(trial.seconds / (rig.period_ns * 1e-9))
    found = np.empty((count, len(rigs)))

    def after(k: int) -> None:
        if k >= 0:
            found[k] = batch.error[:, 0]

    run(batch, range(-FIRST_ON_TASK, count), lambda k: None, after)
    judged = round(trial.judged_from / (rig.period_ns * 1e-9))
    return found[judged:], np.abs(found).max(axis=0)


def margins_of(rigs: list[RigConfig]) -> None:
    """Print the least that `hil check` finds on these models, and what they lack."""
    found: list[CornerFinding] = [finding for rig in rigs for finding in check_corners(rig)]
    for name, part in (
        ("as the model says", [one for one in found if one.nominal]),
        ("in corners", [one for one in found if not one.nominal and not one.at_rest]),
        ("at rest", [one for one in found if one.at_rest]),
    ):
        lacking = sum(bool(one.lacks()) for one in part)
        gain, phase = min(one.gain_db for one in part), min(one.phase_deg for one in part)
        unstable = sum(not one.stable for one in part)
        print(f"{name}: {gain:.2f} dB, {phase:.1f} deg; of {len(part)} {lacking} lack margins, {unstable} unstable")


def main() -> None:
    """Draw, tell, move, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axis", default="x")
    parser.add_argument("--mode", type=float, default=0.0, help="Hz of the free axis; 0: rigid")
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--seed", type=int, nargs="+", required=True)
    parser.add_argument("--off", type=float, default=0.01, help="of what is stated: at most")
    parser.add_argument("--told", type=int, default=1)
    parser.add_argument("--measured", action="store_true")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--none", action="store_true", help="with --plain: no further resonances either")
    parser.add_argument("--margins", action="store_true")
    words = parser.parse_args()
    whole = nominal(load_rig(by_name("rigs", Path("microscope")), [f"law.name={LAW}"]), words.mode)
    rig, index = only(whole, [words.axis]), list(whole.axes).index(words.axis)
    plants, rigs = [], []
    for seed in words.seed:
        for number in range(words.stages):
            plant = hard = plant_of(whole, seed, number, words.mode, hard=True)
            if words.plain:
                plant = plant_of(whole, seed, number, words.mode)
                plant = plant if words.none else plant.model_copy(update={"modes": hard.modes})
            plants.append(plant)
            rigs.append(told(rig, plant, index, Random(f"told/{seed}/{number}"), words))
    judged, largest = errors(whole, rigs, plants, index, measured=words.measured)
    lost = ~(largest < rig.axes[words.axis].limits.following_error)
    print(f"lost: {lost.sum()} of {len(rigs)} (stages {np.flatnonzero(lost).tolist()})", flush=True)
    for name, values in (("peak", np.abs(judged).max(axis=0)), ("RMS", np.sqrt((judged**2).mean(axis=0)))):
        every = np.where(lost, np.inf, values) * 1e9
        print(f"{name}: {np.median(every):.4g} / {np.quantile(every, 0.95, method='higher'):.4g} nm (median / 95 %)")
    if words.margins:
        margins_of(rigs)


if __name__ == "__main__":
    main()
