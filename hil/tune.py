"""`hil tune`: gains for a law under the rig's own delay, rate, encoder, filter and limits, over tasks and corners.

The simulation is hil/rehearsal.py: a whole generation of candidates, times all trials, is one batch through the cycle's
own arithmetic. The optimiser is scipy's differential evolution, one axis after the other (axes do not interact); it
starts from the gains that the rig file has. Same file, seed and options: same gains.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tomlkit
import typer

from hil.config import RigConfig, RigError, load_rig
from hil.laws.base import Array, Model
from hil.rehearsal import LOST, Rehearsal, Trial
from hil.stability import refuse_unstable

CORNERS = ((1.0, 1.0), (0.8, 0.7), (0.8, 1.3), (1.2, 0.7), (1.2, 1.3))  # scales of mass and friction
SETTLE_S = 4.0
WINDOW_S = 4.0
PLAN_FROM_S, PLAN_S, PLAN_DWELL_S = 2.0, 9.0, 0.6  # the injection plan: from the focal range on, and over
PLAN_COUNTS = 4.0  # RMS, encoder counts
DIGITS = 4
QUIET = 0.03  # of the force limit: RMS change of force from tick to tick that costs nothing


class Knob(NamedTuple):
    """One gain's search range, logarithmic; `scale` makes it a gain, by nominal mass, rate, force limit and encoder."""

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
        "reversal_noise": Knob(3e-3, 1.0),
        "bias_noise": Knob(1e-4, 10.0),
        "coulomb_noise": Knob(1e-4, 30.0),
        "viscous_noise": Knob(1e-4, 10.0),
        "mass_noise": Knob(1e-6, 1.0),
        "measurement_noise": Knob(0.29, 3.0, "count"),
    },
}


def knob_scale(knob: Knob, model: Model, period: float, force_limit: Array, resolution: float) -> Array:
    """What a knob's number is multiplied by, (n_axes,); resolution: m per encoder count."""
    one = np.ones_like(model.mass)
    scale: Array = {
        "1": one,
        "1/T": one / period,
        "m/T": model.mass / period,
        "m/T2": model.mass / period**2,
        "m/T3": model.mass / period**3,
        "F": force_limit * one,
        "count": resolution * one,
    }[knob.scale]
    return scale


def trials(rig: RigConfig) -> list[Trial]:
    """The rig's own task, and for figures variations of it in size, speed and kind, light and heavy plants, commands
    late and lost: gains found on one task alone do not generalise (PAPER.md).
    """
    task = rig.task
    if task.injection is not None:
        plan = task.injection.model_copy(update={"cells": 2, "dwell_s": min(task.injection.dwell_s, PLAN_DWELL_S)})
        return [Trial("two cells", {"injection": plan}, PLAN_COUNTS, rms=True)]
    if task.kind not in ("circle", "lissajous"):
        return [Trial("own task", {}, 4.0)]
    error = 0.06  # of the force limit: what friction exceeds the model by; the paper's Delta of 0.3 N at its 5 N

    def figure(size: float, speed: float, **more: Any) -> dict[str, Any]:
        shape = {"radius": size * task.radius, "frequency_hz": speed * task.frequency_hz, "phase": 0.0}
        return {"approach_s": min(task.approach_s, 1.0), **shape, **more}

    def there_and_back(size: float, seconds: float) -> dict[str, Any]:
        target = [size * task.radius] * len(task.axes)
        return {"kind": "point_to_point", "target": target, "move_s": seconds, "dwell_s": 0.5}

    own = figure(1.0, 1.0)
    late = 2.0 * math.pi * task.frequency_hz * 0.3 * rig.period_ns * 1e-9
    chosen = {
        "own task": Trial("", own, 4.0),
        "light, sticky": Trial("", own, 4.0, *CORNERS[2]),
        "heavy, slippery": Trial("", own, 4.0, *CORNERS[3]),
        "own, late commands": Trial("", own, 12.0, jitter=50e-6),
        "own, lost commands": Trial("", own, 8.0, loss=0.01),
        "own, off the grid": Trial("", figure(1.0, 1.0, phase=-late), 20.0),
        "small and quick": Trial("", figure(0.001, 2.0), 7.0),
        "small and slow": Trial("", figure(0.001, 0.4), 7.0),
        "quick": Trial("", figure(0.1, 2.0), 7.0),
        "slow": Trial("", figure(0.2, 0.25), 7.0),
        "slow Lissajous": Trial("", figure(0.5, 0.5, kind="lissajous"), 7.0),
        "long moves": Trial("", there_and_back(0.5, 1.0), 7.0),
        "moves": Trial("", there_and_back(0.1, 1.0), 7.0),
        "short moves": Trial("", there_and_back(0.001, 0.5), 7.0),
    }
    return [trial._replace(name=name, error=error) for name, trial in chosen.items()]


class Outcome(NamedTuple):
    """Per candidate: error in the trial that did worst by its own measure (m), and as a multiple of what is good there;
    chatter (N); cost.
    """

    error: Array
    ratio: Array
    chatter: Array
    cost: Array


class Bench:
    """Runs candidates of one law for one axis on every trial."""

    def __init__(self, rig: RigConfig, law: str, axis: int, chosen: Sequence[Trial] | None = None) -> None:
        self.rig, self.law, self.space, self.axis = rig, law, SPACE[law], axis
        self.trials = list(chosen or trials(rig))
        plan = rig.task.injection is not None
        first, seconds = (PLAN_FROM_S, PLAN_S) if plan else (SETTLE_S, SETTLE_S + WINDOW_S)
        self._rehearsal = Rehearsal(rig, axis, self.trials, round(first * rig.rate_hz), round(seconds * rig.rate_hz), 1)
        resolution = [*rig.axes.values()][axis].encoder_resolution
        self._good = np.array([trial.good for trial in self.trials]) * resolution
        self._scale = [
            float(knob_scale(knob, self._rehearsal.model, rig.period_ns * 1e-9, self._rehearsal.limit, resolution)[0])
            for knob in self.space.values()
        ]

    def gains(self, points: Array) -> dict[str, Array]:
        """Gains (candidates,) of points (candidates, knobs) in the logarithmic unit cube."""
        return {
            name: knob.low * (knob.high / knob.low) ** points[..., index] * scale
            for index, ((name, knob), scale) in enumerate(zip(self.space.items(), self._scale, strict=True))
        }

    def point(self, gains: Mapping[str, Any]) -> Array:
        """The point (knobs,) of known gains (a number or one per axis); the middle where one is not given."""
        point = np.full(len(self.space), 0.5)
        for index, ((name, knob), scale) in enumerate(zip(self.space.items(), self._scale, strict=True)):
            if name in gains:
                value = np.broadcast_to(np.asarray(gains[name], dtype=float), (len(self.rig.axes),))[self.axis]
                point[index] = math.log(max(float(value) / scale / knob.low, 1e-12)) / math.log(knob.high / knob.low)
        clipped: Array = np.clip(point, 0.0, 1.0)
        return clipped

    def run(self, points: Array) -> Outcome:
        """Every trial of every point (candidates, knobs)."""
        figures = self._rehearsal.run(self.law, self.gains(points))
        by_rms = np.array([trial.rms for trial in self.trials])
        errors = np.where(by_rms, figures.rms, figures.largest)
        ratios = errors / self._good
        worst = ratios.argmax(axis=1)
        rows = np.arange(len(points))
        # Noise that shakes the drives is no price for accuracy: chatter counts beyond a few per cent of the limit.
        chatter = figures.chatter.max(axis=1)
        loud = np.log(np.maximum(chatter / (QUIET * self._rehearsal.limit), 1.0))
        logs = np.log(ratios)
        cost = logs.mean(axis=1) + 2.0 * logs.max(axis=1) + 2.0 * loud
        return Outcome(errors[rows, worst], ratios[rows, worst], chatter, cost)


def search(bench: Bench, population: int, generations: int, seed: int, report: Any) -> tuple[Array, Array]:
    """Differential evolution from the rig file's gains: best point; (error, chatter) of all that was met, (met, 2)."""
    from scipy.optimize import differential_evolution

    start = bench.point(bench.rig.law.model_copy(update={"name": bench.law}).effective_gains())
    met: list[Array] = []
    knobs = len(bench.space)
    rng = np.random.default_rng([seed, bench.axis])

    def cost(candidates: Array) -> Array:
        outcome = bench.run(candidates.T)
        met.append(np.stack([outcome.error, outcome.chatter], axis=1))
        report(float(outcome.ratio.min()))
        return outcome.cost

    first = np.clip(start + 0.1 * rng.standard_normal((population, knobs)), 0.0, 1.0)
    first[0] = start
    spread = 3 * population // 4
    first[spread:] = rng.random((population - spread, knobs))
    result = differential_evolution(
        cost, [(0.0, 1.0)] * knobs, maxiter=generations, init=first, vectorized=True, updating="deferred",
        polish=False, rng=rng, mutation=(0.3, 0.8), recombination=0.9, tol=1e-6,
    )  # fmt: skip
    return result.x, np.concatenate(met)


def rounded(axes: Sequence[Mapping[str, Array]]) -> dict[str, list[float]]:
    """Gains of one candidate for every axis, with DIGITS significant digits."""
    return {name: [float(f"{float(gains[name][0]):.{DIGITS}g}") for gains in axes] for name in axes[0]}


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


def front(met: Array) -> list[tuple[float, float]]:
    """The trade: (error, chatter) of the candidates (met, 2) that no other beats in both."""
    chosen: list[tuple[float, float]] = []
    for error, chatter in sorted(map(tuple, met.tolist())):
        if error < LOST and (not chosen or chatter < chosen[-1][1]):
            chosen.append((error, chatter))
    return chosen


def tune(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="rig file")],
    law: Annotated[str, typer.Option(help="law to tune; default: the rig's own")] = "",
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a value")] = None,
    population: Annotated[int, typer.Option(min=5, max=1000, help="candidates per generation")] = 24,
    generations: Annotated[int, typer.Option(min=1, max=1000, help="generations per axis")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="of the search")] = 1,
    dry_run: Annotated[bool, typer.Option(help="do not write the rig file")] = False,
) -> None:
    """Find gains for a law on a set of tasks and plants, show the trade, and write them to the rig file."""
    from rich.console import Console
    from rich.progress import Progress

    rig = load_rig(rig_file, overrides or ())
    name = law or rig.law.name
    if name not in SPACE:
        raise RigError([f"--law {name}: the laws are {', '.join(SPACE)}"])
    console = Console()
    rows, found = [], []
    with Progress(console=console, transient=True) as bar:
        job = bar.add_task(f"{rig.name}: {name}", total=(generations + 1) * len(rig.axes))
        for axis, axis_name in enumerate(rig.axis_names):

            def report(ratio: float, axis_name: str = axis_name) -> None:
                note = f"{name}, {axis_name}: best of this generation {ratio:.2f} times what is good"
                bar.update(job, advance=1, description=note)

            bench = Bench(rig, name, axis)
            best, met = search(bench, population, generations, seed, report)
            known = bench.point(rig.law.model_copy(update={"name": name}).effective_gains())
            rows.append((bench.run(np.stack([known, best])), front(met)))
            found.append(bench.gains(best[None]))
    gains = rounded(found)
    _show(console, rig, rows)
    tuned = rig.law.model_copy(update={"name": name, "gains": {}, "tuned": {name: gains}})
    for key, values in gains.items():
        console.print(f"{key} = {values}")
    refuse_unstable(rig.model_copy(update={"law": tuned}))
    if not dry_run:
        settings = " ".join(f"--set {text}" for text in overrides or ())
        note = f"hil tune --law {name} --population {population} --generations {generations} --seed {seed} {settings}"
        write_gains(rig_file, name, gains, note.strip())
        console.print(f"written to {rig_file}: [law.tuned.{name}]", markup=False)


def _show(console: Any, rig: RigConfig, rows: Sequence[tuple[Outcome, list[tuple[float, float]]]]) -> None:
    from rich.table import Table

    from hil.sim import metres

    table = Table(
        "axis", "before", "after", "of what is good", "chatter", title="worst trial, before and after; trade below"
    )
    for axis, (outcome, _) in zip(rig.axis_names, rows, strict=True):
        before, after = (metres(float(error), rig.axes[axis].kind) for error in outcome.error)
        table.add_row(axis, before, after, f"{outcome.ratio[1]:.2f}", f"{outcome.chatter[1]:.3g}")
    console.print(table)
    for axis, (_, trade) in zip(rig.axis_names, rows, strict=True):
        picked = trade[:: max(len(trade) // 6, 1)][:7]
        shown = "; ".join(f"{metres(error, rig.axes[axis].kind)} at {chatter:.3g}" for error, chatter in picked)
        console.print(f"trade on {axis}, error in the worst trial at chatter per tick: {shown}")
