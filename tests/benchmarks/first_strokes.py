"""What kept learning is worth: `python -m tests.benchmarks.first_strokes --axis x --mode 150 --stages 20`.

Stages are drawn as `hil evidence` draws them. Each runs twice from rest, 10 mm at 1 Hz: first with nothing learnt, then
with what the first run had learnt. Prints the largest error of the first stroke, which begins at rest, against that of
the twentieth stroke of the first run.
"""

import argparse
from pathlib import Path

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.chosen_axes import ChosenAxes
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.studies.evidence.stages import columns, nominal, only, stage_of
from hil.studies.evidence.trials import LONG, TRIALS, trajectory_of
from hil.studies.population import run
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
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
    words = parser.parse_args()
    whole = nominal(load_rig(by_name("rigs", words.rig)), words.mode)
    at = whole.axis_names.index(words.axis)
    drawn = [columns(stage_of(whole, words.seed, number, words.mode), [at]) for number in range(words.stages)]
    rig = only(whole, [words.axis])
    trial = next(each for each in TRIALS if each.name == LONG)
    trajectory = ChosenAxes(trajectory_of(whole, trial), [at])
    stroke = round(STROKE_S * rig.rate_hz)

    def strokes(count: int, learnt: list[Array]) -> tuple[Array, list[Array]]:
        """Largest error of each stroke (strokes, stages), m; what was learnt at the end."""
        batch = BatchRun(rig, Truth.stack(drawn), trajectory)
        if learnt:
            batch.law.begin_learnt(learnt)
        error = np.zeros((count, stroke, words.stages))

        def after(tick: int) -> None:
            if tick >= 0:
                error[tick // stroke, tick % stroke] = abs(batch.error[:, 0])

        run(batch, range(-FIRST_ON_TASK, count * stroke), lambda tick: None, after)
        return error.max(axis=1), [np.array(value) for value in batch.law.learnt_state()]

    first, learnt = strokes(STROKES, [])
    second, _ = strokes(2, learnt)
    last = first[-1]
    for name, one in (("nothing learnt", first[0]), ("with what was kept", second[0])):
        print(
            f"{name}: first stroke {_shown(one * 1e9)} nm, {_shown(one / last)} times the twentieth, "
            f"{np.median(one) / np.median(last):.2f} times by medians"
        )
    print(f"twentieth stroke: {_shown(last * 1e9)} nm; median / 95 %, {words.stages} stages, seed {words.seed}")


def _shown(values: Array) -> str:
    return f"{np.median(values):.3g} / {np.quantile(values, 0.95, method='higher'):.3g}"


if __name__ == "__main__":
    main()
