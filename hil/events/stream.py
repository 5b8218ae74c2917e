"""Events: what happened in a run, told from the records of its ticks.

Rules:
- What follows from the records alone is told by `EventStream`, and nowhere else: lockstep, replay, sidecar and
  recordings give it the same records and get the same events. The control loop pays for none of it.
- Every event carries what a person needs to act on it alone: tick, time, axis, measured value, limit, cause, what to do
  next. The texts are those of table.py and of the faults' rows.
- A storm is bounded and counted (storm.py).

Theory of operation: the detectors leave what they measured in the record (fault_monitor.Evidence). The stream compares
each record with the one before it; numpy finds the few ticks in which anything changed, and only those are looked at.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.bus.counters import BusState
from hil.cycle.fault_table import GRANTS, ROWS, Fault, Form, Row
from hil.cycle.faults.row import OF_SENSOR
from hil.cycle.goal import MotionWord
from hil.cycle.record import EVERY_AXIS, MAX_EVIDENCE, NO_AXIS, RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.events.accuracy import AccuracyWatch, Loss
from hil.events.axis_model import ROTARY, AxisModel, axis_models
from hil.events.baseline import known_of
from hil.events.causes import History
from hil.events.event import Event
from hil.events.motion_causes import Cause
from hil.events.refusals import Guards, HandledCommand, Refusals, guards_of
from hil.events.storm import Tallies
from hil.events.table import KINDS, REFUSED_ACTION, Kind, Severity, severity_of

_STOP, _RIG_OK, _ESTOP = 1, 8, 32  # bits of a record's flags
_COMPARED = ("state", "fault", "faults_active", "flags")
_HELD = 64  # ticks `observe` collects
_NAN: Final = math.nan
_OF_ANSWERS: Final = (Fault.ENCODER_GAP, Fault.ENCODER_LOST, Fault.ENCODER_DEAD, Fault.BAD_FRAMES)
_OF_MOTION: Final = (Fault.ENCODER_STUCK, Fault.FOLLOWING_ERROR, Fault.FILTER_DIVERGED, Fault.SPEED)
_REACHED: Final = {
    (State.BOOT, State.CONNECTED): "the bus is up",
    (State.CONNECTED, State.READY): "every axis answers and is healthy",
    (State.HOMING, State.STOPPING): "the home position is reached",
    (State.STOPPING, State.READY): "at rest",
    (State.STOPPING, State.FAULT): "at rest with a fault latched",
    (State.STOPPING, State.SHUTDOWN): "at rest, and the process is to end",
}


class _Seen(NamedTuple):
    """What the stream remembers of the tick before."""

    tick: int = -1
    state: int = int(State.BOOT)
    fault: int = 0
    active: int = 0
    flags: int = _RIG_OK
    bus: int = int(BusState.ERROR_ACTIVE)
    total: int = 0  # evidence


class EventStream:
    """Tells the events of one run from its records, in order.

    axes: name and kind ("linear" or "rotary") of every axis. period_ns: of the control loop. sensors: name and unit of
    every sensor. models: of every axis, for its accuracy to be watched; none: it is not. known: what a baseline bounds,
    by axis. rig: its name, for next steps; empty: they say NAME. guards: what the rig asks for before it becomes
    ACTIVE. latched: the event of the fault that is latched now.
    """

    def __init__(
        self,
        axes: Sequence[tuple[str, str]],
        period_ns: int,
        sensors: Sequence[tuple[str, str]] = (),
        models: Sequence[AxisModel] = (),
        known: Sequence[Mapping[str, Mapping[str, float]]] = (),
        rig: str = "",
        guards: Guards | None = None,
    ) -> None:
        self._rig = rig
        self._axes = list(axes)
        self._sensors = list(sensors)
        self._watch = AccuracyWatch(models, max(period_ns, 1), known) if models else None
        self._period_ns = max(period_ns, 1)
        self._window_ticks = max(1, round(1e9 / self._period_ns))
        self._tallies = Tallies()
        self._refusals = Refusals(guards or Guards())
        self._last = _Seen()
        self._pairs: set[tuple[int, int]] = set()  # fault and axis flagged in the last tick
        self._history = History(len(self._axes), self._period_ns * 1e-9, models)
        self._first: Event | None = None  # what was seen first of all that is wrong now
        self._held: list[bytes] = []  # records of `observe`: as bytes 0.3 us each, into an array 1.5
        self.latched: Event | None = None

    def observe(self, record: np.void) -> list[Event]:
        """Take one tick in; what it and those before it told comes with a later one, or with `close`."""
        self._held.append(record.tobytes())
        return self.release() if len(self._held) == _HELD else []

    def close(self) -> list[Event]:
        """What is still held back: ticks of `observe`, and the counts of the present second."""
        return [*self.release(), *self._tallies.end()]

    def release(self) -> list[Event]:
        """What the ticks of `observe` that are held back have told."""
        records = np.frombuffer(b"".join(self._held), RECORD)
        self._held.clear()
        return self.tell(records)

    def admit(self, events: Iterable[Event]) -> list[Event]:
        """Events from elsewhere that are to be bounded with these."""
        return self._tallies.admit(event.pasted(self._rig) for event in events)

    def tell(self, records: NDArray[np.void], lost: int = 0) -> list[Event]:
        """The events of these ticks. lost: ticks that are missing before the first of them."""
        told: list[Event] = []
        if not len(records):
            return told
        if lost:
            event = self._event(Kind.RECORDS_LOST, "ring", records[0], value=float(lost), limit=0.0)
            told += self.admit([event])
            self._last = self._last._replace(tick=-1)
        self._history.begin(records)
        losses = self._watch.take(records) if self._watch else []
        places = self._places(records)
        if losses:
            places = np.union1d(places, [loss.at for loss in losses])
        for place in places.tolist():
            record = records[place]
            self._history.look(place)
            if place:
                before = records[place - 1]
                self._last = self._last._replace(tick=int(before["index"]))
            told += self._tallies.turn(int(record["index"]) // self._window_ticks)
            told += self.admit(self._look(record))
            told += self.admit(self._accuracy(record, loss) for loss in losses if loss.at == place)
        self._history.end()
        self._last = self._last._replace(tick=int(records["index"][-1]))
        told += self._tallies.turn(self._last.tick // self._window_ticks)
        return told

    def _places(self, records: NDArray[np.void]) -> NDArray[np.int64]:
        """Of the ticks in which something changed or was flagged."""
        last = self._last
        marked = (records["n_evidence"] > 0) | (records["n_commands"] > 0) | self._late(records)
        before = dict(zip(_COMPARED, (last.state, last.fault, last.active, last.flags), strict=True))
        for name in _COMPARED:
            marked |= _changes(records[name], before[name])
        marked |= _changes(records["port"][:, -1], last.bus)
        marked |= np.diff(records["index"], prepend=last.tick) > 1
        if self._pairs or int(records["evidence_total"][0]) != last.total + int(records["n_evidence"][0]):
            marked[0] = True
        flagged = np.flatnonzero(records["n_evidence"][:-1] > 0)
        marked[flagged + 1] = True  # where what was flagged may be over
        return np.flatnonzero(marked)

    def _late(self, records: NDArray[np.void]) -> NDArray[np.bool_]:
        late: NDArray[np.bool_] = records["now_ns"] - records["scheduled_ns"] > self._period_ns // 2
        return late

    # one tick ---------------------------------------------------------------------------------------------------------

    def _look(self, record: np.void) -> Iterator[Event]:
        """What one tick has to tell; remembers it."""
        last = self._last
        index, state, fault = int(record["index"]), int(record["state"]), int(record["fault"])
        active, flags, bus = int(record["faults_active"]), int(record["flags"]), int(record["port"][-1])
        self._last = _Seen(index, state, fault, active, flags, bus, int(record["evidence_total"]))
        yield from self._pacing(record, last.tick)
        if bus != last.bus:
            yield self._bus(record, last.bus, bus)
        if (flags ^ last.flags) & _RIG_OK:
            name = "as it was read" if flags & _RIG_OK else "changed"
            yield self._event(Kind.RIG_FILE, name, record)
        evidence = _evidence(record)
        yield from self._faults(record, evidence, active, last)
        if fault != last.fault:
            yield from self._latches(record, evidence, last.fault, fault)
        commands = [HandledCommand(*row) for row in record["commands"][: int(record["n_commands"])].tolist()]
        for command in commands:
            refused = self._refusals.cause(record, command, last.state)
            if command.kind != CommandKind.HEARTBEAT or not command.accepted:
                yield self._command(record, command, refused)
        if state != last.state:
            yield self._state(record, last, commands)

    def _pacing(self, record: np.void, before: int) -> Iterator[Event]:
        index = int(record["index"])
        late_ns = int(record["now_ns"]) - int(record["scheduled_ns"])
        if 0 <= before < index - 1:
            yield self._event(Kind.TICKS_LOST, "slots", record, value=float(index - before - 1), limit=0.0)
        elif late_ns > self._period_ns // 2:
            limit = self._period_ns // 2 * 1e-9
            yield self._event(Kind.TICK_LATE, "deadline", record, value=late_ns * 1e-9, limit=limit)

    def _bus(self, record: np.void, before: int, now: int) -> Event:
        name = f"{BusState(before).name} -> {BusState(now).name}"
        healed = now == BusState.ERROR_ACTIVE
        event = self._event(Kind.BUS, name, record)
        if not healed:
            return event
        return event._replace(severity=Severity.NOTICE, cause="the controller recovered", action="none")

    def _faults(self, record: np.void, evidence: "list[_Evidence]", active: int, last: _Seen) -> Iterator[Event]:
        """Faults that this tick flagged and the one before did not; what was measured beyond what a record keeps."""
        unkept = int(record["evidence_total"]) - last.total - len(evidence)
        pairs = {(found.fault, found.axis) for found in evidence}
        known = {fault for fault, _ in pairs}
        bare = [fault for fault in Fault if fault and active >> fault & 1 and fault not in known]
        if unkept > 0:  # what was flagged before still is, if its bit is set: a record with no room is no end of it
            pairs |= {pair for pair in self._pairs if active >> pair[0] & 1}
        for fault in bare:
            if not any(pair[0] == fault for pair in pairs):
                pairs.add((int(fault), NO_AXIS))
                evidence = [*evidence, _Evidence(int(fault), NO_AXIS, 0.0 if fault in GRANTS else _NAN, _NAN)]
        if all(fault in GRANTS for fault, _ in self._pairs):
            self._first = None
        fresh = [found for found in evidence if (found.fault, found.axis) not in self._pairs]
        for found in self._of_all_axes(fresh):
            event = self._fault(Kind.FAULT_SEEN, record, found)
            if self._first is None and found.fault not in GRANTS:
                self._first = event
            yield self._following(event)
        for number, axis in sorted(self._pairs - pairs):
            if number in GRANTS:
                yield self._fault(Kind.FAULT_CLEARED, record, _Evidence(number, axis, 1.0, _NAN))
        self._pairs = pairs
        if unkept > 0:
            event = self._event(Kind.FAULT_SEEN, "more in one tick than a record keeps", record)
            yield event._replace(times=unkept, cause="see the faults told beside it", action="as for those")

    def _of_all_axes(self, evidence: "list[_Evidence]") -> "list[_Evidence]":
        """Answers that all axes miss in one tick are one happening, of none of them."""
        found: list[_Evidence] = []
        for one in evidence:
            alike = sum(other.fault == one.fault and other.axis != NO_AXIS for other in evidence)
            whole = alike == len(self._axes) > 1 and one.axis != NO_AXIS and one.fault in _OF_ANSWERS
            shared = one._replace(axis=NO_AXIS) if whole else one
            if not whole or all(shared.fault != other.fault for other in found):
                found.append(shared)
        return found

    def _following(self, event: Event) -> Event:
        """With the fault that came first, within a window."""
        first = self.latched or self._first
        if first is None or event.name == first.name or event.tick - first.tick > self._window_ticks:
            return event
        whose = f" on {first.axis}" if first.axis else ""
        return event._replace(cause=f"{event.cause}; after {first.name}{whose} at tick {first.tick}")

    def _latches(self, record: np.void, evidence: "list[_Evidence]", before: int, now: int) -> Iterator[Event]:
        if before and self.latched:
            when = self._event(Kind.FAULT_CLEARED, "", record)
            cleared = self.latched._replace(kind=when.kind, severity=when.severity, tick=when.tick, action=when.action)
            cleared = cleared._replace(measured="", value=_NAN, limit=_NAN)  # which is not so any more
            yield cleared._replace(time_ns=when.time_ns, run_ns=when.run_ns, cause="an operator's reset")
            self.latched = None
        if now:
            alike = self._of_all_axes([found for found in evidence if found.fault == now])
            found = alike[0] if alike else _Evidence(now, NO_AXIS, _NAN, _NAN)
            self.latched = self._following(self._fault(Kind.FAULT_LATCHED, record, found)).pasted(self._rig)
            yield self.latched

    def _command(self, record: np.void, command: HandledCommand, refused: str) -> Event:
        name = CommandKind(command.kind).name if command.kind in set(CommandKind) else f"number {command.kind}"
        event = self._event(Kind.COMMAND, f"{name} {'accepted' if command.accepted else 'refused'}", record)
        if command.accepted:
            return event._replace(cause="an operator's command")
        cause = f"{refused}; the state is {State(int(record['state'])).name}"
        return event._replace(severity=Severity.WARNING, cause=cause, action=REFUSED_ACTION)

    def _state(self, record: np.void, last: _Seen, commands: list[HandledCommand]) -> Event:
        before, now = State(last.state), State(int(record["state"]))
        event = self._event(Kind.STATE, f"{before.name} -> {now.name}", record)
        led_out = "; the tip goes to its safe height first" if record["motion"] == MotionWord.WITHDRAW else ""
        event = event._replace(cause=self._state_cause(record, last, commands) + led_out)
        if now is State.FAULT and self.latched:
            return event._replace(severity=self.latched.severity, action=self.latched.action)
        if now is State.ESTOP:
            action = "find out why; then hil command NAME reset"
            return event._replace(severity=Severity.WARNING, action=action)
        return event

    def _state_cause(self, record: np.void, last: _Seen, commands: list[HandledCommand]) -> str:
        """Why the state changed, as far as the record says."""
        before, now, fault = State(last.state), State(int(record["state"])), int(record["fault"])
        if fault and fault != last.fault:
            return f"fault {Fault(fault).name.lower()}"
        if now is State.ESTOP and int(record["flags"]) & _ESTOP:
            return "stop was pressed (hil estop)"
        if accepted := [command for command in commands if command.accepted and command.kind != CommandKind.HEARTBEAT]:
            return "command " + ", ".join(CommandKind(command.kind).name for command in accepted)
        if reached := _REACHED.get((before, now)):
            return reached + (f": {Fault(fault).name.lower()}" if fault and now is State.FAULT else "")
        if int(record["flags"]) & _STOP:
            return "the process was told to end"
        failed = "the motion failed" if record["motion"] == MotionWord.WITHDRAW else "it was so when the records begin"
        return f"fault {Fault(fault).name.lower()}" if fault else failed

    # events -----------------------------------------------------------------------------------------------------------

    def _event(self, kind: Kind, name: str, record: np.void, value: float = _NAN, limit: float = _NAN) -> Event:
        text, index = KINDS[kind], int(record["index"])
        return Event(
            kind, text.severity, name, index, int(record["now_ns"]), index * self._period_ns, "", text.measured,
            value, limit, text.unit, text.cause, text.action,
        )  # fmt: skip

    def _fault(self, kind: Kind, record: np.void, found: "_Evidence") -> Event:
        fault = Fault(found.fault)
        text = ROWS[fault]
        cause = None if kind is Kind.FAULT_CLEARED else self._cause(fault, found.axis)
        if cause and found.axis == NO_AXIS:
            found = found._replace(axis=cause.axis)
        unit, name, rotary = text.unit, "", False
        if text.of_sensor:
            if 0 <= found.axis < len(self._sensors):
                name, own_unit = self._sensors[found.axis]
                unit = own_unit if unit == OF_SENSOR else unit
        elif 0 <= found.axis < len(self._axes):
            name, axis_kind = self._axes[found.axis]
            rotary = axis_kind == "rotary"
        event = self._event(kind, fault.name.lower(), record, found.value, found.limit)
        latched = kind is Kind.FAULT_LATCHED
        severity = event.severity if kind is Kind.FAULT_CLEARED else severity_of(fault, latched=latched)
        event = event._replace(severity=severity, axis=name, measured=_measured(text, found.value))
        unit = ROTARY.get(unit, unit) if rotary else unit
        if kind is Kind.FAULT_CLEARED:
            return event._replace(unit=unit, cause="it is there again")
        why, action = (cause.text, cause.action) if cause else (text.cause, text.action)
        if text.of_sensor and name:
            action = action.replace("sensors.NAME", f"sensors.{name}")
        return event._replace(unit=unit, cause=why, action=action.replace("AXIS", name or "NAME"))

    def _cause(self, fault: Fault, axis: int) -> Cause | None:
        """What the ticks before say of it; None where the fault's row says all that is known."""
        if fault in _OF_ANSWERS:
            return self._history.silence()
        if axis != NO_AXIS and fault is Fault.OSCILLATION:
            return self._history.ringing(axis)
        return self._history.why_it_left(axis) if fault in _OF_MOTION and axis != NO_AXIS else None

    def _accuracy(self, record: np.void, loss: Loss) -> Event:
        name, kind = self._axes[loss.axis]
        unit = ROTARY.get(loss.unit, loss.unit) if kind == "rotary" else loss.unit
        event = self._event(Kind.ACCURACY_LOST, loss.signature, record, loss.value, loss.limit)
        return event._replace(axis=name, measured=loss.measured, unit=unit, cause=loss.cause, action=loss.action)


def _measured(row: Row, value: float) -> str:
    """What the value is of; of a state or a grant, with the value or the word that it stands for."""
    if row.form is Form.THRESHOLD or math.isnan(value):
        return row.measured
    return row.measured.format(row.words[int(value)] if row.words else int(value))


class _Evidence(NamedTuple):
    fault: int
    axis: int
    value: float
    limit: float


def _evidence(record: np.void) -> list[_Evidence]:
    kept = min(int(record["n_evidence"]), MAX_EVIDENCE)
    found = []
    for place in range(kept):
        what = int(record["evidence_of"][place])
        axis = what >> 16
        measured = float(record["evidence_value"][place]), float(record["evidence_limit"][place])
        found.append(_Evidence(what & 0xFFFF, NO_AXIS if axis == EVERY_AXIS else axis, *measured))
    return found


def _changes(column: NDArray[Any], before: int) -> NDArray[np.bool_]:
    """Where a column differs from the tick before."""
    changed = np.empty(len(column), bool)
    changed[0] = int(column[0]) != before
    np.not_equal(column[1:], column[:-1], out=changed[1:])
    return changed


def stream_of(rig: dict[str, Any], period_ns: int, baseline: dict[str, Any] | None = None) -> EventStream:
    """The stream for a rig, and its baseline, as a run's description holds them (hil.rig.provenance.describe_run)."""
    axes = [(name, str(axis["kind"])) for name, axis in rig["axes"].items()]
    sensors = [(name, str(sensor["unit"])) for name, sensor in rig.get("sensors", {}).items()]
    known = [known_of(baseline["axes"].get(name, {})) for name, _ in axes] if baseline else []
    name = str(rig.get("name", ""))
    return EventStream(axes, period_ns, sensors, axis_models(rig["axes"]), known, name, guards_of(rig))
