"""Reversal error of drawn stages soon after arrival: `python -m tests.benchmarks.reversals --axis x --seeds 91,92,93`.

Stages are drawn as `hil evidence` draws them, with the microscope's laws and limits. An axis comes to each of three
places from below and from above, --rounds times: the law learns meanwhile, and the last round counts. Of every
approach the encoder's mean over 20 ms about 0.35 s after the set-point's rest counts. The reversal error is by how much
it differs from below and from above, the worst of the places. Then the axis holds for a second.
"""

import argparse

import numpy as np

from hil.cycle.goal import MotionWord
from hil.runs.virtual_mover import VirtualMover
from tests.benchmarks.goal_moves import WAYS, drawn_rig

PLACES, APPROACH = (-1.0, 0.2, 1.0), 0.2  # of the axis' way
ARRIVED_S, WINDOW_S, HOLD_S = 0.34, 0.02, 1.0


def reversal(mover: VirtualMover, axis: str, way: float, rounds: int) -> tuple[float, float]:
    """Of one stage: the reversal error and the RMS of the hold about its mean, m (rad)."""
    number, apart = mover.axes.index(axis), [0.0 for _ in PLACES]

    def to(place: float) -> None:
        mover.move_to(**{axis: place})
        mover.await_rest(lambda look: look.motion is MotionWord.HOLD)

    def seen(seconds: float) -> list[float]:
        found, until_ns = [], mover.now_ns() + round(seconds * 1e9)
        while mover.now_ns() < until_ns:
            found.append(mover.status().position[number])
            mover.sleep(0.0)
        return found

    for _ in range(rounds):
        for at, place in enumerate(PLACES):
            means = []
            for side in (-APPROACH, APPROACH):
                to(way * (place + side))
                to(way * place)
                mover.sleep(ARRIVED_S)
                means.append(float(np.mean(seen(WINDOW_S))))
            apart[at] = abs(means[1] - means[0])
    return max(apart), float(np.std(seen(HOLD_S)))


def main() -> None:
    """Draw, move, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axis", default="x", choices=list(WAYS))
    parser.add_argument("--seeds", default="91,92,93")
    parser.add_argument("--stages", type=int, default=20, help="of each seed")
    parser.add_argument("--mode", type=float, default=0.0, help="Hz; 0: rigid")
    parser.add_argument("--rounds", type=int, default=2)
    words = parser.parse_args()
    found = []
    for seed in map(int, words.seeds.split(",")):
        for number in range(words.stages):
            with VirtualMover(drawn_rig(seed, number, words.mode)) as mover:
                found.append(reversal(mover, words.axis, abs(WAYS[words.axis]), words.rounds))
            print(f"seed {seed}, stage {number}: {' '.join(f'{1e9 * each:.1f}' for each in found[-1])}", flush=True)
    for name, values in zip(("reversal", "hold, RMS"), 1e9 * np.array(found).T, strict=True):
        print(f"{words.axis}, {name}, nm (nrad): {np.median(values):.2f} / {np.quantile(values, 0.95):.2f}")


if __name__ == "__main__":
    main()
