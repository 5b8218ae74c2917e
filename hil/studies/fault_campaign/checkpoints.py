"""The moments of a rig's life that the campaign looks at, and how a run is brought there.

When the operator acts, and when a task has begun, follow from the run itself: drives that are configured over the bus
take longer to be READY, and to be enabled, than others do.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.protocols.base import UNHEALTHY
from hil.control.estimator.gains import per_axis
from hil.control.trajectories import make_trajectory
from hil.cycle.goal import Goal, MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, CycleResult
from hil.rig.schema import RigConfig, RigError
from hil.studies.fault_campaign.clients import client
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun

HOMING_NS = 60_000_000  # after the way home began, in the middle of it
PATIENCE = 10_000  # ticks in which every rig is READY, and its drives enabled


@dataclass(frozen=True)
class Checkpoint:
    """A moment of a run: `ticks` after its beginning, in `state`.

    command: what the operator asks for as soon as the rig is READY. The moment's beginning is then when it was asked
    for or, with `following`, when the drives are enabled and the task's time is 0. Without a command it is when the rig
    became READY, or that share of the time until then which `start` says. stop: the operator stops, so many ticks
    before the moment; 0: not. motion: what a client asks for (motions.py) since the rig holds, which is then the
    moment's beginning; empty: nobody asks. word: what the axes then do; NONE: one of several.
    """

    name: str
    state: State
    ticks: int = 0
    command: CommandKind | None = None
    following: bool = True
    start: float = 1.0
    stop: int = 0
    motion: str = ""
    word: MotionWord = MotionWord.NONE


def active(phase: str, ticks: int) -> Checkpoint:
    """At tick `ticks` of the task."""
    return Checkpoint(f"ACTIVE {phase}", State.ACTIVE, ticks, CommandKind.ACTIVATE)


def stopping(name: str, ticks: int) -> Checkpoint:
    """Four ticks into the damped stop that the operator asks for at tick `ticks` of the task."""
    return Checkpoint(f"STOPPING from {name}", State.STOPPING, ticks + 4, CommandKind.ACTIVATE, stop=4)


READY = Checkpoint("READY", State.READY)


def outside_the_task(rig: RigConfig) -> list[Checkpoint]:
    """Those any rig passes through, whatever its task."""
    return [
        Checkpoint("CONNECTED", State.CONNECTED, start=0.4),
        Checkpoint("CONNECTED, nearly READY", State.CONNECTED, ticks=-2),
        READY,
        Checkpoint("HOMING", State.HOMING, HOMING_NS // rig.period_ns, CommandKind.HOME),
        Checkpoint("ESTOP", State.ESTOP, 5, CommandKind.ESTOP, following=False),
        Checkpoint("ACTIVE, being enabled", State.ACTIVE, 1, CommandKind.ACTIVATE, following=False),
    ]


def task_phases(rig: RigConfig) -> list[tuple[str, int]]:
    """(name, tick of the task): start and middle of every phase of the task, or eighths of a figure."""
    start = per_axis(rig.plant.initial_position, len(rig.axes))
    trajectory = make_trajectory(rig.task, rig.axis_names, start, rig.period_ns, rig.counts)
    period = rig.period_ns
    if trajectory.duration_ns is None:
        approach = round(rig.task.approach_s * 1e9)
        turn = trajectory.repeat_ns or round(1e9)
        times = [("approach", approach // 2)] + [(f"{k}/8 turn", approach + k * turn // 8) for k in range(8)]
        return [(name, t // period) for name, t in times]
    edges: list[tuple[str, int]] = []
    for tick in range(trajectory.duration_ns // period + 2):
        name = trajectory.phase_names[trajectory.phase_at(tick * period)]
        if not edges or edges[-1][0] != name:
            edges.append((name, tick))
    edges.append(("end", edges[-1][1] + 400))
    phases: dict[str, tuple[str, int]] = {}
    for (name, first), (_, last) in itertools.pairwise(edges):
        phases.setdefault(name, (f"{name}, begun", first + 3))
        phases.setdefault(name + " middle", (name, (first + last) // 2))
    return [phase for phase in phases.values() if phase[1] > 0]


def checkpoints(rig: RigConfig) -> list[Checkpoint]:
    """All moments of a rig's life the campaign looks at."""
    phases = task_phases(rig)
    return [*outside_the_task(rig), *(active(*phase) for phase in phases), stopping(*phases[1])]


class CampaignRun(LockstepRun):
    """A run whose every tick is checked by the invariants. asks: what the operator says in the next tick.
    latched: whether the control process found a drive that was not well when it began, and can be told so.
    restarted: another control process has taken over. client: the goals that somebody asks for in a tick.
    """

    def __init__(self, rig: RigConfig, base_dir: Path) -> None:
        self.asks: CommandKind | None = None
        self.latched = self.restarted = False
        self.client: Callable[[int], list[Goal]] = lambda index: []
        observer = Invariants(rig, base_dir).observe
        super().__init__(rig, base_dir, operator=lambda run, index: self._say(), observer=observer)

    def restart(self) -> None:
        """See LockstepRun; the invariants are those of one process."""
        super().restart()
        self.restarted = True
        unhealthy = any(drive.status & UNHEALTHY for drive in self.stage.drives)
        self.latched = unhealthy and self.cycle.protocol.states
        self._observer = Invariants(self.rig, self.base_dir).observe

    def tick(self) -> CycleResult:
        """See LockstepRun."""
        self.goals += self.client(self.index)
        return super().tick()

    def _say(self) -> tuple[CommandKind, ...]:
        said, self.asks = self.asks, None
        return () if said is None else (said,)

    def ready(self) -> None:
        """Until the rig is READY; run.index is then the first tick an operator sees it in. Raises RigError."""
        self._until(lambda: self.cycle.state is State.READY, "READY")

    def follow(self) -> None:
        """Until the drives are enabled and the task has begun. Raises RigError."""
        self._until(lambda: self.cycle.setpoints.trajectory is not None, "enabled")

    def hold(self) -> None:
        """Until the drives are enabled and the rig holds. Raises RigError."""
        self._until(lambda: self.cycle.supervisor.goals.word is MotionWord.HOLD, "holding")

    def on(self, ticks: int) -> None:
        """So many ticks more."""
        for _ in range(ticks):
            self.tick()

    def _until(self, reached: Callable[[], bool], what: str) -> None:
        last = self.index + PATIENCE
        while not reached():
            if self.index >= last:
                state, fault = self.cycle.state.name, self.cycle.fault.name.lower()
                raise RigError([f"{self.rig.name}: not {what} within {PATIENCE} ticks; it is {state}, fault {fault}"])
            self.tick()


def bring_to(rig: RigConfig, base_dir: Path, point: Checkpoint) -> CampaignRun:
    """A run at the checkpoint. Raises RigError where it does not get there."""
    run = CampaignRun(rig, base_dir)
    if point.state is State.CONNECTED:
        scout = CampaignRun(rig, base_dir)
        scout.ready()
        run.on(round(scout.index * point.start) + point.ticks)
    else:
        run.ready()
        if point.command is not None:
            _act(run, point.command, point)
    if run.cycle.state is not point.state:
        state, fault = run.cycle.state.name, run.cycle.fault.name.lower()
        raise RigError([f"{rig.name}: at {point.name} the run is {state}, fault {fault}"])
    word = run.cycle.supervisor.goals.word
    if point.word not in (MotionWord.NONE, word):
        raise RigError([f"{rig.name}: at {point.name} the axes do {word.name}"])
    return run


def _act(run: CampaignRun, command: CommandKind, point: Checkpoint) -> None:
    run.asks = command
    if point.motion:
        run.hold()
        begun, asks = run.index, client(run.rig, [x.end.position for x in run.cycle.inputs], point.motion)
        run.client = lambda index: asks(index - begun)
    elif point.following:
        run.follow()
    run.on(point.ticks - point.stop)
    if point.stop:
        run.asks = CommandKind.STOP
        run.on(point.stop)
