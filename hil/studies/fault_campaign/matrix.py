"""Every trial from every checkpoint: each cell starts from an exact copy of the run, made by fork()."""

import functools
import os
import pickle
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from drivers.protocols.base import DriveStatus
from hil.control.estimator.gains import per_axis
from hil.cycle.fault_monitor import REACTIONS
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import TABLE, TORQUE_STATES, Event, State
from hil.cycle.tick import CommandKind
from hil.rig.bus_load import answer_at_rest
from hil.rig.file import build_rig
from hil.rig.layout import host_layout
from hil.rig.provenance import referenced_files, unpacked_rig
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.checkpoints import READY, CampaignRun, Checkpoint, bring_to, checkpoints
from hil.studies.fault_campaign.layout_capabilities import (
    NONE,
    Capability,
    fixed_capabilities,
    has_room,
    lacking_text,
)
from hil.studies.fault_campaign.motions import motion_points
from hil.studies.fault_campaign.places import TravelWatch
from hil.studies.fault_campaign.trial import Trial, periods, ticks, watchdog
from sim_plant.config import REAL_STAGES

HORIZON_S = 0.075  # a cell is watched after a detection was due: a damped stop takes 50 ms
DRIVES_REACT = 3  # ticks from the gate's zero to drives that have let go, two lost frames included

ENABLED = int(DriveStatus.ENABLED)
Outcome = TypeVar("Outcome")


@dataclass
class Cell:
    """Outcome of one trial at one checkpoint on one axis.

    detection_ticks: -1 where nothing was detected. lacking: why the layout cannot tell this fault from the truth, so
    that less is demanded; empty where it can. out_ticks: until the tip was led out; -1: it was not.
    """

    rig: str
    layout: str
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
    lacking: str
    out_ticks: int = -1


def state_ticks(run: CampaignRun) -> int:
    """By how much later it is seen what drives say of themselves, where they say it in messages of their own time."""
    state_ns = run.cycle.protocol.state_ns
    return -(-state_ns // run.rig.period_ns)


def answer_ticks(run: CampaignRun, began: State) -> int:
    """By how much later a flood is seen that waits for the answer of a drive that is read back before READY."""
    if began is not State.CONNECTED:
        return 0
    _, taken_ns = answer_at_rest(run.rig, run.cycle.protocol)
    return -(-taken_ns // run.rig.period_ns)


def will_move(run: CampaignRun, axis: int, ticks: int) -> bool:
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


def follows(run: CampaignRun) -> bool:
    """Whether the axes follow a task or goals, instead of standing still."""
    return run.cycle.setpoints.trajectory is not None and run.cycle.supervisor.goals.word is not MotionWord.PAUSED


def due_faults(trial: Trial, run: CampaignRun, axis: int) -> tuple[Fault, ...]:
    """The trial's faults, where one of them must be detected from here; none where it need not."""
    if trial.benign or not trial.certain or run.cycle.state not in trial.armed:
        return ()
    if trial.law and not follows(run) and not run.cycle.supervisor.commissioning.done:
        return ()
    if trial.following_only and not follows(run):
        return ()
    if trial.moving_only and not will_move(run, axis, ticks(trial.within, run.rig)):
        return ()
    return trial.faults


def expected_end(trial: Trial, state: State, *, unready: bool) -> set[State]:
    """Where the state machine may be at the end of a cell without a latched fault that began in `state`."""
    connected = {State.CONNECTED} if unready else {State.CONNECTED, State.READY}
    settled = {State.STOPPING: {State.READY}, State.CONNECTED: connected}
    if trial.command is not None:
        event = {CommandKind.ESTOP: Event.ESTOP, CommandKind.ACTIVATE: Event.ACTIVATE}.get(trial.command)
        event = event or {CommandKind.RESET: Event.RESET, CommandKind.STOP: Event.STOP}[trial.command]
        state = TABLE.get((state, event), state)
    return settled.get(state, {state})


class Watch:
    """What is seen of a run after the injection. Ticks count from there; -1: never.

    detected: a fault latched. zero: from then on no drive applies a force. left: from then on the state permits no
    torque. released: from then on no drive is enabled, nor applies a force. peak: greatest force after the detection.
    unasked: ticks before brakes are open, in which nobody asks the law.
    """

    def __init__(self, run: CampaignRun) -> None:
        self._run = run
        self._before = run.cycle.fault
        self.detected = self.zero = self.left = self.released = -1
        self.peak = 0.0
        self.unasked = max(run.cycle.supervisor.opening, 0)

    def look(self, k: int) -> None:
        """After tick `k`."""
        run = self._run
        applied = max(map(abs, run.stage.applied_force))
        enabled = any(drive.status & ENABLED for drive in run.stage.drives)
        if self.detected < 0 and run.cycle.fault not in (Fault.NONE, self._before):
            self.detected = k
        if self.detected >= 0:
            self.peak = max(self.peak, applied)
        self.zero = _since(self.zero, k, not applied)
        self.released = _since(self.released, k, not applied and not enabled)
        self.left = _since(self.left, k, run.cycle.state not in TORQUE_STATES)


def _since(before: int, k: int, holds: bool) -> int:
    if not holds:
        return -1
    return k if before < 0 else before


def failure(trial: Trial, began: State, due: tuple[Fault, ...], run: CampaignRun, seen: Watch, *, unready: bool) -> str:
    """Why the cell failed that began in state `began`; empty where it passed."""
    state, fault = run.cycle.state, run.cycle.fault
    if run.stop:
        return _release_failure(trial, run, seen) if state is State.SHUTDOWN else f"ended {state.name}, not SHUTDOWN"
    if seen.detected < 0:
        if due and began is not State.STOPPING:
            return f"none of {', '.join(f.name for f in due)} detected"
        ends = trial.ends(run) if trial.ends else expected_end(trial, began, unready=unready)
        if state not in ends:
            return f"ended {state.name}, expected {' or '.join(sorted(s.name for s in ends))}"
        return "" if trial.deaf else _release_failure(trial, run, seen)
    # What falsifies force or position, or lets a weight fall, shows there, too; of an axis at rest as motion.
    pushed = fault in (Fault.AXIS_NOT_AS_STATED, Fault.STANDSTILL) and not trial.benign
    if fault not in trial.faults and not pushed:
        return f"latched {fault.name}, which this trial must not cause"
    exactly = trial.exactly(began) if due and trial.exactly and began is not State.STOPPING else fault
    if fault is not exactly and not pushed and not run.cycle.protocol.acts_ns:  # drives in their own time: see trials
        return f"latched {fault.name}, but this is {exactly.name}"
    within = trial.allowed(fault, run.rig) + (state_ticks(run) if ROWS[fault].told_by_drives else 0)
    within += answer_ticks(run, began) if fault is Fault.RECEIVE_FLOOD else 0
    within += seen.unasked if trial.law else 0
    if due and seen.detected > within:
        return f"{fault.name} detected after {seen.detected} ticks, allowed {within}"
    if due and REACTIONS[fault] < trial.demand:
        return f"{fault.name} reacts with {REACTIONS[fault].name}, at least {trial.demand.name} is demanded"
    latched = State.ESTOP if began is State.ESTOP else State.FAULT
    if state is not latched:
        return f"{fault.name} latched, yet the run ended {state.name}"
    return "" if trial.deaf else _zero_failure(trial, fault, run, seen) or _release_failure(trial, run, seen)


def _zero_failure(trial: Trial, fault: Fault, run: CampaignRun, seen: Watch) -> str:
    """Where drives that do not hear the host have come to zero by themselves, counted from the injection, that is in
    time, too.
    """
    stop_ticks = round(run.rig.safety.stop_s * 1e9 / run.rig.period_ns)
    allowed = {Reaction.STOP: stop_ticks + 1, Reaction.SILENT: watchdog(run.rig)}.get(
        REACTIONS[fault], watchdog(run.rig) if fault is Fault.TRANSMIT_BLOCKED else 1
    ) + DRIVES_REACT
    if seen.zero < 0:
        return f"{fault.name}: the drives never came to zero"
    took = seen.zero - seen.detected
    by_themselves = ticks(trial.slack, run.rig) + DRIVES_REACT if trial.slack else -1
    if took > allowed and seen.zero > by_themselves:
        return f"{fault.name}: the drives were at zero {took} ticks after detection, allowed {allowed}"
    return ""


def _release_failure(trial: Trial, run: CampaignRun, seen: Watch) -> str:
    """Where no torque is permitted, no drive may be enabled: it would hold its brake open."""
    if seen.left < 0 or trial.unheld:
        return ""
    allowed = DRIVES_REACT + ticks(trial.slack, run.rig)
    if seen.released < 0:
        return f"{run.cycle.state.name}, yet a drive is enabled or applies a force"
    if seen.released - seen.left > allowed:
        return f"the drives let go {seen.released - seen.left} ticks after torque was forbidden, allowed {allowed}"
    return ""


def run_cell(trial: Trial, point: Checkpoint, axis: int, run: CampaignRun) -> Cell:
    """Inject and watch. The run is used up."""
    seen, places, why, began = Watch(run), TravelWatch(run), "", run.cycle.state
    due = due_faults(trial, run, axis)
    unready = began is State.CONNECTED and trial.unready is not None and trial.unready(run, axis)
    horizon = periods(HORIZON_S, run.rig)
    last = (
        (ticks(trial.within, run.rig) + state_ticks(run) if due else 0)
        + ticks(trial.slack, run.rig)
        + ticks(trial.watch, run.rig)
        + horizon
    )
    run.asks = trial.command
    try:
        k = -1
        while (k := k + 1) < (last if seen.detected < 0 else seen.detected + horizon + 1):  # seen late: time to stop
            trial.step(run, axis, k)
            run.tick()
            seen.look(k)
            places.look()
        why = failure(trial, began, due, run, seen, unready=unready)
        if point.motion and not why:
            why = places.failure(trial)
    except Exception:
        why = traceback.format_exc(limit=-3).strip().replace("\n", " | ")
    fault = run.cycle.fault
    return Cell(
        rig=run.rig.name,
        layout=run.rig.bus.protocol,
        checkpoint=point.name,
        trial=trial.name,
        axis=run.rig.axis_names[axis] if trial.per_axis else "-",
        passed=not why,
        why=why,
        fault=fault.name.lower() if fault else "",
        reaction=REACTIONS[fault].name.lower() if fault else "",
        detection_ticks=seen.detected,
        peak_force_after=seen.peak,
        end=run.cycle.state.name,
        lacking=lacking_text(trial.lacking),
    )


def in_fork(work: Callable[[], Outcome]) -> Outcome:
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
    outcome: Outcome = pickle.loads(data)
    return outcome


@dataclass(frozen=True)
class Chunk:
    """Work for one process: a rig (as a document, so that it travels), a checkpoint, and which cells (trial, axis) to
    try there.
    """

    document: str  # JSON
    files: dict[str, str]  # that it refers to
    point: Checkpoint
    cells: tuple[tuple[int, int], ...]


def _playable(rig: RigConfig, trial: Trial, layout: Capability) -> bool:
    """Whether the trial's fault is there at all: under the rig's layout, on its stage."""
    if trial.staged and rig.plant.stage not in REAL_STAGES:
        return False
    if trial.inputs and not all(axis.limits.switches for axis in rig.axes.values()):
        return False
    if trial.sensors and not rig.sensors:
        return False
    return not trial.only & ~layout


def plan_chunks(
    rig: RigConfig, base_dir: Path, *, stride: int = 1, only: str = "", motion: bool = False
) -> list[Chunk]:
    """One chunk per checkpoint with all its cells, or with every `stride`-th of the whole campaign. only: what the
    names of the trials contain. motion: at the moments of motion by goals instead.
    """
    document, files = rig.model_dump_json(), referenced_files(rig, base_dir)
    layout = fixed_capabilities(host_layout(rig, base_dir))
    cells = [
        (index, axis)
        for index, trial in enumerate(TRIALS)
        if only in trial.name and _playable(rig, trial, layout)
        for axis in range(len(rig.axes) if trial.per_axis else 1)
    ]
    result = []
    points = motion_points(rig) if motion else checkpoints(rig)
    few = READY, [point for point in points if point.state is State.ACTIVE and point.following][1]
    for offset, point in enumerate(points):
        chosen = tuple(
            cell
            for number, cell in enumerate(cells)
            if (number + offset) % stride == 0
            and (point in few or not (TRIALS[cell[0]].staged or TRIALS[cell[0]].few))
            and not (TRIALS[cell[0]].resting_only and point.state in TORQUE_STATES)
        )
        result.append(Chunk(document, files, point, chosen))
    return result


def displaced(rig: RigConfig) -> RigConfig:
    """The rig with its axes a twentieth of the travel off zero, where it does not say itself where they begin: every
    axis then has a way home and an approach.
    """
    if any(per_axis(rig.plant.initial_position, len(rig.axes))):
        return rig
    document = rig.model_dump(mode="json")
    document["plant"]["initial_position"] = [
        0.05 * (high - low) for low, high in (a.limits.position for a in rig.axes.values())
    ]
    return build_rig(document)


def capabilities_of(run: CampaignRun) -> Capability:
    """What the run's layout gives the detectors; the run itself is left untouched."""
    return fixed_capabilities(run.cycle.protocol) | (Capability.ROOM if in_fork(lambda: has_room(run)) else NONE)


def run_chunk(chunk: Chunk) -> list[Cell]:
    """Bring one run to the chunk's checkpoint and try every cell from there, each in a fork."""
    with unpacked_rig(chunk.document, chunk.files) as (rig, folder):
        run = bring_to(rig, folder, chunk.point)
        capabilities, cells = capabilities_of(run), []
        for index, axis in chunk.cells:
            trial = TRIALS[index].over(capabilities)
            cells.append(in_fork(functools.partial(run_cell, trial, chunk.point, axis, run)))
    return cells
