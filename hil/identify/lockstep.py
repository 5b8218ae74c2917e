"""The experiments one after the other, and what follows from each; by default in virtual time, on the emulated stage.

Nothing here reads [plant]: what is found comes from the forces and positions that a run of the real stage has, too.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.identify.experiments import EXPERIMENTS, Known, Plan, rig_document
from hil.identify.findings import Findings, fitted
from hil.rig.schema import RigConfig
from hil.runs.api import Run, simulate
from hil.runs.rigs import Rig

APPROACH_S = 1.0
BEFORE_S, AFTER_S = 2.0, 0.5  # of a run, around its task: drives enable, the axis comes to rest
TOGETHER = 0.003  # of an axis' share of its travel, another that rests

Told = Callable[[str], None]


class Trial(NamedTuple):
    """One experiment of one axis as a run. document: of its rig, whose files are relative to `folder`. seconds: of task
    time.
    """

    axis: str
    experiment: str
    plan: Plan
    document: dict[str, Any]
    folder: Path
    seconds: float


Runner = Callable[[Trial], tuple[Run, str]]  # runs it; with a hash of the run


def in_virtual_time(trial: Trial) -> tuple[Run, str]:
    """The Runner of the emulated stage."""
    run = simulate(Rig.build(trial.document, trial.folder), trial.seconds + BEFORE_S + AFTER_S)
    return run, run.trace_sha256


def identify(
    rig: RigConfig,
    folder: Path,
    names: Sequence[str],
    told: Told = print,
    only: Sequence[str] = tuple(EXPERIMENTS),
    runner: Runner = in_virtual_time,
) -> dict[str, Findings]:
    """Run the experiments and fit them. What one is not told by those left out, the rig file's model says. One that
    ends in a fault is the last; what it was to find is refused. Axes that carry a weight come first: while others are
    excited, they are held by what was found of it.
    """
    before: dict[str, Known] = {}
    by_axis = {
        name: _identify_axis(rig, folder, name, told, only, runner, before)
        for name in sorted(names, key=lambda name: rig.axes[name].model.gravity == 0.0)
    }
    return {name: by_axis[name] for name in names}


def _identify_axis(
    rig: RigConfig, folder: Path, name: str, told: Told, only: Sequence[str], runner: Runner, before: dict[str, Known]
) -> Findings:
    """One axis alone, so that what it does to itself ends nobody else's experiments. before: what was found of other
    axes; this one is added.
    """
    findings, axis = Findings(), rig.axes[name]
    known = Known(axis.model.mass, -axis.model.gravity, axis.model.coulomb)
    for experiment, make in EXPERIMENTS.items():
        if experiment not in only:
            continue
        plan = make(axis, known, APPROACH_S)
        document, seconds = rig_document(rig, name, plan, APPROACH_S, before)
        told(f"{name}, {experiment}: {seconds:.0f} s")
        run, findings.evidence[experiment] = runner(Trial(name, experiment, plan, document, folder, seconds))
        if faults := run.summary()["faults"]:
            findings.ended = ", ".join(faults)
            findings.refused[experiment] = f"the run ended in {findings.ended}"
            break
        known = before[name] = fitted(experiment, run, name, folder, plan, findings, known)
        if experiment == "moves" and (moved := _moved_together(run, name)):
            findings.refused["together"] = moved
    return findings


def _moved_together(run: Run, name: str) -> str:
    """In words, which other axes moved as this one did; else "". As shares of their travels."""
    shares = {
        other: float(np.nanmax(np.abs(run.columns["following_error"][:, number]))) / np.ptp(axis.limits.position)
        for number, (other, axis) in enumerate(run.rig.axes.items())
    }
    own = float(np.ptp(run.columns["position"][:, run.axes.index(name)])) / np.ptp(run.rig.axes[name].limits.position)
    return "; ".join(
        f"{other} was moved by {100 * share:.2g} % of its travel while {name} went {100 * own:.0f} % of its own "
        f"(at most {100 * TOGETHER * own:.2g} %)"
        for other, share in shares.items()
        if other != name and share > TOGETHER * own
    )
