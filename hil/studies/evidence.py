"""`hil evidence`: the accuracies a law holds over drawn stages: median and 95 % of each.

A stage's parameters follow from the seed and its number alone. It differs from the rig's nominal model as real stages
do: presliding (LuGre), a lag and a mode that are not quite what the model says, mass and friction off, friction that
varies along the travel, cogging, a cable, an unknown constant force, noise of half a count. Each trial is a batch of
all stages under the cycle's own arithmetic (hil/virtual/batch.py); a stage fails where the following error of its rig
file is exceeded.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from random import Random
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

from hil.cli.options import RigFile
from hil.cli.output import writable, write_json
from hil.cli.processes import worker_pool
from hil.control.laws.base import Array
from hil.control.trajectories.base import Trajectory
from hil.control.trajectories.figures import Figure, Oscillation, rational_hz
from hil.control.trajectories.segments import Segment, Segments, move, rest
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from sim_plant.config import CoggingConfig, ModeConfig, PlantConfig
from sim_plant.physics.truth import Truth

MASS, FRICTION, LAG, MODE = (0.8, 1.2), (0.7, 1.3), (0.8, 1.2), (0.9, 1.1)  # uniform, factors on what the model says
PRESLIDING = (0.3e-6, 30e-6)  # m (rad), log-uniform
DAMPING = (0.15, 0.5)  # ratio of the stuck axis
VARIATION, VARIATION_PERIOD = 0.1, (5e-3, 20e-3)  # of friction along the travel, random phase
COGGING, COGGING_PERIOD = 1 / 30, 24e-3  # of Coulomb friction, random phase; m
CABLE, HYSTERESIS, REACH = 1 / 6, 0.01, 5e-4  # of Coulomb friction: a metre, half the loop; m
BIAS = 0.1  # of Coulomb friction: at most, either sign
NOMINAL_LAG, MODE_DAMPING, MODE_LOAD = 2e-4, 0.02, 0.3
MODES = (0.0, 150.0, 200.0, 300.0)  # Hz of the free axis; 0: rigid
STEP, SETTLED = 1e-6, 50e-9  # m
HEAD = (
    "presliding 0.3-30 um (LuGre, damping 0.15-0.5), mass +-20 %, friction +-30 % and varying by 10 % over 5-20 mm, "
    "lag 0.2 ms +-20 %, mode +-10 % (damping 0.02, 30 % load), cogging, cable, bias +-10 % of Coulomb friction, "
    "half-count noise. Not in it: Stribeck friction, force noise, floor vibration, drift, encoder errors, latency the "
    "stamps do not know. Errors at the encoder; the tool's differ by acceleration / (2 pi f)^2"
)

S = 1_000_000_000  # ns


class Trial(NamedTuple):
    """name; seconds in all; first second judged; whether its modes are tried as well."""

    name: str
    seconds: float
    judged_from: float
    flexible: bool


TRIALS = (
    Trial("10 mm, 1 Hz", 9.0, 5.0, True),
    Trial("100 um, 2 Hz", 6.0, 3.0, False),
    Trial("1 mm in 0.3 s", 8.0, 4.0, False),
    Trial("rest", 18.1, 5.0, True),
)
HELD_S, STEP_S, STEPS = 10.0, 0.4, (1, 2, 1, 0)  # of the trial at rest: hold, then steps, then the bias


class Job(NamedTuple):
    """What one process runs: rig (as JSON), its draws, one trial, the mode (Hz, 0: none)."""

    rig: str
    seed: int
    stages: int
    trial: Trial
    mode_hz: float


def _held(mode_hz: float) -> float:
    """Hz of the tool while the motor is held."""
    return mode_hz * float(np.sqrt(1.0 - MODE_LOAD))


def nominal(rig: RigConfig, mode_hz: float) -> RigConfig:
    """The rig whose model knows the drive's lag and the mode as they are on average."""
    known = {
        "torque_lag": NOMINAL_LAG,
        "mode_frequency_hz": _held(mode_hz),
        "mode_damping": MODE_DAMPING,
        "mode_load": MODE_LOAD,
    }
    axes = {
        name: axis.model_copy(update={"model": axis.model.model_copy(update=known)}) for name, axis in rig.axes.items()
    }
    return rig.model_copy(update={"axes": axes})


def stage_of(rig: RigConfig, seed: int, number: int, mode_hz: float) -> Truth:
    """Stage `number`: a function of the arguments alone."""
    random, names = Random(f"{seed}/{number}"), list(rig.axes)
    models = [axis.model for axis in rig.axes.values()]
    n = len(models)

    def uniform(limits: tuple[float, float]) -> list[float]:
        return [random.uniform(*limits) for _ in range(n)]

    mass, friction, lag, mode = uniform(MASS), uniform(FRICTION), uniform(LAG), uniform(MODE)
    low, high = PRESLIDING
    dry = [m.coulomb for m in models]
    plant = PlantConfig(
        mass=[m.mass * k for m, k in zip(models, mass, strict=True)],
        coulomb=[m.coulomb * k for m, k in zip(models, friction, strict=True)],
        viscous=[m.viscous * k for m, k in zip(models, friction, strict=True)],
        quadratic=[m.quadratic for m in models],
        gravity=[m.gravity for m in models],
        presliding=[low * (high / low) ** random.random() for _ in models],
        presliding_damping=uniform(DAMPING),
        torque_lag=[NOMINAL_LAG * k for k in lag],
        friction_variation=VARIATION,
        friction_period=uniform(VARIATION_PERIOD),
        friction_phase=uniform((0.0, 6.283)),
        cogging=[
            CoggingConfig(axis=name, amplitude=COGGING * c, period=COGGING_PERIOD, phase=random.uniform(0.0, 6.283))
            for name, c in zip(names, dry, strict=True)
        ],
        cable_stiffness=[CABLE * c for c in dry],
        cable_hysteresis=[HYSTERESIS * c for c in dry],
        cable_reach=REACH,
        bias=[random.uniform(-BIAS, BIAS) * c for c in dry],
        encoder_noise=[0.5 * axis.encoder_resolution for axis in rig.axes.values()],
        seed=random.randrange(2**31),
        modes=[
            ModeConfig(axis=name, frequency_hz=_held(mode_hz) * k, damping=MODE_DAMPING, load=MODE_LOAD)
            for name, k in zip(names, mode, strict=True)
            if mode_hz
        ],
    )  # fmt: skip
    return Truth.from_config(plant, n, names)


def trajectory_of(rig: RigConfig, trial: Trial) -> Trajectory:
    """The trial's reference for all axes, from position 0."""
    n, zero = len(rig.axes), [0.0] * len(rig.axes)
    if "Hz" in trial.name:
        large = trial.name.startswith("10 mm")
        frequency = 1.0 if large else 2.0
        waves = {}
        for i, axis in enumerate(rig.axes.values()):
            limits = axis.limits
            reach = min(10e-3, 0.8 * min(-limits.position[0], limits.position[1]), 0.8 * limits.speed / 6.283)
            waves[i] = Oscillation(reach if large else 100e-6, rational_hz(frequency), -0.25)
        return Figure(waves, zero, S, 0)
    away = [1e-3] * n
    to_and_fro: list[Segment] = [move(S * 3 // 10, zero, away), rest(S // 5, away), move(S * 3 // 10, away, zero),
                                 rest(S // 5, zero)]  # fmt: skip
    if trial.name != "rest":
        return Segments(to_and_fro, repeat=True, phase_names=("move",))
    held = [rest(round((1.0 + HELD_S) * S), zero)]
    steps = [rest(round(STEP_S * S), [level * STEP] * n) for level in STEPS]
    return Segments([*to_and_fro * 4, *held, *steps, rest(0, zero)], repeat=False, phase_names=("move",))


def run(job: Job) -> dict[str, Array]:
    """Figures of a trial, each (stages, n_axes), SI; and whether the stage failed."""
    rig = nominal(RigConfig.model_validate_json(job.rig), job.mode_hz)
    trial, period = job.trial, rig.period_ns * 1e-9
    truth = Truth.stack([stage_of(rig, job.seed, number, job.mode_hz) for number in range(job.stages)])
    batch = BatchRun(rig, truth, trajectory_of(rig, trial))
    count = round(trial.seconds / period)
    error = np.empty((count, *truth.shape))
    begins = 4.0 + 1.0 + HELD_S  # of the steps, s
    bias_at = begins + STEP_S * len(STEPS) + 0.5
    dry = np.array([axis.model.coulomb for axis in rig.axes.values()])
    with np.errstate(all="ignore"):
        for k in range(FIRST_ON_TASK + count):
            if trial.name == "rest" and k == FIRST_ON_TASK + round(bias_at / period):
                batch.change(replace(truth, bias=truth.bias - BIAS * dry))
            batch.tick()
            if k >= FIRST_ON_TASK:
                error[k - FIRST_ON_TASK] = batch.error
    following = np.array([axis.limits.following_error for axis in rig.axes.values()])
    size = np.abs(error)
    failed = ~(size.max(axis=0) < following)

    def part(begin: float, end: float) -> slice:
        return slice(round(begin / period), round(end / period))

    if trial.name != "rest":
        judged = part(trial.judged_from, trial.seconds)
        return {"failed": failed, "peak": size[judged].max(axis=0), "RMS": _rms(error[judged])}
    times = []
    for index in range(len(STEPS)):
        late = size[part(begins + STEP_S * index, begins + STEP_S * (index + 1))] > SETTLED
        ticks = np.where(late.any(axis=0), late.shape[0] - np.argmax(late[::-1], axis=0), 0)
        times.append(ticks * period)
    return {
        "failed": failed,
        "hold 10 s, RMS": _rms(error[part(5.0, 5.0 + HELD_S)]),
        "1 um step to 50 nm": np.mean(times, axis=0),
        "step of the bias, peak": size[part(bias_at, trial.seconds)].max(axis=0),
    }


def _rms(error: Array) -> Array:
    root: Array = np.sqrt(np.mean(error * error, axis=0))
    return root


def evidence(
    rig_file: RigFile,
    *,
    stages: Annotated[int, typer.Option(min=2, max=10_000, help="stages drawn for each row")] = 20,
    seed: Annotated[int, typer.Option(help="of the stages")] = 1,
    modes: Annotated[str, typer.Option(help="comma-separated, Hz of the free axis; 0: rigid")] = "0,150,200,300",
    law: Annotated[str, typer.Option(help="default: the rig's own")] = "",
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a value")] = None,
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    json_target: Annotated[
        str, typer.Option("--json", callback=writable, help="write the figures there; - for standard output")
    ] = "",
) -> None:
    """Median and 95 % of a law's accuracies over drawn stages with presliding, lag, mode and noise."""
    from rich.console import Console

    sets = [*(overrides or ()), *([f"law.name={law}"] if law else ()), "law.iterative_learning=false"]
    rig = load_rig(rig_file, sets)
    document = rig.model_dump_json()
    work = [
        Job(document, seed, stages, trial, mode_hz)
        for mode_hz in (float(value) for value in modes.split(","))
        for trial in TRIALS
        if trial.flexible or not mode_hz
    ]
    console = Console(stderr=json_target == "-")
    with worker_pool(workers or len(os.sched_getaffinity(0))) as pool:
        found = list(pool.map(run, work))
    rows = _rows(rig, work, found)
    _show(console, rig, rows, stages, seed)
    if json_target:
        write_json({"rig": rig.name, "law": rig.law.name, "stages": stages, "seed": seed, "of": HEAD, "rows": rows},
                   json_target)  # fmt: skip


def _rows(rig: RigConfig, work: Sequence[Job], found: Sequence[dict[str, Array]]) -> list[dict[str, Any]]:
    """Median and 95 % of every figure, by axis; a stage that failed counts as worse than all others."""
    rows: list[dict[str, Any]] = []
    for job, figures in zip(work, found, strict=True):
        failed = figures["failed"]
        for figure, values in figures.items():
            if figure == "failed":
                continue
            worst = np.where(failed, np.inf, values)
            axes = {
                name: {
                    "median": float(np.quantile(worst[:, i], 0.5, method="higher")),
                    "p95": float(np.quantile(worst[:, i], 0.95, method="higher")),
                    "failed": int(failed[:, i].sum()),
                }
                for i, name in enumerate(rig.axis_names)
            }
            name = figure if job.trial.name == "rest" else f"{job.trial.name}: {figure}"
            rows.append({"mode_hz": job.mode_hz, "figure": name, "axes": axes})
    return rows


def _show(console: Any, rig: RigConfig, rows: Sequence[dict[str, Any]], stages: int, seed: int) -> None:
    from rich.table import Table

    title = f"{rig.name}, {rig.law.name} at {rig.rate_hz:g} Hz: median / 95 % of {stages} stages, seed {seed}"
    table = Table(title=title, caption=HEAD)
    table.add_column("mode")
    table.add_column("figure")
    for name in rig.axis_names:
        table.add_column(name, justify="right")
    for row in rows:
        time = "step to" in row["figure"]
        unit, scale = ("ms", 1e3) if time else ("nm", 1e9)
        cells = []
        for axis in row["axes"].values():
            failed = f" ({axis['failed']} failed)" if axis["failed"] else ""
            cells.append(f"{axis['median'] * scale:.3g} / {axis['p95'] * scale:.3g}{failed}")
        mode = f"{row['mode_hz']:g} Hz" if row["mode_hz"] else "rigid"
        table.add_row(mode, f"{row['figure']}, {unit}", *cells)
    console.print(table)
