"""A whole run in lockstep and its figures: what `hil sim` shows."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.frame import Frame
from hil.analysis.figures_of_merit import Array, Figures, axis_statistics
from hil.cycle.state_machine import State
from hil.cycle.tick import CycleResult, Tick
from hil.events.event import Event
from hil.events.sources import events_of
from hil.rig.schema import RigConfig, RigError
from hil.virtual.lockstep import LockstepRun, Observer
from sim_plant.scenario.language import Scenario


@dataclass
class SimReport:
    """What `hil sim` prints and writes; SI units."""

    rig: str
    law: str
    gains: dict[str, Any]
    rate_hz: float
    ticks: int
    realtime_factor: float
    steady_from_s: float
    settled: bool  # whether approach and settling were over then, and a set-point still followed
    axes: dict[str, Figures]
    state: str
    faults: dict[str, int]
    trace_sha256: str
    samples_lost: int = 0
    wire_busy: float = 0.0
    overrides: list[str] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    latched: Event | None = None  # of the fault that the run ended with
    law_failure: str = ""  # why a user's law no longer counts, with file and line


def simulate(
    rig: RigConfig,
    base_dir: Path,
    seconds: float,
    *,
    progress: Callable[[int], None] | None = None,
    observer: Observer | None = None,
    scenario: Scenario | None = None,
    tell: Callable[[Sequence[Event]], None] | None = None,
    baseline: dict[str, Any] | None = None,
) -> tuple[SimReport, "Traces"]:
    """Run the rig for `seconds` of virtual time; true following error (the stage's position, before the encoder) at
    every sample. tell: is given the events as they are told. baseline: what its accuracy is held
    against (hil.events.baseline).
    """
    stream = events_of(rig, baseline)
    events: list[Event] = []

    def told(new: Sequence[Event]) -> None:
        events.extend(new)
        if tell and new:
            tell(new)

    def observe(tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        told(stream.observe(run.cycle, result.record))
        if observer:
            observer(tick, frames, result)

    run = LockstepRun(rig, base_dir, observer=observe, scenario=scenario)
    ticks = round(seconds * 1e9 / rig.period_ns)
    traces = Traces(len(rig.axes), rig.period_ns)
    started = time.perf_counter()
    for index in range(ticks):
        run.tick()
        traces.take(run)
        if progress and index % 1000 == 0:
            progress(index)
    elapsed = time.perf_counter() - started
    told(stream.close())
    first = steady_from(run, ticks)
    report = SimReport(
        rig=rig.name,
        law=rig.law.name,
        gains=rig.law.effective_gains(),
        rate_hz=rig.rate_hz,
        ticks=ticks,
        realtime_factor=seconds / elapsed,
        steady_from_s=first * rig.period_ns * 1e-9,
        settled=first >= _steady_due(run) and bool(np.isfinite(traces.error[first:]).any()),
        axes=axis_statistics(rig.axis_names, traces.error[first:], traces.force[first:]),
        state=run.cycle.state.name,
        faults=_faults_of(run),
        trace_sha256=run.trace_sha256,
        samples_lost=run.cycle.inbox.lost,
        wire_busy=run.wire.busy_ns / (ticks * rig.period_ns),
        events=events,
        latched=stream.latched,
        law_failure=run.cycle.law.failure,
    )
    return report, traces


def _faults_of(run: LockstepRun) -> dict[str, int]:
    """Ticks each fault was seen in; and the one that holds the run in FAULT, where it was latched without having been
    looked for: a law's request that is not finite, drives that never enable.
    """
    seen = {name: count for name, count in run.cycle.monitor.named_counts().items() if count}
    latched = run.cycle.fault
    return seen if not latched else {latched.name.lower(): 1} | seen


def steady_from(run: LockstepRun, ticks: int) -> int:
    """First tick of the steady window: after the task's approach and settling, or the last half of a run too short for
    that.
    """
    due = _steady_due(run)
    return due if due < ticks else (run.activated_at + ticks) // 2


def _steady_due(run: LockstepRun) -> int:
    trajectory = run.cycle.setpoints.trajectory
    if run.activated_at < 0 or trajectory is None:
        return 0
    return int(run.activated_at + run.rig.opening_ticks + 2 + trajectory.steady_from_ns // run.rig.period_ns)


class Traces:
    """Per tick: its time, s from the first. Per tick and axis, (ticks, n_axes): true position; setpoint at the
    sample's instant and true error there (NaN where a tick brought none), m; applied force, N.

    Lists while the run goes on: a few numbers at a time are dearer to write into an array.
    """

    def __init__(self, n_axes: int, period_ns: int) -> None:
        self._period_ns = period_ns
        self._none = (math.nan,) * n_axes
        self._true: list[Sequence[float]] = []
        self._setpoint: list[Sequence[float]] = []
        self._force: list[Sequence[float]] = []

    def take(self, run: LockstepRun) -> None:
        """Note the tick just run."""
        cycle = run.cycle
        self._force.append(tuple(cycle.gate.force))
        self._true.append(tuple(run.truth[0]))
        judged = cycle.state is State.ACTIVE and cycle.setpoints.trajectory is not None and all(cycle.inbox.fresh)
        self._setpoint.append([x.sample.position for x in cycle.inputs] if judged else self._none)

    def _columns(self, rows: Sequence[Sequence[float]]) -> Array:
        return np.array(rows).reshape(-1, len(self._none))

    @property
    def time(self) -> Array:
        """When each tick was due."""
        return np.arange(len(self._true), dtype=np.float64) * (self._period_ns * 1e-9)

    @property
    def true(self) -> Array:
        """True position."""
        return self._columns(self._true)

    @property
    def setpoint(self) -> Array:
        """Setpoint."""
        return self._columns(self._setpoint)

    @property
    def error(self) -> Array:
        """True error."""
        return self.true - self.setpoint

    @property
    def force(self) -> Array:
        """Force."""
        return self._columns(self._force)


def usable(rig: RigConfig, rig_file: Path) -> RigConfig:
    """The rig, if a run of it in lockstep can begin. Raises RigError where its task, law, filter, layout or plant do
    not fit.
    """
    try:
        LockstepRun(rig, rig_file.parent)
    except (ValueError, OSError) as error:
        raise RigError([f"{rig_file}: {error}"]) from None
    return rig
