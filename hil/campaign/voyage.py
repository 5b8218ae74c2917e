"""Checkpoints of a run, and the trials tried from each: every cell starts from an exact copy of the run, made by
fork().
"""

import functools
import itertools
import os
import pickle
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.campaign.trials import TRIALS, Trial
from hil.config import RigConfig, build_rig
from hil.estimation import per_axis
from hil.faults import REACTIONS, Fault, Reaction
from hil.invariants import Invariants
from hil.lockstep import LockstepRun
from hil.state_machine import TABLE, Event, State
from hil.tick import CommandKind
from hil.trajectories import make_trajectory

HORIZON = 75  # ticks a cell is watched after a detection was due: a damped stop takes 50
DRIVES_REACT = 3  # ticks from the gate's zero to zero in every drive, two lost frames included


@dataclass(frozen=True)
class Checkpoint:
    """A moment of a run: `ticks` after the operator's `commands` (tick -> command) began, in `state`; phase names the
    task's phase.
    """

    name: str
    state: State
    ticks: int
    commands: tuple[tuple[int, CommandKind], ...] = ()


@dataclass
class Cell:
    """Outcome of one trial at one checkpoint on one axis. detection_ticks: -1 where nothing was detected."""

    rig: str
    checkpoint: str
    trial: str
    axis: str
    passed: bool
    why: str
    fault: str
    reaction: str
    detection_ticks: int
    peak_force_after: float
    end: str


ENABLING = 4  # ticks from activation to the task's time 0, drives' answer included
START = 100  # the tick in which the operator acts; the rig is READY by then


def active(phase: str, ticks: int) -> Checkpoint:
    """`ticks` after activation, in ACTIVE."""
    return Checkpoint(f"ACTIVE {phase}", State.ACTIVE, START + ticks, ((START, CommandKind.ACTIVATE),))


def resting_checkpoints() -> list[Checkpoint]:
    """Those any rig passes through, whatever its task."""
    return [
        Checkpoint("CONNECTED", State.CONNECTED, 8),
        Checkpoint("READY", State.READY, START),
        Checkpoint("HOMING", State.HOMING, START + 60, ((START, CommandKind.HOME),)),
        Checkpoint("ESTOP", State.ESTOP, START + 5, ((START, CommandKind.ESTOP),)),
    ]


def stopping(name: str, ticks: int) -> Checkpoint:
    """Four ticks into the damped stop that the operator asks for `ticks` after activation."""
    stop = START + ticks
    plan = ((START, CommandKind.ACTIVATE), (stop, CommandKind.STOP))
    return Checkpoint(f"STOPPING from {name}", State.STOPPING, stop + 4, plan)


def task_phases(rig: RigConfig) -> list[tuple[str, int]]:
    """(name, ticks after activation): start and middle of every phase of the task, or eighths of a figure."""
    start = per_axis(rig.plant.initial_position, len(rig.axes))
    trajectory = make_trajectory(rig.task, rig.axis_names, start, rig.period_ns)
    period = rig.period_ns
    if trajectory.duration_ns is None:
        approach = round(rig.task.approach_s * 1e9)
        turn = trajectory.repeat_ns or round(1e9)
        times = [("approach", approach // 2)] + [(f"{k}/8 turn", approach + k * turn // 8) for k in range(8)]
        return [(name, t // period + ENABLING) for name, t in times]
    edges: list[tuple[str, int]] = []
    for tick in range(trajectory.duration_ns // period + 2):
        name = trajectory.phase_names[trajectory.phase_at(tick * period)]
        if not edges or edges[-1][0] != name:
            edges.append((name, tick))
    edges.append(("end", edges[-1][1] + 400))
    phases: dict[str, tuple[str, int]] = {}
    for (name, first), (_, last) in itertools.pairwise(edges):
        phases.setdefault(name, (f"{name}, begun", first + ENABLING + 3))
        phases.setdefault(name + " middle", (name, (first + last) // 2 + ENABLING))
    return [phase for phase in phases.values() if phase[1] > ENABLING]


def checkpoints(rig: RigConfig) -> list[Checkpoint]:
    """All moments of a rig's life the campaign looks at."""
    phases = task_phases(rig)
    return [*resting_checkpoints(), *(active(*phase) for phase in phases), stopping(*phases[1])]


def bring_to(rig: RigConfig, base_dir: Path, point: Checkpoint) -> LockstepRun:
    """A run, checked by the invariants on every tick, brought to the checkpoint. Raises RuntimeError where it does not
    get there.
    """
    plan = dict(point.commands)
    run = LockstepRun(
        rig,
        base_dir,
        operator=lambda run, index: (plan[index],) if index in plan else (),
        observer=Invariants(rig, base_dir).observe,
    )
    while run.index < point.ticks:
        run.tick()
    if run.cycle.state is not point.state:
        raise RuntimeError(f"{rig.name}: at {point.name} the run is {run.cycle.state.name}, {run.cycle.fault.name}")
    return run


def will_move(run: LockstepRun, axis: int, ticks: int) -> bool:
    """Whether the task takes the axis so far within `ticks` that standing still must break its following limit."""
    setpoints, limits = run.cycle.setpoints, list(run.rig.axes.values())[axis].limits
    if setpoints.trajectory is None or run.cycle.state is not State.ACTIVE:
        return False
    now = setpoints.task_ns
    times = now + np.arange(0, ticks, 5, dtype=np.int64) * run.rig.period_ns
    reference = setpoints.trajectory.sample(np.repeat(times[:, None], len(run.rig.axes), axis=1))
    travelled = np.abs(reference.position[:, axis] - reference.position[0, axis])
    allowed = limits.following_error * (1.0 + np.abs(reference.velocity[:, axis]) / limits.speed)
    return bool((travelled > 1.5 * allowed).any())


def due_faults(trial: Trial, point: Checkpoint, moves: bool) -> tuple[Fault, ...]:
    """The trial's faults, where one of them must be detected at this checkpoint; none where it need not."""
    if trial.benign or not trial.certain or (trial.moving_only and not moves):
        return ()
    return trial.faults if point.state in trial.armed else ()


def expected_end(trial: Trial, point: Checkpoint) -> set[State]:
    """Where the state machine may be at the end of a cell without a latched fault."""
    ends = {point.state}
    if point.state is State.CONNECTED:
        ends |= {State.READY}
    if point.state is State.STOPPING:
        ends = {State.READY}
    if trial.command is not None:
        event = {CommandKind.ESTOP: Event.ESTOP, CommandKind.ACTIVATE: Event.ACTIVATE}.get(trial.command)
        event = event or {CommandKind.RESET: Event.RESET, CommandKind.STOP: Event.STOP}[trial.command]
        target = TABLE.get((point.state, event))
        if target is not None:
            over = {State.STOPPING: {State.READY}, State.CONNECTED: {State.CONNECTED, State.READY}}
            ends = over.get(target, {target})
    return ends


def judge(
    trial: Trial, point: Checkpoint, due: tuple[Fault, ...], run: LockstepRun, detected_at: int, zero_at: int
) -> str:
    """Why the cell failed; empty where it passed. Ticks count from the injection, -1: never."""
    state, fault = run.cycle.state, run.cycle.fault
    if trial.name == "termination signal":
        return "" if state is State.SHUTDOWN else f"ended {state.name}, not SHUTDOWN"
    if due and point.state is not State.STOPPING and detected_at < 0:
        return f"none of {', '.join(f.name for f in due)} detected"
    if detected_at < 0:
        ends = expected_end(trial, point)
        return "" if state in ends else f"ended {state.name}, expected {' or '.join(sorted(s.name for s in ends))}"
    if fault not in trial.faults:
        return f"latched {fault.name}, which this trial must not cause"
    if due and detected_at > trial.within:
        return f"{fault.name} detected after {detected_at} ticks, allowed {trial.within}"
    if due and REACTIONS[fault] < trial.demand:
        return f"{fault.name} reacts with {REACTIONS[fault].name}, at least {trial.demand.name} is demanded"
    latched = State.ESTOP if point.state is State.ESTOP else State.FAULT
    if state is not latched:
        return f"{fault.name} latched, yet the run ended {state.name}"
    return _judge_zero(fault, run, detected_at, zero_at)


def _judge_zero(fault: Fault, run: LockstepRun, detected_at: int, zero_at: int) -> str:
    stop_ticks = round(run.rig.safety.stop_s * 1e9 / run.rig.period_ns)
    watchdog_ticks = round(run.rig.plant.watchdog_s * 1e9 / run.rig.period_ns)
    allowed = {Reaction.STOP: stop_ticks + 1, Reaction.SILENT: watchdog_ticks + 1}.get(
        REACTIONS[fault], watchdog_ticks + 1 if fault is Fault.TRANSMIT_BLOCKED else 1
    ) + DRIVES_REACT
    if zero_at < 0:
        return f"{fault.name}: the drives never came to zero"
    if zero_at - detected_at > allowed:
        return f"{fault.name}: the drives were at zero {zero_at - detected_at} ticks after detection, allowed {allowed}"
    return ""


def run_cell(trial: Trial, point: Checkpoint, axis: int, run: LockstepRun, rig_name: str) -> Cell:
    """Inject and watch. The run is used up."""
    detected_at = zero_at = -1
    peak = 0.0
    why = ""
    before = run.cycle.fault
    due = due_faults(trial, point, will_move(run, axis, trial.within))
    ticks = (trial.within if due else 0) + HORIZON
    command = trial.command
    run._operator = lambda run, index: (command,) if command is not None and index == start else ()
    start = run.index
    try:
        k = -1
        while (k := k + 1) < (ticks if detected_at < 0 else detected_at + HORIZON + 1):  # seen late: time to stop, too
            trial.step(run, axis, k)
            run.tick()
            applied = max(abs(force) for force in run.stage.applied_force)
            if detected_at < 0 and run.cycle.fault is not before:
                detected_at = k
            if detected_at >= 0:
                peak = max(peak, applied)
                zero_at = -1 if applied else (k if zero_at < 0 else zero_at)
        why = judge(trial, point, due, run, detected_at, zero_at)
    except Exception:
        why = traceback.format_exc(limit=-3).strip().replace("\n", " | ")
    fault = run.cycle.fault
    return Cell(
        rig=rig_name,
        checkpoint=point.name,
        trial=trial.name,
        axis=run.rig.axis_names[axis] if trial.per_axis else "-",
        passed=not why,
        why=why,
        fault=fault.name.lower() if fault else "",
        reaction=REACTIONS[fault].name.lower() if fault else "",
        detection_ticks=detected_at,
        peak_force_after=peak,
        end=run.cycle.state.name,
    )


def in_fork(work: Callable[[], Cell]) -> Cell:
    """Result of `work()` in a forked copy of this process; the process itself is left untouched."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            with os.fdopen(writer, "wb") as stream:
                pickle.dump(work(), stream)
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        data = stream.read()
    os.waitpid(child, 0)
    cell: Cell = pickle.loads(data)
    return cell


@dataclass(frozen=True)
class Leg:
    """Work for one process: a rig (as a document, so that it travels), a checkpoint, and which cells (trial, axis) to
    try there.
    """

    document: dict[str, Any]
    base_dir: str
    point: Checkpoint
    cells: tuple[tuple[int, int], ...]


def legs(rig: RigConfig, base_dir: Path, *, stride: int = 1) -> list[Leg]:
    """One leg per checkpoint with all its cells, or with every `stride`-th of the whole campaign."""
    document = rig.model_dump(mode="json")
    cells = [
        (index, axis) for index, trial in enumerate(TRIALS) for axis in range(len(rig.axes) if trial.per_axis else 1)
    ]
    result = []
    for offset, point in enumerate(checkpoints(rig)):
        chosen = tuple(cell for number, cell in enumerate(cells) if (number + offset) % stride == 0)
        result.append(Leg(document, str(base_dir), point, chosen))
    return result


def displaced(rig: RigConfig) -> RigConfig:
    """The rig with its axes a tenth of the travel off zero: every axis then has a way home and an approach."""
    document = rig.model_dump(mode="json")
    document["plant"]["initial_position"] = [
        0.05 * (high - low) for low, high in (a.limits.position for a in rig.axes.values())
    ]
    return build_rig(document)


def sail(leg: Leg) -> list[Cell]:
    """Bring one run to the leg's checkpoint and try every cell from there, each in a fork."""
    rig = build_rig(leg.document)
    run = bring_to(rig, Path(leg.base_dir), leg.point)
    cells = []
    for index, axis in leg.cells:
        cells.append(in_fork(functools.partial(run_cell, TRIALS[index], leg.point, axis, run, rig.name)))
    return cells
