"""What goes into one control cycle and what comes out: the whole of its contact with the world."""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from drivers.bus.counters import BusState, PortCounters
from drivers.frame import Frame
from hil.cycle.goal import Goal
from hil.rig.schema import LawConfig

__all__ = [
    "BusState", "CommandKind", "CycleResult", "LoadedLaw", "LoadedTask", "OperatorCommand", "PortCounters", "Tick",
]  # fmt: skip


class CommandKind(IntEnum):
    """What an operator (or `hil demo`) may ask of the state machine."""

    ACTIVATE = 1
    STOP = 2
    RESET = 3
    ESTOP = 4
    HOME = 5
    SHUTDOWN = 6
    HEARTBEAT = 7
    LOAD_TASK = 8  # another task, Tick.task, while the stage is at rest
    ACTIVATE_HOLD = 9  # as ACTIVATE, but to hold where the stage stands, for goals
    SET_LAW = 10  # another law, or the same with other gains, Tick.law, while the stage is at rest


class OperatorCommand(NamedTuple):
    """A command from the mailbox. kind: a CommandKind; any other number is refused. sequence: strictly increasing per
    sender session. expires_ns: monotonic ns.
    """

    kind: int
    sequence: int
    expires_ns: int


class LoadedTask(NamedTuple):
    """A task to take the rig's place, ready to begin. plan: from where the stage rests (m by axis) its trajectory, at
    once. start_ranges: by axis, where it may begin, m. document: its [task] as JSON, for the recording.
    """

    plan: Callable[[Sequence[float]], Any]
    start_ranges: Sequence[tuple[float, float]]
    document: str


class LoadedLaw(NamedTuple):
    """A law to take the place of the one that runs. designed: of laws that were made from it elsewhere
    (hil.control.laws.designed_laws), so that making it takes no time; empty: it is found. document: its [law] as JSON,
    for the recording.
    """

    law: LawConfig
    designed: Sequence[Sequence[float]]
    document: str


class Tick:
    """Everything but the frames that a cycle step may depend on.

    index: 0, 1, 2, ...; skipped slots leave gaps. scheduled_ns: the tick's deadline on the control clock.
    now_ns: when the shell woke. commands: in order of arrival. stop: SIGTERM or SIGINT was seen.
    recorder_ok: the sidecar's recorder is alive. realtime_ok: the kernel granted what [timing] asks for.
    rig_ok: the rig file is still the one this process was started with. estop: somebody pressed stop since the last
    tick (hil estop). task: what a LOAD_TASK among the commands loads. law: what a SET_LAW sets. goals: in order of
    arrival.
    """

    __slots__ = (
        "commands",
        "estop",
        "goals",
        "index",
        "law",
        "now_ns",
        "port",
        "realtime_ok",
        "recorder_ok",
        "rig_ok",
        "scheduled_ns",
        "stop",
        "task",
    )

    def __init__(
        self,
        index: int,
        scheduled_ns: int,
        now_ns: int,
        port: PortCounters,
        commands: tuple[OperatorCommand, ...] = (),
        *,
        stop: bool = False,
        recorder_ok: bool = True,
        realtime_ok: bool = True,
        rig_ok: bool = True,
        estop: bool = False,
        task: LoadedTask | None = None,
        law: LoadedLaw | None = None,
        goals: tuple[Goal, ...] = (),
    ) -> None:
        self.index = index
        self.scheduled_ns = scheduled_ns
        self.now_ns = now_ns
        self.port = port
        self.commands = commands
        self.stop = stop
        self.recorder_ok = recorder_ok
        self.realtime_ok = realtime_ok
        self.rig_ok = rig_ok
        self.estop = estop
        self.task = task
        self.law = law
        self.goals = goals


class CycleResult:
    """frames: to send now, in order; empty where nothing may be sent. record: this tick's telemetry
    (hil.cycle.record).
    """

    __slots__ = ("frames", "record")

    def __init__(self, frames: list[Frame], record: np.void) -> None:
        self.frames = frames
        self.record = record
