"""What the drawn stages have to do, and what is read off.

Each trial is a batch of all stages under the cycle's own arithmetic (hil/virtual/batch.py); a stage fails where the
following error of its rig file is exceeded.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.base import Trajectory
from hil.control.trajectories.chosen_axes import ChosenAxes
from hil.control.trajectories.figures import Figure, Oscillation, rational_hz
from hil.control.trajectories.injection import injection
from hil.control.trajectories.segments import Segment, Segments, move, rest
from hil.rig.schema import InjectionConfig, RigConfig
from hil.studies.evidence.stages import BIAS, columns, nominal, only, stage_of
from hil.studies.population import run as run_stages
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from sim_plant.physics.truth import Truth

S = 1_000_000_000  # ns
STEP, SETTLED, BACK = 1e-6, 50e-9, 100e-9  # m
LONG, SHORT, MOVE, PLAN, REST = "10 mm, 1 Hz", "100 um, 2 Hz", "1 mm in 0.3 s", "injection plan", "rest"
HELD_S, STEP_S, STEPS = 10.0, 0.4, (1, 2, 1, 0)  # of the trial at rest: hold, then steps, then the bias
REST_FROM = 5.0  # s: the moves before it, and a second to come to rest
PLAN_DWELL_S = 0.2
JUDGED_REPEATS = 2  # the last ones of a task that learns
WARM_REPEATS, LEARNING_REPEATS = 2, 16
BARELY, MORE = 5e-9, 1.1  # m, part: what counts as worse


class Trial(NamedTuple):
    """name; seconds in all; first second judged; whether modes are tried as well. The last two are of plain runs."""

    name: str
    seconds: float
    judged_from: float
    flexible: bool


TRIALS = (
    Trial(LONG, 9.0, 5.0, True),
    Trial(SHORT, 6.0, 3.0, False),
    Trial(MOVE, 8.0, 4.0, False),
    Trial(PLAN, 9.0, 4.5, False),
    Trial(REST, REST_FROM + HELD_S + STEP_S * len(STEPS) + 1.5, REST_FROM, True),
)


class Job(NamedTuple):
    """What one process runs: rig (as JSON), the axes of it, its draws, one trial, the mode (Hz, 0: none, None: the rig
    file's), whether the stages are hard.
    """

    rig: str
    axes: tuple[str, ...]
    seed: int
    stages: int
    trial: Trial
    mode_hz: float | None
    hard: bool = False


def jobs(
    rig: RigConfig, axes: Sequence[str], stages: int, seed: int, modes: Sequence[float | None], *, hard: bool = False
) -> list[Job]:
    """All that a rig is tried with. With law.iterative_learning: the trials that repeat."""
    document = rig.model_dump_json()
    trials = [trial for trial in TRIALS if trial.name != PLAN or rig.task.injection is not None]
    if rig.law.iterative_learning:
        trials = [trial for trial in trials if trial.name != REST]
    return [
        Job(document, tuple(axes), seed, stages, trial, mode_hz, hard)
        for mode_hz in modes
        for trial in trials
        if trial.flexible or not mode_hz
    ]


def trajectory_of(rig: RigConfig, trial: Trial) -> Trajectory:
    """The trial's reference for all axes, from position 0."""
    n, zero = len(rig.axes), [0.0] * len(rig.axes)
    if trial.name in (LONG, SHORT):
        large = trial.name == LONG
        frequency = 1.0 if large else 2.0
        waves = {}
        for i, axis in enumerate(rig.axes.values()):
            limits = axis.limits
            reach = min(10e-3, 0.8 * min(-limits.position[0], limits.position[1]), 0.8 * limits.speed / 6.283)
            waves[i] = Oscillation(reach if large else 100e-6, rational_hz(frequency), -0.25)
        return Figure(waves, zero, S, 0)
    if trial.name == PLAN:
        assert rig.task.injection is not None  # else there is no such job
        return _cell_after_cell(rig.task.injection, rig.period_ns)
    away = [1e-3] * n
    to_and_fro: list[Segment] = [move(S * 3 // 10, zero, away), rest(S // 5, away), move(S * 3 // 10, away, zero),
                                 rest(S // 5, zero)]  # fmt: skip
    if trial.name == MOVE:
        return Segments(to_and_fro, repeat=True, phase_names=("move",))
    held = [rest(round((1.0 + HELD_S) * S), zero)]
    steps = [rest(round(STEP_S * S), [level * STEP] * n) for level in STEPS]
    return Segments([*to_and_fro * 4, *held, *steps, rest(0, zero)], repeat=False, phase_names=("move",))


def _cell_after_cell(plan: InjectionConfig, period_ns: int) -> Trajectory:
    """The way to the next cell, the strike, a short dwell, the withdrawal and the way back, over and over."""
    zero = [0.0] * len(plan.start)

    def after(point: Sequence[float]) -> list[float]:
        return [p - s + step for p, s, step in zip(point, plan.start, plan.pitch, strict=True)]

    one = {
        "home": zero, "focal": zero, "start": after(plan.start), "contact": after(plan.contact),
        "end": after(plan.end), "cells": 1, "approach_s": plan.transfer_s, "dwell_s": PLAN_DWELL_S,
    }  # fmt: skip
    planned = injection(plan.model_copy(update=one), lambda s: max(round(s * S / period_ns), 1) * period_ns, 0)(zero)
    assert isinstance(planned, Segments)
    return Segments(planned.segments[1:-1], repeat=True, phase_names=planned.phase_names)


def run(job: Job) -> dict[str, Array]:
    """Figures of a trial, each (stages, axes), SI; and whether the stage failed."""
    whole = nominal(RigConfig.model_validate_json(job.rig), job.mode_hz)
    kept = [i for i, name in enumerate(whole.axes) if name in job.axes]
    rig, trial, period = only(whole, job.axes), job.trial, whole.period_ns * 1e-9
    drawn = [
        columns(stage_of(whole, job.seed, number, job.mode_hz, hard=job.hard), kept) for number in range(job.stages)
    ]
    trajectory = ChosenAxes(trajectory_of(whole, trial), kept)
    learns = rig.law.iterative_learning
    from_s, repeat_s = trajectory.repeat_from_ns / S, (trajectory.repeat_ns or 0) / S
    seconds = from_s + (WARM_REPEATS + LEARNING_REPEATS) * repeat_s if learns else trial.seconds
    error = _errors(rig, Truth.stack(drawn), trajectory, round(seconds / period), trial.name == REST)
    following = np.array([axis.limits.following_error for axis in rig.axes.values()])
    size = np.abs(error)
    failed = ~(size.max(axis=0) < following)

    def part(begin: float, end: float) -> slice:
        return slice(round(begin / period), round(end / period))

    if trial.name == REST:
        return {"failed": failed, **_at_rest(error, period)}
    judged = part(seconds - JUDGED_REPEATS * repeat_s if learns else trial.judged_from, seconds)
    figures = {"failed": failed, "peak": size[judged].max(axis=0), "RMS": _rms(error[judged])}
    if learns:
        marks = [from_s + repeat_s * k for k in range(WARM_REPEATS + LEARNING_REPEATS + 1)]
        each = [_rms(error[part(a, b)]) for a, b in pairwise(marks)]
        without = np.maximum(each[WARM_REPEATS - 1], BARELY)
        worse = sum((one > MORE * without).astype(float) for one in each[WARM_REPEATS:])
        figures["repeats worse than the last without"] = np.asarray(worse)
    return figures


def _errors(rig: RigConfig, truth: Truth, trajectory: Trajectory, count: int, disturbed: bool) -> Array:
    """Error of every tick on the task, (ticks, stages, axes), m."""
    batch = BatchRun(rig, truth, trajectory)
    error = np.empty((count, *truth.shape))
    dry = np.array([axis.model.coulomb for axis in rig.axes.values()])
    changes_at = round(_bias_at() / (rig.period_ns * 1e-9)) if disturbed else -1

    def before(k: int) -> None:
        if k == changes_at:
            batch.change(replace(truth, bias=truth.bias - BIAS * dry))

    def after(k: int) -> None:
        if k >= 0:
            error[k] = batch.error

    run_stages(batch, range(-FIRST_ON_TASK, count), before, after)
    return error


def _bias_at() -> float:
    """s on the task at which the bias steps."""
    return REST_FROM + HELD_S + STEP_S * len(STEPS) + 0.5


def _at_rest(error: Array, period: float) -> dict[str, Array]:
    size, begins = np.abs(error), REST_FROM + HELD_S

    def part(begin: float, end: float) -> slice:
        return slice(round(begin / period), round(end / period))

    steps = [size[part(begins + STEP_S * i, begins + STEP_S * (i + 1))] for i in range(len(STEPS))]
    last = size[round(_bias_at() / period) :]
    return {
        "hold 10 s, RMS": _rms(error[part(REST_FROM, begins)]),
        "1 um step to 50 nm": np.mean([_last_beyond(step, SETTLED) for step in steps], axis=0) * period,
        "step of the bias, peak": last.max(axis=0),
        "step of the bias, back to 100 nm": _last_beyond(last, BACK) * period,
    }


def _last_beyond(size: Array, bound: float) -> Array:
    """Samples until the last one that is larger, (...)."""
    late = size > bound
    samples: Array = np.where(late.any(axis=0), late.shape[0] - np.argmax(late[::-1], axis=0), 0)
    return samples


def _rms(error: Array) -> Array:
    root: Array = np.sqrt(np.mean(error * error, axis=0))
    return root
