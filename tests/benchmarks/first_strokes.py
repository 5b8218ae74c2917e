"""What learning from before is worth: `python -m tests.benchmarks.first_strokes --axis x --mode 150 --stages 20`.

Stages are drawn as `hil evidence` draws them. Each runs from rest, 10 mm at 1 Hz, of which the first stroke begins in
the middle and already turns round: with nothing learnt, with what twenty strokes had taught, and, where --identify has
`hil identify` find each stage first, with what was identified. Prints the largest error of the first stroke against
that of the twentieth of the run that began with nothing, median / worst.
"""

import argparse
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from hil.control.laws.base import Array
from hil.identify.first_state import state_of
from hil.identify.lockstep import identify
from hil.identify.written import measured_values, model_values
from hil.rig.file import load_rig
from hil.rig.measured_table import MeasuredConfig
from hil.rig.schema import ModelConfig, RigConfig
from hil.rig.shipped import by_name
from hil.studies.evidence.stages import columns, nominal, only, plant_of
from hil.studies.evidence.trials import LONG, TRIALS, trajectory_of
from hil.studies.population import run, truth_of
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from sim_plant.config import PlantConfig
from sim_plant.physics.truth import Truth

STROKES, STROKE_S = 20, 0.5


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", type=Path, default=Path("microscope"))
    parser.add_argument("--axis", default="x")
    parser.add_argument("--mode", type=float, default=150.0, help="Hz of the free axis; 0: rigid")
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--identify", action="store_true", help="identify each stage first; half a minute a stage")
    words = parser.parse_args()
    whole = nominal(load_rig(by_name("rigs", words.rig)), words.mode)
    plants = [plant_of(whole, words.seed, number, words.mode) for number in range(words.stages)]
    at = whole.axis_names.index(words.axis)
    one = only(whole, [words.axis])
    states: list[Array] = []
    if words.identify:
        found = [identified(one, alone(one, plant, at)) for plant in plants]
        rigs, states = [rig for rig, _ in found], [np.array(each) for each in zip(*(s for _, s in found), strict=True)]
    else:
        rigs = [one] * words.stages
    drawn = [columns(truth_of(whole, plant), [at]) for plant in plants]
    truth = Truth(**{field.name: np.array([[getattr(t, field.name)[0] for t in drawn]]) for field in fields(Truth)})
    fresh, kept = strokes(rigs, truth, STROKES, [])
    last = fresh[-1]
    begun = {"nothing learnt": fresh, "with what was kept": strokes(rigs, truth, 1, kept)[0]}
    if states:
        begun["with what was identified"] = strokes(rigs, truth, 1, states)[0]
    for name, errors in begun.items():
        print(
            f"{name}: first stroke {_shown(errors[0] * 1e9)} nm, {_shown(errors[0] / last)} times the twentieth, "
            f"{np.median(errors[0]) / np.median(last):.2f} times by medians"
        )
    print(f"twentieth stroke: {_shown(last * 1e9)} nm; median / worst, {words.stages} stages, seed {words.seed}")


def alone(rig: RigConfig, plant: PlantConfig, at: int) -> RigConfig:
    """The rig of one axis with a drawn stage, of which it is number `at`."""
    name, parts = rig.axis_names[0], ("cogging", "modes")
    lists = {key: value for key, value in plant if isinstance(value, list) and value and key not in parts}
    own: dict[str, Any] = {key: [value[at]] for key, value in lists.items()}
    own |= {key: [part for part in getattr(plant, key) if part.axis == name] for key in parts}
    own |= {key: getattr(rig.plant, key) for key in ("encoder_resolution", "initial_position")}
    return rig.model_copy(update={"plant": plant.model_copy(update=own)})


def identified(rig: RigConfig, stage: RigConfig) -> tuple[RigConfig, list[float]]:
    """The rig of one axis as `hil identify --write` writes it of a stage, and what its law begins with."""
    ((name, axis),) = rig.axes.items()
    findings = identify(stage, Path(), [name], lambda text: None)[name]
    measured = {**measured_values(findings.found), "date": "2026-11-28", "evidence": "in virtual time"}
    known = {
        "model": ModelConfig.model_validate(axis.model.model_dump() | model_values(findings.found)),
        "measured": MeasuredConfig.model_validate(measured),
    }
    whole = rig.model_copy(update={"axes": {name: axis.model_copy(update=known)}})
    return whole, state_of(whole, name, findings)


def strokes(rigs: Sequence[RigConfig], truth: Truth, count: int, learnt: Sequence[Array]) -> tuple[Array, list[Array]]:
    """Largest error of each stroke (strokes, stages), m; what was learnt at the end, (stages,) each value."""
    rig = beside(rigs)
    trial = next(each for each in TRIALS if each.name == LONG)
    batch = BatchRun(rig, truth, trajectory_of(rig, trial))
    if learnt:
        batch.law.begin_learnt(list(learnt))
    stroke = round(STROKE_S * rig.rate_hz)
    error = np.zeros((count, stroke, len(rigs)))

    def after(tick: int) -> None:
        if tick >= 0:
            error[tick // stroke, tick % stroke] = abs(batch.error[0])

    run(batch, range(-FIRST_ON_TASK, count * stroke), lambda tick: None, after)
    return error.max(axis=1), [np.ravel(value) for value in batch.law.learnt_state()]


def beside(rigs: Sequence[RigConfig]) -> RigConfig:
    """Rigs of one axis and one law as the axes of one rig."""
    first, n = rigs[0], len(rigs)

    def each(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: each(item) for key, item in value.items()}
        return value * n if isinstance(value, list) and len(value) == 1 else value

    tables = {
        "law": ("gains", "tuned"), "drives": ("brake",), "plant": ("encoder_resolution", "initial_position"),
        "estimator": tuple(type(first.estimator).model_fields),
    }  # fmt: skip
    parts = {
        name: getattr(first, name).model_copy(update={key: each(getattr(getattr(first, name), key)) for key in keys})
        for name, keys in tables.items()
    }
    axes = {f"{number}": axis for number, rig in enumerate(rigs) for axis in rig.axes.values()}
    return first.model_copy(update={"axes": axes, **parts})


def _shown(values: Array) -> str:
    return f"{np.median(values):.3g} / {values.max():.3g}"


if __name__ == "__main__":
    main()
