"""`hil tune`: gains for a law under the rig's own delay, rate, encoder, filter and limits, over tasks and corners.

The simulation is hil/batch.py: a whole generation of candidates, times the corners, is one batch through the cycle's
own arithmetic. The optimiser is scipy's differential evolution, one axis after the other (axes do not interact).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tomlkit
import typer

from hil.batch import FIRST_ON_TASK, BatchRun
from hil.belief import rig_model
from hil.config import RigConfig, RigError, load_rig
from hil.laws import LAWS
from hil.laws.base import Array, Model
from hil.stability import refuse_unstable
from sim_plant.stage import Truth

CORNERS = ((1.0, 1.0), (0.8, 0.7), (0.8, 1.3), (1.2, 0.7), (1.2, 1.3))  # scales of mass and friction
TUNED_CORNERS = (CORNERS[0], CORNERS[2], CORNERS[4])
LOST = 1.0  # m: error of a candidate that diverged
SETTLE_S = 3.0
WINDOW_S = 2.0
DIGITS = 4
QUIET = 0.03  # of the force limit: RMS change of force from tick to tick that costs nothing


class Knob(NamedTuple):
    """One gain's search range, logarithmic; `scale` makes it a gain, by nominal mass, rate and force limit."""

    low: float
    high: float
    scale: str = "1"


def _pd(**more: Knob) -> dict[str, Knob]:
    return {"kp": Knob(0.01, 0.2, "m/T2"), "kd": Knob(0.1, 0.9, "m/T"), **more}


SPACE: dict[str, dict[str, Knob]] = {
    "pd-feedforward": _pd(),
    "pid": _pd(ki=Knob(1e-4, 1e-2, "m/T3")),
    "computed-torque": _pd(sign_width=Knob(1e-4, 2e-2)),
    "robust-pd": _pd(alpha=Knob(1.0, 200.0), epsilon=Knob(1e-3, 10.0)),
    "sliding-mode": {"rate": Knob(0.02, 0.4, "1/T"), "reach": Knob(0.02, 0.5, "F"), "layer": Knob(1e-3, 1.0)},
    "super-twisting": {
        "rate": Knob(0.02, 0.4, "1/T"),
        "k1": Knob(1e-3, 1.0, "F"),
        "k2": Knob(0.1, 100.0, "F"),
        "linear": Knob(0.02, 0.5, "m/T"),
        "smooth": Knob(1e-3, 1e-1),
    },
    "slotine-li": {
        "rate": Knob(0.02, 0.4, "1/T"),
        "kd": Knob(0.05, 0.5, "m/T"),
        "mass_gain": Knob(1e-7, 1e-2),
        "coulomb_gain": Knob(0.1, 1e3),
        "viscous_gain": Knob(1e-3, 1e2),
        "bias_gain": Knob(0.1, 1e3),
    },
    "disturbance-observer": _pd(bandwidth=Knob(0.05, 1.5, "1/T")),
    "structured-kalman": {
        "bandwidth": Knob(0.1, 0.45),
        "damping": Knob(0.3, 1.4),
        "acceleration_noise": Knob(1e-4, 30.0),
        "reversal_noise": Knob(3e-3, 30.0),
        "bias_noise": Knob(1e-4, 10.0),
        "coulomb_noise": Knob(1e-4, 30.0),
        "viscous_noise": Knob(1e-4, 10.0),
        "mass_noise": Knob(1e-6, 1.0),
    },
}


def knob_scale(knob: Knob, model: Model, period: float, force_limit: Array) -> Array:
    """What a knob's number is multiplied by, (n_axes,)."""
    one = np.ones_like(model.mass)
    scale: Array = {
        "1": one,
        "1/T": one / period,
        "m/T": model.mass / period,
        "m/T2": model.mass / period**2,
        "m/T3": model.mass / period**3,
        "F": force_limit * one,
    }[knob.scale]
    return scale


@dataclass(frozen=True)
class Trial:
    """A task to tune on, as overrides of the rig's own, and what counts as a good largest error there (m)."""

    name: str
    task: dict[str, Any]


def trials(rig: RigConfig) -> list[Trial]:
    """The rig's own task and variations of it: gains found on one task alone do not generalise."""
    own = Trial("own task", {})
    task = rig.task
    if task.kind not in ("circle", "lissajous"):
        return [own]
    moves = {"kind": "point_to_point", "target": [0.1 * task.radius] * len(task.axes), "move_s": 1.0, "dwell_s": 0.5}
    off_grid = 2.0 * math.pi * task.frequency_hz * 0.3 * rig.period_ns * 1e-9
    return [
        own,
        Trial("small and quick", {"radius": 0.01 * task.radius, "frequency_hz": 2.0 * task.frequency_hz}),
        Trial("small, off the grid", {"radius": 0.01 * task.radius, "phase": off_grid}),
        Trial("point to point", moves),
    ]


def with_task(rig: RigConfig, task: Mapping[str, Any]) -> RigConfig:
    """The rig with parts of its task replaced."""
    return rig.model_copy(update={"task": rig.task.model_copy(update=dict(task))})


def corner_truths(rig: RigConfig, corners: Sequence[tuple[float, float]], repeats: int = 1) -> Truth:
    """The rig's plant with mass and friction scaled, (repeats * corners, n_axes), corners running faster."""
    plants = [
        rig.plant.model_copy(
            update={"mass_scale": rig.plant.mass_scale * mass, "friction_scale": rig.plant.friction_scale * friction}
        )
        for mass, friction in corners
    ]
    truths = [Truth.from_config(plant, len(rig.axes), rig.axis_names) for plant in plants]
    return Truth.stack(truths * repeats)


class Outcome(NamedTuple):
    """Per candidate and axis, worst over corners and trials: largest and RMS error (m), chatter (N); cost."""

    largest: Array
    rms: Array
    chatter: Array
    cost: Array


class Bench:
    """Runs candidates of one law on every trial and corner."""

    def __init__(self, rig: RigConfig, law: str, corners: Sequence[tuple[float, float]] = TUNED_CORNERS) -> None:
        self.rig, self.law, self.space = rig, law, SPACE[law]
        self._corners = corners
        self._model = rig_model(rig)
        self._limit = np.array([axis.limits.force for axis in rig.axes.values()])
        self._trials = trials(rig)

    def gains(self, points: Array) -> dict[str, Array]:
        """Gains (candidates, n_axes) of points (candidates, n_axes, knobs) in the logarithmic unit cube."""
        period = self.rig.period_ns * 1e-9
        return {
            name: knob.low
            * (knob.high / knob.low) ** points[..., index]
            * knob_scale(knob, self._model, period, self._limit)
            for index, (name, knob) in enumerate(self.space.items())
        }

    def point(self, gains: Mapping[str, Any]) -> Array:
        """The point (n_axes, knobs) of known gains; the middle where one is not given."""
        period, n = self.rig.period_ns * 1e-9, len(self.rig.axes)
        point = np.full((n, len(self.space)), 0.5)
        for index, (name, knob) in enumerate(self.space.items()):
            if name in gains:
                ratio = np.asarray(gains[name]) / knob_scale(knob, self._model, period, self._limit) / knob.low
                point[:, index] = np.log(np.maximum(ratio, 1e-12)) / math.log(knob.high / knob.low)
        clipped: Array = np.clip(point, 0.0, 1.0)
        return clipped

    def run(self, points: Array) -> Outcome:
        """Every trial and corner of every point (candidates, n_axes, knobs)."""
        results = [self._trial(trial, points) for trial in self._trials]
        largest = np.array([result[0] for result in results])
        logs = np.log(largest)
        rms, chatter = (np.max([result[i] for result in results], axis=0) for i in (1, 2))
        # Noise that shakes the drives is no price for accuracy: chatter counts beyond a few per cent of the limit.
        loud = np.log(np.maximum(chatter / (QUIET * self._limit), 1.0))
        return Outcome(largest.max(axis=0), rms, chatter, logs.mean(axis=0) + logs.max(axis=0) + 2.0 * loud)

    def _trial(self, trial: Trial, points: Array) -> tuple[Array, Array, Array]:
        rig = with_task(self.rig, trial.task)
        candidates, corners = len(points), len(self._corners)
        truth = corner_truths(rig, self._corners, candidates)
        gains = {name: np.repeat(values, corners, axis=0) for name, values in self.gains(points).items()}
        law = LAWS[self.law](self._model, rig.period_ns * 1e-9, self._limit, **gains)
        batch = BatchRun(rig, truth, law)
        shape = (candidates, corners, len(rig.axes))
        largest, rms, chatter = (values.reshape(shape).max(axis=1) for values in run_figures(batch, SETTLE_S, WINDOW_S))
        return largest, rms, chatter


def run_figures(batch: BatchRun, settle_s: float, window_s: float) -> tuple[Array, Array, Array]:
    """Largest and RMS error and chatter of every plant over `window_s` after approach and `settle_s`."""
    period = batch.rig.period_ns * 1e-9
    task = batch.rig.task
    approach = 0.0 if task.kind in ("point_to_point", "injection") else task.approach_s
    first = FIRST_ON_TASK + round((approach + settle_s) / period)
    cycle = 1.0 / task.frequency_hz if task.kind in ("circle", "lissajous") else 2.0 * (task.move_s + task.dwell_s)
    ticks = round(max(window_s, cycle) / period)
    largest, squares, changes = (np.zeros(batch.error.shape) for _ in range(3))
    last = batch.force.copy()
    with np.errstate(all="ignore"):
        for tick in range(first + ticks):
            last[...] = batch.force
            batch.tick()
            if tick >= first:
                largest = np.maximum(largest, np.abs(batch.error))
                squares += batch.error * batch.error
                changes += (batch.force - last) ** 2
    largest = np.where(np.isfinite(largest) & (largest < LOST), np.maximum(largest, 1e-12), LOST)
    return largest, np.sqrt(squares / ticks), np.sqrt(changes / ticks)


def search(bench: Bench, population: int, generations: int, seed: int, report: Any) -> tuple[Array, list[Array]]:
    """Differential evolution, axis by axis from the present gains. The best point; all (axis, error, chatter) met."""
    from scipy.optimize import differential_evolution

    best = bench.point(bench.rig.law.model_copy(update={"name": bench.law}).effective_gains())
    met: list[Array] = []
    knobs = len(bench.space)
    rng = np.random.default_rng(seed)
    for axis in range(best.shape[0]):

        def cost(candidates: Array, axis: int = axis) -> Array:
            points = np.repeat(best[None], candidates.shape[1], axis=0)
            points[:, axis] = candidates.T
            outcome = bench.run(points)
            met.append(np.stack([np.full(len(points), axis), outcome.largest[:, axis], outcome.chatter[:, axis]]))
            report(axis, float(outcome.largest[:, axis].min()))
            chosen: Array = outcome.cost[:, axis]
            return chosen

        start = np.clip(best[axis] + 0.15 * rng.standard_normal((population, knobs)), 0.0, 1.0)
        start[0] = best[axis]
        spread = population // 2
        start[spread:] = rng.random((population - spread, knobs))
        result = differential_evolution(
            cost, [(0.0, 1.0)] * knobs, maxiter=generations, init=start, vectorized=True, updating="deferred",
            polish=False, rng=rng, mutation=(0.4, 0.9), recombination=0.9, tol=1e-6,
        )  # fmt: skip
        best[axis] = result.x
    return best, met


def rounded(gains: Mapping[str, Array]) -> dict[str, list[float]]:
    """Gains of one candidate with DIGITS significant digits, per axis."""
    return {name: [float(f"{value:.{DIGITS}g}") for value in values[0].tolist()] for name, values in gains.items()}


def write_gains(path: Path, law: str, gains: Mapping[str, list[float]], note: str) -> None:
    """Put [law.tuned.<law>] into the rig file; everything else, comments included, stays as it is."""
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    section: Any = document.setdefault("law", tomlkit.table())
    if "tuned" not in section:
        section["tuned"] = tomlkit.table(is_super_table=True)
    table = tomlkit.table()
    table.add(tomlkit.comment(note))
    for name, values in gains.items():
        table.add(name, values)
    section["tuned"][law] = table
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def front(met: list[Array], axis: int) -> list[tuple[float, float]]:
    """The trade on one axis: (largest error, chatter) of the candidates that no other beats in both."""
    pairs = np.concatenate(met, axis=1)
    pairs = pairs[1:, pairs[0] == axis]
    chosen: list[tuple[float, float]] = []
    for error, chatter in sorted(zip(*pairs.tolist(), strict=True)):
        if error < LOST and (not chosen or chatter < chosen[-1][1]):
            chosen.append((error, chatter))
    return chosen


def tune(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="rig file")],
    law: Annotated[str, typer.Option(help="law to tune; default: the rig's own")] = "",
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a value")] = None,
    population: Annotated[int, typer.Option(min=5, max=1000, help="candidates per generation")] = 32,
    generations: Annotated[int, typer.Option(min=1, max=1000, help="generations per axis")] = 20,
    seed: Annotated[int, typer.Option(help="of the search")] = 1,
    dry_run: Annotated[bool, typer.Option(help="do not write the rig file")] = False,
) -> None:
    """Find gains for a law on a set of tasks and corners, show the trade, and write them to the rig file."""
    from rich.console import Console
    from rich.progress import Progress

    from hil.sim import metres

    rig = load_rig(rig_file, overrides or ())
    name = law or rig.law.name
    if name not in SPACE:
        raise RigError([f"--law {name}: the laws are {', '.join(SPACE)}"])
    bench, console = Bench(rig, name), Console()
    before = bench.run(bench.point(rig.law.model_copy(update={"name": name}).effective_gains())[None])
    with Progress(console=console, transient=True) as bar:
        job = bar.add_task(f"{rig.name}: {name}", total=(generations + 1) * len(rig.axes))

        def report(axis: int, error: float) -> None:
            bar.update(
                job, advance=1, description=f"{name}, {rig.axis_names[axis]}: best of generation {metres(error)}"
            )

        best, met = search(bench, population, generations, seed, report)
    gains = rounded(bench.gains(best[None]))
    after = bench.run(best[None])
    _show(console, rig, (before, after), met)
    tuned = rig.law.model_copy(update={"name": name, "gains": {}, "tuned": {name: gains}})
    refuse_unstable(rig.model_copy(update={"law": tuned}))
    for key, values in gains.items():
        console.print(f"{key} = {values}")
    if not dry_run:
        settings = " ".join(f"--set {text}" for text in overrides or ())
        note = f"hil tune --law {name} --population {population} --generations {generations} --seed {seed} {settings}"
        write_gains(rig_file, name, gains, note.strip())
        console.print(f"written to {rig_file}: [law.tuned.{name}]", markup=False)


def _show(console: Any, rig: RigConfig, runs: tuple[Outcome, Outcome], met: list[Array]) -> None:
    from rich.table import Table

    from hil.sim import metres

    table = Table(
        "axis", "max before", "max after", "RMS after", "chatter after", title="worst of all tasks and corners"
    )
    before, after = runs
    for index, axis in enumerate(rig.axis_names):
        kind = rig.axes[axis].kind
        table.add_row(
            axis,
            metres(float(before.largest[0, index]), kind),
            metres(float(after.largest[0, index]), kind),
            metres(float(after.rms[0, index]), kind),
            f"{after.chatter[0, index]:.3g}",
        )
    console.print(table)
    for index, axis in enumerate(rig.axis_names):
        trade = front(met, index)
        picked = trade[:: max(len(trade) // 6, 1)][:7]
        shown = "; ".join(f"{metres(error, rig.axes[axis].kind)} at {chatter:.3g}" for error, chatter in picked)
        console.print(f"trade on {axis}, largest error at chatter per tick: {shown}")
