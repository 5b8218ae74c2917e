"""Thousands of plants with seeded parameters under one rig, in arrays, over all cores or a cluster.

A plant's parameters follow from the seed and its number alone, and a batch's arithmetic does not depend on how plants
are dealt to workers. The same numbers come out of one core, of many, and of a dask.distributed cluster. The worst
plants are saved as rig files; `hil sim` on one of them gives the same error, bit for bit, and the sweep checks that.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from drivers.base.named_file import save_picture, write_text
from drivers.families import layouts, sides_of
from hil.control.law_registry import file_name
from hil.control.laws.base import Array
from hil.control.trajectories import make_trajectory
from hil.events.baseline import BEYOND
from hil.rig.file import load_rig
from hil.rig.former_keys import modernise
from hil.rig.schema import RigConfig, RigError
from hil.studies.population import FRICTION, MASS, drawn, run, stacked
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate

CHUNK = 2500  # plants run as one array: fewer spend their time between array operations, more do not fit a core's cache
DELTA, RIPPLE, STRIBECK = (0.0, 0.3), (0.0, 0.05), (0.0, 0.2)  # as fractions of the nominal Coulomb friction
STARTUP_LIMIT = 1000  # ticks


class Job(NamedTuple):
    """A chunk of plants: rig (as JSON), seed of the sweep, first plant's number, how many, ticks, first steady tick,
    whether with ripple and Stribeck friction."""

    rig: str
    seed: int
    first: int
    plants: int
    ticks: int
    steady: int
    hard: bool


class Figures(NamedTuple):
    """Per plant and axis, (plants, n_axes): largest and RMS error (m), peak force and chatter (N)."""

    max_error: Array
    rms_error: Array
    peak_force: Array
    chatter: Array


def plant_parameters(rig: RigConfig, seed: int, number: int, hard: bool) -> dict[str, Any]:
    """[plant] keys of plant `number`: a function of the arguments alone. hard: with ripple and Stribeck."""
    random = drawn(seed, number)
    coulomb = rig.plant.coulomb
    keys: dict[str, Any] = {
        "mass_scale": random.uniform(*MASS),
        "friction_scale": random.uniform(*FRICTION),
        "modelling_error": [random.uniform(*DELTA) * value for value in coulomb],
    }
    if hard:
        keys["ripple_amplitude"] = [random.uniform(*RIPPLE) * value for value in coulomb]
        keys["stribeck_scale"] = [random.uniform(*STRIBECK) for _ in coulomb]
    return keys


def plant_rig(rig: RigConfig, seed: int, number: int, hard: bool) -> RigConfig:
    """The rig with that plant, and a wire whose timing does not depend on payloads."""
    plant = rig.plant.model_copy(update=plant_parameters(rig, seed, number, hard))
    return rig.model_copy(update={"plant": plant, "wire": rig.wire.model_copy(update={"stuffing": "worst"})})


def run_chunk(job: Job) -> Figures:
    """All ticks of a chunk of plants. What a worker does, here or on another machine."""
    rig = RigConfig.model_validate_json(job.rig)
    n = len(rig.axes)
    plants = [plant_rig(rig, job.seed, job.first + index, job.hard).plant for index in range(job.plants)]
    batch = BatchRun(rig, stacked(rig, plants))
    largest, squares, peak, changes = (np.zeros((job.plants, n)) for _ in range(4))
    last = np.zeros((job.plants, n))
    scratch = np.zeros((job.plants, n))

    def before(tick: int) -> None:
        last[...] = batch.force

    def after(tick: int) -> None:
        if tick < job.steady:
            return
        np.abs(batch.error, out=scratch)
        np.maximum(largest, scratch, out=largest)
        np.multiply(scratch, scratch, out=scratch)
        np.add(squares, scratch, out=squares)
        np.abs(batch.force, out=scratch)
        np.maximum(peak, scratch, out=peak)
        if tick > job.steady:
            np.subtract(batch.force, last, out=scratch)
            np.multiply(scratch, scratch, out=scratch)
            np.add(changes, scratch, out=changes)

    run(batch, range(job.ticks), before, after)
    steady = job.ticks - job.steady
    return Figures(largest, np.sqrt(squares / steady), peak, np.sqrt(changes / max(steady - 1, 1)))


def startup_ticks(rig: RigConfig, base_dir: Path) -> int:
    """Ticks of a single run before the law takes over. Raises RigError where it does not."""
    run = LockstepRun(rig, base_dir)
    for _ in range(STARTUP_LIMIT):
        run.tick()
        if run.activated_at >= 0:
            return run.activated_at + rig.opening_ticks
    raise RigError([f"{rig.name}: not ACTIVE within {STARTUP_LIMIT} ticks of lockstep; try `hil sim`"])


def jobs(
    rig: RigConfig, base_dir: Path, plants: int, seconds: float, seed: int, hard: bool = False, workers: int = 1
) -> list[Job]:
    """The sweep's chunks, at least one for each worker. Raises RigError where `seconds` leave no steady window, or for
    a layout it cannot batch."""
    sides = sides_of(rig.bus.protocol)
    if not (sides and sides.plain) or rig.bus.segments or rig.wire.jitter or rig.wire.drop_probability:
        names = ", ".join(name for name, one in layouts().items() if one.plain)
        wanted = f"the layout {names} on one wire without jitter and loss (bus.protocol, bus.segments, [wire])"
        raise RigError([f"hil sweep batches {wanted}"])
    single = plant_rig(rig, seed, 0, hard)
    task = make_trajectory(rig.task, rig.axis_names, np.zeros(len(rig.axes)), rig.period_ns, rig.counts)
    ticks = round(seconds * 1e9 / rig.period_ns) - startup_ticks(single, base_dir)
    steady = FIRST_ON_TASK + task.steady_from_ns // rig.period_ns
    if steady >= ticks:
        raise RigError([f"--seconds {seconds:g}: the steady window begins at {steady * rig.period_ns * 1e-9:.3f} s"])
    document = rig.model_dump_json()
    chunk = min(CHUNK, math.ceil(plants / workers))
    return [
        Job(document, seed, first, min(chunk, plants - first), ticks, steady, hard) for first in range(0, plants, chunk)
    ]


def collect(results: Iterable[Figures], done: Callable[[int], None]) -> Figures:
    """One Figures over all plants, in order."""
    parts = []
    for part in results:
        parts.append(part)
        done(len(part.max_error))
    return Figures(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def save_worst(
    rig_file: Path, rig: RigConfig, seed: int, hard: bool, numbers: Sequence[int], folder: Path
) -> list[Path]:
    """Rig files of those plants, complete and commented as the original."""
    paths = []
    for number in numbers:
        document = tomlkit.parse(rig_file.read_text(encoding="utf-8"))
        modernise(document)
        _bring_up_to(document, plant_rig(rig, seed, number, hard))
        path = folder / f"{file_name(rig.law.name)}-plant-{number}.toml"
        write_text(path, tomlkit.dumps(document))
        paths.append(path)
    return paths


def _bring_up_to(document: tomlkit.TOMLDocument, single: RigConfig) -> None:
    """Have a rig file say what such a rig is, wherever it says something else: its numbers, and what --set chose."""
    wanted = single.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    for name, chosen in wanted.items():
        if not isinstance(chosen, dict):
            document[name] = chosen
            continue
        table: Any = document.setdefault(name, tomlkit.table())
        for key, value in chosen.items():
            if table.get(key) != value:
                text = isinstance(value, str) and "\n" in value  # a plug-in's source: as lines, not as one of thousands
                table[key] = tomlkit.string(value, multiline=True) if text else value


def reproduce(path: Path, seconds: float, expected: Array) -> bool:
    """Whether `hil sim` on a saved rig gives the largest errors expected, bit for bit."""
    rig = load_rig(path)
    report, _ = simulate(rig, path.parent, seconds)
    largest: list[float] = [axis["max_error"] for axis in report.axes.values()]
    return bool(largest == expected.tolist())


def plot(path: Path, rig: RigConfig, figures: Figures) -> None:
    """Distributions of the largest and RMS error, one curve per axis (PNG)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    share = np.arange(1, len(figures.max_error) + 1) / len(figures.max_error)
    for panel, values, label in zip(axes, (figures.max_error, figures.rms_error), ("largest", "RMS"), strict=True):
        for index, name in enumerate(rig.axis_names):
            panel.step(np.sort(np.maximum(values[:, index], 1e-12)) * 1e6, share, where="post", label=name)
        panel.set_xscale("log")
        panel.set_xlabel(f"{label} error, µm (µrad)")
        panel.grid(alpha=0.3)
    axes[0].set_ylabel("share of plants at or below")
    axes[0].legend()
    figure.suptitle(f"{rig.name}, {rig.law.name}: {len(figures.max_error)} plants")
    save_picture(figure, path)
    pyplot.close(figure)


def summary(rig: RigConfig, figures: Figures) -> dict[str, Any]:
    """Quantiles per axis, SI."""

    def quantiles(values: Array) -> dict[str, float]:
        return {f"p{q:g}": float(np.quantile(values, q / 100)) for q in (50, 90, 99, 100)}

    return {
        name: {key: quantiles(values[:, index]) for key, values in figures._asdict().items()}
        for index, name in enumerate(rig.axis_names)
    }


def beyond_baseline(rig: RigConfig, figures: Figures, kept: dict[str, Any]) -> dict[str, int]:
    """How many plants have an RMS error that the rig's baseline (hil.events.baseline) does not allow, by axis."""
    return {
        name: int(np.count_nonzero(figures.rms_error[:, number] > BEYOND * kept["steady"][name]))
        for number, name in enumerate(rig.axis_names)
        if name in kept["steady"]
    }


def worst_plants(figures: Figures, count: int) -> list[int]:
    """Numbers of the plants with the largest error on any axis, worst first."""
    scaled = np.nan_to_num(figures.max_error, nan=math.inf)
    order = np.argsort(-(scaled / np.maximum(np.median(scaled, axis=0), 1e-12)).max(axis=1), kind="stable")
    return [int(number) for number in order[:count]]
