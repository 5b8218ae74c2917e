"""Goal moves of drawn stages at the rig's own limits: `python -m tests.benchmarks.goal_moves --seed 77 --stages 12`.

Stages are drawn as `hil evidence` draws them. Each axis in turn goes far, nearly back, and home, with the
greatest speed, acceleration and jerk that goals may have. Prints the largest following error of each axis, and what
ended a stage.
"""

import argparse
from pathlib import Path

import numpy as np

from hil.control.laws.base import Array
from hil.cycle.goal import GoalRefusedError, MotionError
from hil.live.goal_link import Look
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.runs.mover import Move
from hil.runs.rigs import Rig
from hil.runs.virtual_mover import VirtualMover
from hil.studies.evidence.stages import nominal, plant_of

RIG = "microscope"
WAYS = {"x": 5e-3, "y": -5e-3, "z": -2e-3, "theta": 0.1}  # m, rad
SHARES = (1.0, 0.01, 0.0)  # of the way, one after the other


def drawn_rig(seed: int, number: int, mode_hz: float) -> Rig:
    """The microscope with one drawn stage; its model knows the resonance as it is on average."""
    file = by_name("rigs", Path(RIG))
    whole = nominal(load_rig(file), mode_hz)
    plant = plant_of(whole, seed, number, mode_hz)
    mine = {key: getattr(whole.plant, key) for key in ("encoder_resolution", "initial_position")}
    return Rig.build({**whole.model_dump(mode="json"), "plant": {**plant.model_dump(mode="json"), **mine}}, file.parent)


def moved(rig: Rig, ways: dict[str, float]) -> tuple[Array, str]:
    """Largest following error of each axis, m (rad), and what ended the moves; "": nothing."""
    with VirtualMover(rig) as mover:
        error = np.zeros(len(mover.axes))

        def over(move: Move, look: Look) -> bool:
            np.maximum(error, np.abs(np.subtract(look.position, look.setpoint)), out=error)
            return move.done

        for axis, way in ways.items():
            for share in SHARES:
                try:
                    move = mover.move_to(**{axis: share * way})
                    mover.await_rest(lambda look, move=move: over(move, look))
                except (MotionError, GoalRefusedError) as ended:
                    return error, f"{axis} to {share * way:g}: {ended}"
    return error, ""


def main() -> None:
    """Draw, move, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--stages", type=int, default=12)
    parser.add_argument("--mode", type=float, default=0.0, help="Hz; 0: rigid")
    words = parser.parse_args()
    errors, ended = [], 0
    for number in range(words.stages):
        error, why = moved(drawn_rig(words.seed, number, words.mode), WAYS)
        errors.append(error)
        ended += bool(why)
        print(f"stage {number}: um, urad {' '.join(f'{1e6 * each:.1f}' for each in error)}; {why or 'ok'}", flush=True)
    median = " ".join(f"{1e6 * each:.1f}" for each in np.median(errors, axis=0))
    worst = " ".join(f"{1e6 * each:.1f}" for each in np.max(errors, axis=0))
    print(f"seed {words.seed}, {words.mode:g} Hz: median {median}; worst {worst}; ended {ended} of {words.stages}")


if __name__ == "__main__":
    main()
