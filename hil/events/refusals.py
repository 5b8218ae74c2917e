"""Why the cycle refused a command, told from the tick that did and from the commands before it.

The cycle's own order: an expired or replayed command, a state that takes no such event, then the guards of
hil/cycle/supervisor.py. Where the records leave several of them, all of these are named.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from drivers.bus.counters import BusState
from hil.cycle.command_desk import EVENTS, LOADS
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import TABLE, Event, State
from hil.cycle.tick import CommandKind

_RECORDER_OK, _REALTIME_OK, _RIG_OK = 2, 4, 8  # bits of a record's flags
_MOVES: Final = (Fault.STANDSTILL, Fault.AXIS_MOVED)
_BLOCKING: Final = [fault for fault, row in ROWS.items() if row.reaction >= Reaction.STOP and not row.drive_latched]


class HandledCommand(NamedTuple):
    """As hil.cycle.record.COMMAND has it."""

    kind: int
    accepted: int
    sequence: int
    expires_ns: int


class Guards(NamedTuple):
    """What a rig asks for before it becomes ACTIVE. recorder: one that is alive. realtime: that the kernel granted it.
    heartbeat_s: an operator's, no older; 0: none.
    """

    recorder: bool = False
    realtime: bool = False
    heartbeat_s: float = 0.0


def guards_of(rig: Mapping[str, Any]) -> Guards:
    """Those of a rig, as a run's description holds it."""
    timing, safety, telemetry = rig.get("timing", {}), rig.get("safety", {}), rig.get("telemetry", {})
    return Guards(
        bool(telemetry.get("recording_required", False)),
        not timing.get("allow_degraded", True),
        float(safety.get("heartbeat_s", 0.0)),
    )


class Refusals:
    """Follows the commands of one run: their numbers and heartbeats."""

    def __init__(self, guards: Guards) -> None:
        self._guards = guards
        self._sequence = -1
        self._heartbeat_ns: int | None = None

    def cause(self, record: np.void, command: HandledCommand, before: int) -> str:
        """Why it was refused, for people; empty where it was accepted. Each command once, in order. before: the state
        of the tick before.
        """
        now_ns, last = int(record["now_ns"]), self._sequence
        if command.kind == CommandKind.ESTOP:
            return "" if command.accepted else f"{State(before).name} takes no ESTOP"
        if command.accepted:
            self._sequence = command.sequence
            if command.kind == CommandKind.HEARTBEAT:
                self._heartbeat_ns = now_ns
            return ""
        if now_ns > command.expires_ns:
            return f"it expired {(now_ns - command.expires_ns) * 1e-6:.1f} ms before"
        if command.sequence <= last:
            return f"replayed: its number {command.sequence} is not above {last}, that of an earlier command"
        self._sequence = command.sequence
        if command.kind in LOADS:
            return _of_load(record, command.kind)
        event = EVENTS.get(command.kind)
        if event is None:
            return "there is no such command"
        states = State(before), State(int(record["state"]))
        if all((state, event) not in TABLE for state in states):
            return f"{states[0].name} takes no {event.name}"
        reasons = self._missing(record, event, now_ns) + _in_the_way(record, event)
        return " and ".join(reasons) or _left(event, command.kind)

    def _missing(self, record: np.void, event: Event, now_ns: int) -> list[str]:
        """What the rig asks for and is not there."""
        if event not in (Event.ACTIVATE, Event.HOME):
            return []
        flags, guards, heard_ns = int(record["flags"]), self._guards, self._heartbeat_ns
        found = []
        if not flags & _RIG_OK:
            found.append("the rig file has changed since the start")
        if guards.recorder and not flags & _RECORDER_OK:
            found.append("no recorder is alive (telemetry.recording_required)")
        if guards.realtime and not flags & _REALTIME_OK:
            found.append("the kernel did not grant real time (timing.allow_degraded)")
        if guards.heartbeat_s and (heard_ns is None or now_ns - heard_ns > guards.heartbeat_s * 1e9):
            found.append(f"no operator's heartbeat within {guards.heartbeat_s:g} s (safety.heartbeat_s)")
        return found


def _in_the_way(record: np.void, event: Event) -> list[str]:
    """Faults that are still there, and an axis that moves."""
    active = int(record["faults_active"])
    found = []
    if event is Event.RESET:
        found = [f"{fault.name.lower()} is still there" for fault in _BLOCKING if active >> fault & 1]
        if not found and int(record["port"][-1]) >= BusState.BUS_OFF:
            found.append("the bus is off")
    if any(active >> fault & 1 for fault in _MOVES):
        found.append("an axis moves")
    return found


def _left(event: Event, kind: int) -> str:
    """The guards of which the records say nothing."""
    rests = "an axis is not known to rest yet"
    if event is Event.HOME:
        return f"the tip is beyond its safe height, or {rests}"
    if kind == CommandKind.ACTIVATE:
        return f"the task cannot begin where the axes stand, or {rests}"
    return rests


def _of_load(record: np.void, kind: int) -> str:
    if int(record["state"]) != State.READY and record["motion"] != MotionWord.HOLD:
        return "the stage is neither READY nor holding"
    if kind == CommandKind.SET_LAW:
        return "the law does not fit, or the rig's own law learns from the task"
    return "the task cannot begin where the axes stand, or the rig's law learns from its own task"
