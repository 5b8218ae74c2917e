"""Recordings of the earlier layout (Telemetry, Traffic), and what it shares with today's (cycle_codec.py)."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.frame import Frame
from hil.cycle.record import FRAME, MAX_RECEIVED, MAX_SENT, MOTION_FIELDS, RECORD
from hil.cycle.tick import BusState, CommandKind, OperatorCommand, PortCounters, Tick
from hil.rig.schema import MAX_AXES
from hil.telemetry import telemetry_pb2 as pb

Records = NDArray[np.void]

PER_TICK = ("index", "scheduled_ns", "now_ns", "state", "fault", "faults_active", "task_ns", "run_delay_ns")
PER_AXIS = (*MOTION_FIELDS, "stamp_ns", "age_ticks", "drive_status")
_PORT = ("received", "sent", "refused", "overflow", "discarded", "bus_errors")  # the first of PortCounters
_COUNTERS = (
    "samples_lost",
    "missed_own",
    "missed_host",
    "longest_streak",
    "illegal_events",
    "commands_refused",
    "law_floors",
)
STOP, RECORDER_OK, REALTIME_OK, RIG_OK, ESTOP = 1, 2, 4, 8, 32  # bits of record flags
LONGEST_BATCH = 4096  # ticks in a message, several times what a sidecar drains in a round
_STAGES = RECORD.fields["cpu_ns"][0].shape[0]  # type: ignore[index]
N_PORT = len(PortCounters._fields)
_DATA_BYTES = FRAME.fields["data"][0].shape[0]  # type: ignore[index]


def telemetry(records: Records, n_axes: int, *, batch: int = 0, first: int = 0, lost: int = 0) -> pb.Telemetry:
    """All ticks of a batch (at least one) as columns."""
    message = pb.Telemetry(batch=batch, first=first, lost=lost, axes=n_axes, counters=counters(records[-1], n_axes))
    for name in PER_TICK:
        getattr(message, name).extend(records[name].tolist())
    for name in PER_AXIS:
        getattr(message, name).extend(records[name][:, :n_axes].ravel().tolist())
    message.cpu_ns.extend(records["cpu_ns"].ravel().tolist())
    return message


def counters(record: np.void, n_axes: int) -> pb.Counters:
    """The cumulative counters as one tick left them."""
    message = pb.Counters(bus_state=int(record["port"][-1]))
    for name, value in zip(_PORT, record["port"].tolist(), strict=False):
        setattr(message, name, value)
    for name in _COUNTERS:
        setattr(message, name, int(record[name]))
    message.saturations.extend(record["saturations"][:n_axes].tolist())
    message.rejects.extend(record["rejects"].tolist())
    return message


def traffic(records: Records, *, first: int = 0) -> pb.Traffic:
    """Inputs and outputs of the cycle, tick by tick."""
    message = pb.Traffic(
        first=first,
        received=_frames(records["received"], records["n_received"]),
        sent=_frames(records["sent"], records["n_sent"]),
    )
    for name in ("index", "scheduled_ns", "now_ns", "flags"):
        getattr(message, name).extend(records[name].tolist())
    message.port.extend(records["port"].ravel().tolist())
    message.received_count.extend(records["n_received"].tolist())
    message.sent_count.extend(records["n_sent"].tolist())
    message.command_count.extend(records["n_commands"].tolist())
    for place in np.flatnonzero(records["n_commands"]):
        for kind, accepted, sequence, expires_ns in records["commands"][place][: records["n_commands"][place]].tolist():
            message.commands.add(kind=kind, accepted=bool(accepted), sequence=sequence, expires_ns=expires_ns)
    return message


def _frames(slots: NDArray[np.void], counts: NDArray[np.uint16]) -> pb.Frames:
    used = slots[np.arange(slots.shape[1]) < counts[:, None]]
    lengths = np.minimum(used["length"], _DATA_BYTES)
    return pb.Frames(
        timestamp_ns=used["timestamp_ns"].tolist(),
        can_id=used["can_id"].tolist(),
        flags=used["flags"].tolist(),
        length=lengths.tolist(),
        data=used["data"][np.arange(_DATA_BYTES) < lengths[:, None]].tobytes(),
    )


def columns(message: pb.Telemetry) -> dict[str, NDArray[Any]]:
    """Telemetry as arrays: (ticks,) or (ticks, axes), by field name. Raises ValueError for one that cannot be."""
    ticks, axes = len(message.index), message.axes
    _refuse_too_many("ticks in a message", ticks, LONGEST_BATCH)
    _refuse_too_many("axes", axes, MAX_AXES)
    result = {name: _column(message, name, ticks) for name in PER_TICK}
    for name in PER_AXIS:
        result[name] = _column(message, name, ticks * axes).reshape(ticks, axes)
    result["cpu_ns"] = _column(message, "cpu_ns", ticks * _STAGES).reshape(ticks, _STAGES)
    return result


def _column(message: pb.Telemetry, name: str, size: int) -> NDArray[Any]:
    """Its values; zeros where an earlier version had no such column."""
    values = getattr(message, name)
    if len(values) not in (0, size):
        raise ValueError(f"{len(values)} values of {name}: expected {size}")
    array = np.array(values)
    return array if len(values) == size else np.zeros(size, array.dtype)


def _refuse_too_many(what: str, number: int, most: int) -> None:
    if number > most:
        raise ValueError(f"{number} {what}: at most {most}")


class RecordedTick(NamedTuple):
    """One step of the cycle as it was recorded. `ring`: index in the ring; a gap there means ticks that are missing."""

    ring: int
    tick: Tick
    received: list[Frame]
    sent: list[Frame]


def tick_of(times: tuple[int, int, int], port: Sequence[int], commands: Iterable[pb.Command], flags: int) -> Tick:
    """A step's tick as recorded. times: index, scheduled_ns, now_ns. port: its counters, the bus state last."""
    *counts, bus_state = port
    return Tick(
        *times,
        PortCounters._make((*counts, BusState(bus_state))),
        tuple(map(taken_command, commands)),
        stop=bool(flags & STOP),
        recorder_ok=bool(flags & RECORDER_OK),
        realtime_ok=bool(flags & REALTIME_OK),
        rig_ok=bool(flags & RIG_OK),
        estop=bool(flags & ESTOP),
    )


def recorded_ticks(message: pb.Traffic) -> Iterator[RecordedTick]:
    """The steps in a traffic message, in order. Raises ValueError for more than any recorder puts into one."""
    _refuse_too_many("ticks in a message", len(message.index), LONGEST_BATCH)
    _refuse_too_many("frames received in a tick", max(message.received_count, default=0), MAX_RECEIVED)
    _refuse_too_many("frames sent in a tick", max(message.sent_count, default=0), MAX_SENT)
    received, sent, commands = _take_frames(message.received), _take_frames(message.sent), iter(message.commands)
    for place in range(len(message.index)):
        tick = tick_of(
            (message.index[place], message.scheduled_ns[place], message.now_ns[place]),
            message.port[place * N_PORT : (place + 1) * N_PORT],
            [next(commands) for _ in range(message.command_count[place])],
            message.flags[place],
        )
        inputs = [next(received) for _ in range(message.received_count[place])]
        outputs = [next(sent) for _ in range(message.sent_count[place])]
        yield RecordedTick(message.first + place, tick, inputs, outputs)


def taken_command(command: pb.Command) -> OperatorCommand:
    """An operator's command as it was recorded."""
    return OperatorCommand(CommandKind(command.kind), command.sequence, command.expires_ns)


def _take_frames(frames: pb.Frames) -> Iterator[Frame]:
    start = 0
    data = frames.data
    columns: Sequence[Sequence[int]] = (frames.can_id, frames.length, frames.flags, frames.timestamp_ns)
    for can_id, length, flags, stamp in zip(*columns, strict=True):
        yield Frame(can_id, data[start : start + length], flags, stamp)
        start += length
