"""Reversal error of drawn stages soon after arrival: `python -m tests.benchmarks.reversals --axis x --seeds 91,92,93`.

Stages are drawn as `hil evidence` draws them, with the microscope's laws and limits. An axis comes to each of three
places from below and from above, --rounds times: the law learns meanwhile. Of every approach the encoder's mean over
20 ms about 0.35 s after the set-point's rest counts. The reversal error is by how much it differs from below and from
above, the worst of the places. Then the axis holds for a second. With --identify each stage is identified first, and
the law begins with what was found of it.
"""

import argparse
from pathlib import Path

import numpy as np

from hil.cycle.goal import MotionWord
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.rig.task_tables import TaskConfig
from hil.runs.rigs import Rig
from hil.runs.virtual_mover import VirtualMover
from hil.studies.evidence.stages import nominal, only, plant_of
from tests.benchmarks.first_strokes import alone, identified
from tests.benchmarks.goal_moves import RIG, WAYS, drawn_rig

PLACES, APPROACH = (-1.0, 0.2, 1.0), 0.2  # of the axis' way
ARRIVED_S, WINDOW_S, HOLD_S = 0.34, 0.02, 1.0


def reversal(mover: VirtualMover, axis: str, way: float, rounds: int, speed: float) -> list[float]:
    """Of one stage: the reversal error of each round, and the RMS of the hold about its mean, m (rad)."""
    number, found = mover.axes.index(axis), []

    def to(place: float) -> None:
        move = mover.move_to(speed=speed, **{axis: place})
        mover.await_rest(lambda look: look.motion is MotionWord.HOLD or move.done)

    def seen(seconds: float) -> list[float]:
        places, until_ns = [], mover.now_ns() + round(seconds * 1e9)
        while mover.now_ns() < until_ns:
            places.append(mover.status().position[number])
            mover.sleep(0.0)
        return places

    for _ in range(rounds):
        apart = []
        for place in PLACES:
            arrived = []
            for side in (-APPROACH, APPROACH):
                to(way * (place + side))
                to(way * place)
                mover.sleep(ARRIVED_S)
                arrived.append(float(np.mean(seen(WINDOW_S))))
            apart.append(abs(arrived[1] - arrived[0]))
        found.append(max(apart))
    return [*found, float(np.std(seen(HOLD_S)))]


def identified_rig(axis: str, seed: int, number: int, mode_hz: float) -> Rig:
    """One axis with one drawn stage, as `hil identify --write` writes it."""
    file = by_name("rigs", Path(RIG))
    whole = nominal(load_rig(file), mode_hz)
    stage = alone(only(whole, [axis]), plant_of(whole, seed, number, mode_hz), whole.axis_names.index(axis))
    found, state = identified(only(whole, [axis]), stage)
    law = found.law.model_copy(update={"learnt_on": "in virtual time", "learnt_state": [state]})
    task = TaskConfig(kind="waypoints", axes=[axis], waypoints=[[0.0], [1e-4]])  # goals come instead
    written = found.model_copy(update={"plant": stage.plant, "law": law, "task": task})
    return Rig(written, file.parent, {}, ())


def main() -> None:
    """Draw, move, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axis", default="x", choices=list(WAYS))
    parser.add_argument("--seeds", default="91,92,93")
    parser.add_argument("--stages", type=int, default=20, help="of each seed")
    parser.add_argument("--mode", type=float, default=0.0, help="Hz; 0: rigid")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--speed", type=float, default=1.0, help="of what goals may have")
    parser.add_argument("--identify", action="store_true", help="identify each stage first; some seconds a stage")
    words = parser.parse_args()
    found = []
    for seed in map(int, words.seeds.split(",")):
        for number in range(words.stages):
            drawn = drawn_rig(seed, number, words.mode)
            rig = identified_rig(words.axis, seed, number, words.mode) if words.identify else drawn
            with VirtualMover(rig) as mover:
                found.append(reversal(mover, words.axis, abs(WAYS[words.axis]), words.rounds, words.speed))
            print(f"seed {seed}, stage {number}: {' '.join(f'{1e9 * each:.1f}' for each in found[-1])}", flush=True)
    names = [*(f"reversal, round {number + 1}" for number in range(words.rounds)), "hold, RMS"]
    for name, values in zip(names, 1e9 * np.array(found).T, strict=True):
        print(f"{words.axis}, {name}, nm (nrad): {np.median(values):.2f} / {np.quantile(values, 0.95):.2f}")


if __name__ == "__main__":
    main()
