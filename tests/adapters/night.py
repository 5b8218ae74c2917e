"""A night of moves by Micro-Manager: `busy()` must tell the truth ten thousand times, and Z must stay.

python -m tests.adapters.night --moves 10000

Drives the emulated microscope, realistic stage, in virtual time through a core of pymmcore-plus. Moves of XY (up to
200 um), of Z (up to 50 um) and of theta by turns, each awaited by `deviceBusy`, with 50 ms between. Counts an early end
where any axis is further than the window from its target, by the encoder, when a device says it is no longer busy; and
axes that were there and leave the window in the 50 ms after, by name. The drift is how far the true Z goes while
nothing is asked of it, between two moves.
"""

import argparse
import random
import time
from pathlib import Path
from typing import Final, NamedTuple

from pymmcore_plus.experimental.unicore import UniMMCore

from hil.adapters.pymmcore import PER_M, load_stages
from hil.cycle.fault_table import Fault
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.runs.mover import Mover
from hil.virtual.goal_link import LockstepLink
from tests.support.paths import RIGS

WINDOW: Final = 1e-6  # m; of theta, rad, ten times that
BETWEEN_TICKS: Final = 50
TOLD_EVERY: Final = 500  # moves
REACH: Final = {"XY": 200.0, "Z": 50.0, "theta": 1000.0}  # of a move's end from the middle, um (urad)


class Night(NamedTuple):
    """early: moves that were told over while an axis was not in position. left: by axis, moves after which it left its
    window again. drift: the most that Z went between moves, m. fault: of the rig at the end. virtual_s: how long it
    took, in the rig's time.
    """

    moves: int
    early: int
    left: dict[str, int]
    drift: float
    fault: Fault
    virtual_s: float


def rig() -> RigConfig:
    """The realistic microscope, its windows as asked for."""
    windows = [f"axes.{axis}.motion.window={WINDOW}" for axis in ("x", "y", "z")]
    return load_rig(RIGS / "microscope.toml", [*windows, f"axes.theta.motion.window={10 * WINDOW}"])


def spend(moves: int, seed: int = 1) -> Night:
    """So many moves, drawn from the seed."""
    config, draw = rig(), random.Random(seed)
    link = LockstepLink(config, Path(RIGS), lambda _: None)
    windows = [WINDOW, WINDOW, WINDOW, 10 * WINDOW]
    early, drift, left = 0, 0.0, dict.fromkeys(config.axes, 0)
    with Mover(link) as mover:
        core = UniMMCore()
        load_stages(core, mover)
        target = list(mover.status().setpoint)

        def far() -> set[str]:
            found = zip(mover.axes, mover.status().position, target, windows, strict=True)
            return {name for name, at, wanted, window in found if abs(at - wanted) > window}

        for number in range(moves):
            label = ("XY", "Z", "theta")[number % 3]
            places = [draw.uniform(-REACH[label], REACH[label]) for _ in range(2 if label == "XY" else 1)]
            if label == "XY":
                core.setXYPosition(*places)
                target[:2] = [places[0] / PER_M, places[1] / PER_M]
            else:
                core.setPosition(label, *places)
                target[2 if label == "Z" else 3] = places[0] / PER_M
            while core.deviceBusy(label):
                pass
            rests_at = link.run.true_position[2]
            early += bool(far())
            gone: set[str] = set()
            for _ in range(BETWEEN_TICKS):
                link.run.tick()
                gone |= far()
                drift = max(drift, abs(float(link.run.true_position[2] - rests_at)))
            for name in gone:
                left[name] += 1
            if not (number + 1) % TOLD_EVERY:
                print(f"{number + 1} moves: {early} early, left {left}, drift {drift * 1e6:.3f} um", flush=True)
        look = mover.status()
        core.reset()
    return Night(moves, early, left, drift, look.fault, link.now_ns() * 1e-9)


def main() -> None:
    """Exit status 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    began = time.monotonic()
    night = spend(arguments.moves, arguments.seed)
    print(
        f"{night.moves} moves in {night.virtual_s:.0f} s of virtual time ({time.monotonic() - began:.0f} s here): "
        f"busy() false early {night.early} times, left the window later {night.left}, "
        f"Z drift between moves {night.drift * 1e6:.3f} um, "
        f"fault {night.fault.name}"
    )
    raise SystemExit(
        night.early > 0 or any(night.left.values()) or night.drift >= 1e-6 or night.fault is not Fault.NONE
    )


if __name__ == "__main__":
    main()
