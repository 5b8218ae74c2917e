"""Identification of hidden stages: `python -m tests.benchmarks.hidden_stages --stages 20`.

Stages are drawn as `hil evidence` draws them, with --hard as its hard ones, with --wide with a lag and a resonance of
a wider range. The rig file's model is off by --off in everything, or empty. Prints the error of each quantity (median
and worst), how often its interval held the truth, and what was refused.
"""

import argparse
import math
import time
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from hil.analysis.flexible_plant import AxisDynamics
from hil.identify.estimate import Array, Estimate
from hil.identify.experiments import EXPERIMENTS, SWEEP_REACH, Plan
from hil.identify.frequency_fit import LEAST_COHERENCE, Response
from hil.identify.lockstep import Trial, identify, in_virtual_time
from hil.identify.written import OF_MODE
from hil.rig.file import load_rig
from hil.rig.schema import AxisConfig, RigConfig
from hil.rig.shipped import by_name
from hil.runs.api import Run
from hil.studies.evidence.stages import nominal, only, plant_of
from hil.studies.population import between
from sim_plant.config import PlantConfig

SWEPT = SWEEP_REACH - 0.053  # of half the travel, at constant speed
ABSOLUTE = {  # scale, unit
    "torque_lag": (1e6, "us"), "delay": (1e6, "us"), "position_drift": (1e6, "um"), "mode_load": (1.0, ""),
    "other_mode_1_load": (1.0, ""), "other_mode_2_load": (1.0, ""),
    "friction_variation": (1.0, ""), "friction_phase": (180.0 / math.pi, "deg"),
    "cogging_phase": (180.0 / math.pi, "deg"),
}  # fmt: skip
RIG, TOLD = "microscope", ("mass", "coulomb", "viscous", "gravity", "torque_lag")
# With --wide: Hz of the held motor (log-uniform), damping ratio, share of the mass; s.
WIDE_HZ, WIDE_DAMPING, WIDE_LOAD, WIDE_LAG = (100.0, 350.0), (0.01, 0.05), (0.1, 0.4), (1e-4, 4e-4)
EMPTY = ({"mass": 0.5, "gravity": 0.8}, {"mass": 2.0, "gravity": 1.2})  # what is known, over the truth; by turns


def hidden(
    axis: str,
    seed: int,
    number: int,
    mode_hz: float,
    off: float | None,
    count: float = 0.0,
    *,
    hard: bool = False,
    wide: bool = False,
) -> tuple[RigConfig, dict[str, float]]:
    """A one-axis rig that knows little of its stage, and the stage's truth. count: of the encoder, m (rad); 0: the rig
    file's. hard: the stage is drawn as those of `hil evidence --hard`; wide: as --wide says.
    """
    other = [f"axes.{axis}.encoder_resolution={count}"] if count else []
    whole = only(nominal(load_rig(by_name("rigs", Path(RIG)), other), mode_hz), [axis])
    plant = plant_of(whole, seed, number, mode_hz, hard=hard)
    if wide:
        plant = _widened(plant, Random(f"wide/{seed}/{number}"))
    mine = {key: getattr(whole.plant, key) for key in ("encoder_resolution", "initial_position")}
    known = EMPTY[number % 2] if off is None else dict.fromkeys(TOLD, 1.0 - off)
    told = plant if off is None else whole.axes[axis].model
    axes = {axis: told_wrongly(whole.axes[axis], {key: share * _first(told, key) for key, share in known.items()})}
    drives = whole.drives.model_copy(update={"brake": [axis == "z"]})
    rig = whole.model_copy(update={"axes": axes, "drives": drives, "plant": plant.model_copy(update=mine)})
    return rig, truth_of_axis(plant, axis, 0, SWEPT * axes[axis].limits.position[1])


def _widened(plant: PlantConfig, random: Random) -> PlantConfig:
    """With another lag, and another resonance where there is one."""
    lag = random.uniform(*WIDE_LAG)
    changed = {
        "frequency_hz": between(WIDE_HZ, random.random()),
        "damping": random.uniform(*WIDE_DAMPING),
        "load": random.uniform(*WIDE_LOAD),
    }
    modes = [mode.model_copy(update=changed) if mode.tool else mode for mode in plant.modes]
    return plant.model_copy(update={"torque_lag": [lag], "modes": modes})


def told_wrongly(axis: AxisConfig, known: Mapping[str, float]) -> AxisConfig:
    """With a model of these values, which knows no resonance, and nothing of what is not named."""
    wrong: dict[str, Any] = {**dict.fromkeys(TOLD, 0.0), **known, "mode_frequency_hz": 0.0, "presliding": []}
    return axis.model_copy(update={"model": axis.model.model_copy(update=wrong)})


def _first(values: object, key: str) -> float:
    """Of a plant of one axis, or of a model."""
    value = getattr(values, key)
    return float(value[0] if isinstance(value, list) else value)


def truth_of_axis(plant: PlantConfig, axis: str, number: int, travel: float) -> dict[str, float]:
    """By quantity, as a stage shows it between -travel and travel. number: of the axis on the stage."""

    def of(key: str) -> float:
        value = getattr(plant, key)
        return float(value[number] if isinstance(value, list) else value)

    mean = _mean_sine(travel, of("friction_period"), of("friction_phase"))
    waves = [one for one in plant.cogging if one.axis == axis]
    pulled = sum(one.amplitude * _mean_sine(travel, one.period, one.phase) for one in waves)
    local = of("coulomb") * (1.0 + of("friction_variation") * math.sin(of("friction_phase")))  # in the middle
    truth = {
        "mass": of("mass"),
        "torque_lag": of("torque_lag") + of("encoder_latency"),
        "coulomb": of("coulomb") * (1.0 + of("friction_variation") * mean) + of("cable_hysteresis"),
        "viscous": of("viscous"),
        "constant": -of("gravity") - of("bias") - pulled,
        "presliding": of("presliding"),
        "stiffness": local / of("presliding"),
        "friction_variation": of("friction_variation") * of("coulomb") / (of("coulomb") + of("cable_hysteresis")),
        "friction_period": of("friction_period"),
        "cogging_amplitude": waves[0].amplitude,
        "cogging_period": waves[0].period,
        "friction_phase": of("friction_phase"),
        "cogging_phase": waves[0].phase + math.pi,  # of the force that holds against it
        "position_drift": 0.0,
        "delay": of("encoder_latency"),
    }
    modes = sorted((mode for mode in plant.modes if mode.axis == axis), key=lambda mode: mode.frequency_hz)
    others = 0
    for mode in modes:
        others += not mode.tool
        name = "mode" if mode.tool else f"other_mode_{others}"
        truth |= {
            f"{name}_frequency_hz": mode.frequency_hz, f"{name}_damping": mode.damping, f"{name}_load": mode.load,
        }  # fmt: skip
    return truth


def _mean_sine(travel: float, period: float, phase: float) -> float:
    turn = 2.0 * math.pi * travel / period
    return math.sin(phase) * math.sin(turn) / turn


def following(run: Run) -> float:
    """Greatest following error of a run, over its limit."""
    limits = np.array([axis.limits.following_error for axis in run.rig.axes.values()])
    return float(np.nanmax(np.abs(run.columns["following_error"]) / limits))


def pushed(run: Run, plan: Plan, axis: str) -> float:
    """How far the push moved the axis from where it stood, m."""
    seconds, position = run.columns["task_ns"] * 1e-9, run.columns["position"][:, run.axes.index(axis)]
    during = position[(seconds >= plan.gains["from_s"]) & (seconds < plan.gains["until_s"])]
    return float(np.abs(during - during[0]).max())


def response_errors(measured: Response, truth: Mapping[str, float], period: float) -> tuple[Array, Array]:
    """Of the lines between 10 and 300 Hz that the axis followed: dB and degrees."""
    hertz = measured.frequency_hz
    counts = (hertz >= 10.0) & (hertz <= 300.0) & (measured.coherence > LEAST_COHERENCE)
    tool, *others = [
        tuple(truth.get(f"{name}_{key}", 0.0) for key in OF_MODE) for name in ("mode", "other_mode_1", "other_mode_2")
    ]
    axis = AxisDynamics(truth["mass"], truth["torque_lag"], *tool, truth["viscous"])._replace(others=tuple(others))
    ratio = (measured.response / axis.response(2.0 * np.pi * hertz, period))[counts]
    return np.abs(20.0 * np.log10(np.abs(ratio))), np.abs(np.degrees(np.angle(ratio)))


class Errors:
    """Of identified quantities, stage by stage."""

    def __init__(self) -> None:
        self._errors, self._held = defaultdict[str, list[float]](list), defaultdict[str, list[bool]](list)

    def add(
        self, stage: str, found: Mapping[str, Estimate], refused: Mapping[str, str], truth: Mapping[str, float]
    ) -> None:
        """Of one axis, printed at once."""
        for name, why in refused.items():
            print(f"{stage}: {name} refused: {why}", flush=True)
        for name, true in truth.items():
            if name in found:
                one, value = found[name], true
                if name.endswith("_phase"):
                    value = one.value + math.remainder(true - one.value, 2.0 * math.pi)
                self._errors[name].append(abs(one.value - value) / (1.0 if name in ABSOLUTE else abs(value)))
                self._held[name].append(one.holds(value))
                print(f"{stage}: {name} {one.value:.5g} +- {one.half_width:.2g}, truth {value:.5g}", flush=True)

    def show(self) -> None:
        """Median and worst of each quantity."""
        for name, values in self._errors.items():
            scale, unit = ABSOLUTE.get(name, (100.0, "%"))
            middle, worst, held = scale * np.median(values), scale * max(values), sum(self._held[name])
            print(f"{name:20} median {middle:.3g} {unit}, worst {worst:.3g} {unit}, held {held} of {len(values)}")


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
    parser.add_argument("--hard", action="store_true", help="stages as `hil evidence --hard` draws them")
    parser.add_argument("--wide", action="store_true", help="resonance of 100 to 350 Hz, lag of 0.1 to 0.4 ms")
    parser.add_argument("--only", default=",".join(EXPERIMENTS), help="experiments, comma-separated")
    words = parser.parse_args()
    errors, followed, ways, faults = Errors(), list[float](), list[float](), 0
    decibels, degrees = list[Array](), list[Array]()
    began_s = time.process_time()
    for number in range(words.first, words.first + words.stages):
        off = None if words.empty else words.off
        rig, truth = hidden(
            words.axis, words.seed, number, words.mode, off, words.count, hard=words.hard, wide=words.wide
        )
        shares: list[float] = []

        def runner(trial: Trial, shares: list[float] = shares) -> tuple[Run, str]:
            run, digest = in_virtual_time(trial)
            shares.append(following(run))
            if trial.experiment == "push":
                ways.append(pushed(run, trial.plan, trial.axis))
            return run, digest

        chosen = words.only.split(",")
        found = identify(rig, Path("."), [words.axis], lambda text: None, chosen, runner)[words.axis]
        errors.add(f"stage {number}", found.found, found.refused, truth)
        followed.append(max(shares))
        if found.response:
            for kind, values in zip(
                (decibels, degrees), response_errors(found.response, truth, rig.period_ns * 1e-9), strict=True
            ):
                kind.append(values)
        faults += bool(found.ended)
    errors.show()
    middle, worst = np.median(followed), max(followed)
    print(f"following error over its limit: median {middle:.2f}, worst {worst:.2f}; stages with a fault {faults}")
    unit = "urad" if words.axis == "theta" else "um"
    print(f"first push: median {np.median(ways) * 1e6:.0f} {unit}, worst {max(ways) * 1e6:.0f} {unit}")
    for kind, unit in ((decibels, "dB"), (degrees, "degrees")):
        lines = np.concatenate(kind)
        print(
            f"frequency response, {unit}: median {np.median(lines):.2g}, worst {lines.max():.2g} of {lines.size} lines"
        )
    print(f"{(time.process_time() - began_s) / words.stages:.1f} s of CPU a stage")


if __name__ == "__main__":
    main()
