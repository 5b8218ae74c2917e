"""Identification of hidden stages: `python -m tests.benchmarks.hidden_stages --stages 20`.

Stages are drawn as `hil evidence` draws them. The rig file's model is off by --off in everything, or empty. Prints the
error of each quantity (median and worst), how often its interval held the truth, and what was refused.
"""

import argparse
import math
from collections import defaultdict
from pathlib import Path

import numpy as np

from hil.identify.experiments import SWEEP_REACH
from hil.identify.lockstep import identify
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.rig.shipped import by_name
from hil.studies.evidence.stages import nominal, only, plant_of
from sim_plant.config import PlantConfig

SWEPT = SWEEP_REACH - 0.053  # of half the travel, at constant speed
RIG, TOLD = "microscope", ("mass", "coulomb", "viscous", "gravity", "torque_lag")


def hidden(
    axis: str, seed: int, number: int, mode_hz: float, off: float | None, count: float = 0.0
) -> tuple[RigConfig, dict[str, float]]:
    """A one-axis rig that knows little of its stage, and the stage's truth. count: of the encoder, m (rad); 0: the rig
    file's.
    """
    other = [f"axes.{axis}.encoder_resolution={count}"] if count else []
    whole = only(nominal(load_rig(by_name("rigs", Path(RIG)), other), mode_hz), [axis])
    plant = plant_of(whole, seed, number, mode_hz)
    mine = {key: getattr(whole.plant, key) for key in ("encoder_resolution", "initial_position")}
    model = whole.axes[axis].model
    wrong = {key: getattr(model, key) * (1.0 - (off or 0.3)) for key in TOLD}
    if off is None:
        wrong = {
            "mass": model.mass * 0.6,
            "gravity": model.gravity * 0.8,
            "coulomb": 0.0,
            "viscous": 0.0,
            "torque_lag": 0.0,
        }
    wrong |= {"mode_frequency_hz": 0.0, "presliding": []}
    axes = {axis: whole.axes[axis].model_copy(update={"model": model.model_copy(update=wrong)})}
    drives = whole.drives.model_copy(update={"brake": [axis == "z"]})
    rig = whole.model_copy(update={"axes": axes, "drives": drives, "plant": plant.model_copy(update=mine)})
    travel = SWEPT * axes[axis].limits.position[1]
    truth = {
        "mass": _first(plant.mass),
        "torque_lag": _first(plant.torque_lag),
        "coulomb": _dry(plant, travel) + _first(plant.cable_hysteresis),  # what long moves meet
        "viscous": _first(plant.viscous),
        "constant": -_first(plant.gravity) - _first(plant.bias) - _cogging(plant, travel),
        "presliding": _first(plant.presliding),
    }
    if plant.modes:
        one = plant.modes[0]
        truth |= {"mode_frequency_hz": one.frequency_hz, "mode_damping": one.damping, "mode_load": one.load}
    return rig, truth


def _dry(plant: PlantConfig, travel: float) -> float:
    """Mean Coulomb friction from -travel to travel."""
    wave = _mean_sine(travel, _first(plant.friction_period), _first(plant.friction_phase))
    return _first(plant.coulomb) * (1.0 + _first(plant.friction_variation) * wave)


def _cogging(plant: PlantConfig, travel: float) -> float:
    """Its mean over the same travel."""
    return sum(one.amplitude * _mean_sine(travel, one.period, one.phase) for one in plant.cogging)


def _mean_sine(travel: float, period: float, phase: float) -> float:
    turn = 2.0 * math.pi * travel / period
    return math.sin(phase) * math.sin(turn) / turn


def _first(value: float | list[float]) -> float:
    return value[0] if isinstance(value, list) else value


def main() -> None:
    """Draw, identify, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axis", default="x")
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--mode", type=float, default=150.0, help="Hz; 0: rigid")
    parser.add_argument("--off", type=float, default=0.3, help="share by which the model is too small")
    parser.add_argument("--empty", action="store_true", help="begin with an empty model")
    parser.add_argument("--count", type=float, default=0.0, help="of the encoder, m (rad); 0: the rig file's")
    words = parser.parse_args()
    errors, held = defaultdict(list), defaultdict(list)
    for number in range(words.first, words.first + words.stages):
        off = None if words.empty else words.off
        rig, truth = hidden(words.axis, words.seed, number, words.mode, off, words.count)
        found = identify(rig, Path("."), [words.axis], lambda text: None)[words.axis]
        for name, why in found.refused.items():
            print(f"stage {number}: {name} refused: {why}", flush=True)
        for name, value in truth.items():
            if name in found.found:
                one = found.found[name]
                errors[name].append(100.0 * abs(one.value / value - 1.0))
                held[name].append(one.holds(value))
                print(f"stage {number}: {name} {one.value:.5g} +- {one.half_width:.2g}, truth {value:.5g}", flush=True)
    for name, values in errors.items():
        rate = sum(held[name])
        print(f"{name:20} median {np.median(values):.3g} %, worst {max(values):.3g} %, held {rate} of {len(values)}")


if __name__ == "__main__":
    main()
