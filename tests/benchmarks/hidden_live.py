"""Identification of hidden stages in real time: `python -m tests.benchmarks.hidden_live --seed N --stages 5`.

Draws four-axis stages as `hil evidence` does, writes a rig file for each whose model is 30 % too small, and runs
`hil identify --live` on it against the live emulated stage, as an operator would: interrupted, it is started again. The
rig files have room for the stalls of a shared computer. Prints errors as `hidden_stages` does, and what the experiments
took of the following error. Named again, --folder goes on where it ended.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from drivers.base.toml_file import toml_text
from hil.identify.estimate import Estimate
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.runs.api import load_run
from hil.studies.evidence.stages import nominal, plant_of
from sim_plant.config import PlantConfig
from tests.benchmarks.hidden_stages import RIG, SWEPT, TOLD, Errors, following, told_wrongly, truth_of_axis

STARTS, UNAVAILABLE = 6, 69
ROOM = {"overrun_zero_s": 0.15, "overrun_streak": 150, "silent_stop_ticks": 100, "silent_zero_ticks": 150}


def draw(seed: int, number: int, mode_hz: float, folder: Path) -> PlantConfig:
    """The truth of a stage; stage.toml in the folder knows little of it."""
    whole = nominal(load_rig(by_name("rigs", Path(RIG)), ["bus.interface=local"]), mode_hz)
    mine = {key: getattr(whole.plant, key) for key in ("encoder_resolution", "initial_position")}
    plant = plant_of(whole, seed, number, mode_hz).model_copy(update=mine)
    axes = {
        name: told_wrongly(axis, {key: 0.7 * getattr(axis.model, key) for key in TOLD})
        for name, axis in whole.axes.items()
    }
    rig = whole.model_copy(update={"axes": axes, "plant": plant, "name": f"hidden{number}"})
    document = rig.model_dump(mode="json", exclude_none=True)
    document["safety"] |= ROOM
    document["drives"]["watchdog_s"] = 0.15
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stage.toml").write_text(toml_text(document))
    return plant


def run(folder: Path) -> int:
    """Exit status of the last start."""
    words = ["stage.toml", "--live", "--yes", "--out", "identified", "--json", "values.json"]
    status = UNAVAILABLE
    for start in range(STARTS):
        began = time.monotonic()
        with (folder / f"start-{start + 1}.log").open("w") as log:
            command = [sys.executable, "-m", "hil", "identify", *words]
            status = subprocess.run(command, cwd=folder, stdout=log, stderr=log, check=False).returncode
        print(f"{folder.name}: start {start + 1}: exit {status}, {time.monotonic() - began:.0f} s", flush=True)
        if status != UNAVAILABLE:
            break
    return status


def compare(folder: Path, plant: PlantConfig, errors: Errors) -> None:
    """What the stage's values.json has, against its truth."""
    rig, found = load_rig(folder / "stage.toml"), json.loads((folder / "values.json").read_text())["axes"]
    for number, (name, axis) in enumerate(rig.axes.items()):
        truth = truth_of_axis(plant, name, number, SWEPT * axis.limits.position[1])
        one = {quantity: Estimate(**told) for quantity, told in found[name]["found"].items()}
        errors.add(f"{folder.name} {name}", one, found[name]["refused"], truth)
    shares, missing = [], []
    for kept in sorted((folder / "identified").glob("*/run.mcap")):
        run = load_run(kept)
        index = run.columns["index"]
        shares.append(following(run))
        missing.append(int(np.ptp(index)) + 1 - len(index))
    print(f"{folder.name}: following error up to {max(shares):.2f} of its limit, ticks lost {missing}", flush=True)


def main() -> None:
    """Draw, identify, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--stages", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--mode", type=float, default=150.0, help="Hz; 0: rigid")
    parser.add_argument("--folder", type=Path, default=Path("runs/hidden"))
    words = parser.parse_args()
    errors = Errors()
    for number in range(words.first, words.first + words.stages):
        folder = words.folder.resolve() / f"s{number}"
        plant = draw(words.seed, number, words.mode, folder)
        if (folder / "values.json").exists() or run(folder) != UNAVAILABLE:
            compare(folder, plant, errors)
    errors.show()


if __name__ == "__main__":
    main()
