"""Inputs and outputs of the control cycle, to the byte: ring records to Cycle messages (telemetry.proto) and back.

Columns of differences, as neighbouring ticks resemble each other: compressed, a tick of four axes takes about a
quarter of what the plain columns take. All arithmetic is modulo 2^64 or 2^32, so that any number survives.
"""

from collections.abc import Iterator
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from drivers.frame import Frame
from hil.cycle.goal import Goal
from hil.cycle.record import FRAME, MAX_RECEIVED
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import (
    LONGEST_BATCH,
    N_PORT,
    RecordedTick,
    counters,
    tick_of,
)

Records = NDArray[np.void]
Bytes = NDArray[np.uint8]

_CRC_BYTES = 4
_GOAL = ("number", "kind", "mask", "flags", "due_ns", "valid_ns", "position", "velocity", "speed", "lease", "refusal")
_DATA_BYTES: int = FRAME.fields["data"][0].shape[0]  # type: ignore[index]


def encode(records: Records, n_axes: int, *, first: int = 0, lost: int = 0) -> pb.Cycle:
    """Inputs and outputs of at least one tick. first: ring index. lost: ticks missing before them."""
    message = pb.Cycle(
        first=first,
        lost=lost,
        received=_encode_frames(records["received"], records["n_received"]),
        sent=_encode_frames(records["sent"], records["n_sent"]),
        counters=counters(records[-1], n_axes),
    )
    message.index.extend(_differences(records["index"]).tolist())
    message.scheduled_ns.extend(_differences(records["scheduled_ns"]).tolist())
    message.lateness_ns.extend((records["now_ns"] - records["scheduled_ns"]).tolist())
    message.port.extend(_differences(records["port"].astype(np.int64)).ravel().tolist())
    message.flags.extend(records["flags"].tolist())
    message.cpu_ns.extend(records["cpu_ns"].max(axis=0).tolist())
    message.run_delay_ns.extend(records["run_delay_ns"].tolist())
    for name in ("received", "sent", "command"):
        source = "n_commands" if name == "command" else f"n_{name}"
        getattr(message, f"{name}_count").extend(records[source].tolist())
    for place in np.flatnonzero(records["n_commands"]):
        for kind, accepted, sequence, expires_ns in records["commands"][place][: records["n_commands"][place]].tolist():
            message.commands.add(kind=kind, accepted=bool(accepted), sequence=sequence, expires_ns=expires_ns)
    message.goal_count.extend(records["n_goals"].tolist())
    for place in np.flatnonzero(records["n_goals"]):
        for goal in records["goals"][place][: records["n_goals"][place]]:
            message.goals.add(**{name: goal[name].tolist() for name in _GOAL})
    return message


def _taken_goal(goal: pb.TakenGoal) -> Goal:
    """Raises ValueError for one that no cycle can have been given."""
    if len(goal.position) != 4 or len(goal.velocity) != 4:
        raise ValueError("a goal without four positions and velocities")
    p, v = goal.position, goal.velocity
    return Goal(
        goal.number, goal.kind, goal.mask, goal.flags, goal.due_ns, goal.valid_ns,
        (p[0], p[1], p[2], p[3]), (v[0], v[1], v[2], v[3]), goal.speed, goal.lease,
    )  # fmt: skip


def _differences(values: NDArray[Any]) -> NDArray[Any]:
    """Each row less the one before, the first less 0; wraps."""
    return np.diff(values, axis=0, prepend=np.zeros_like(values[:1]))


def _sums(values: Any) -> NDArray[np.int64]:
    """The inverse of `_differences`."""
    return np.cumsum(np.array(values, np.int64), axis=0, dtype=np.int64)


def _encode_frames(slots: NDArray[np.void], counts: NDArray[np.uint16]) -> pb.FrameColumns:
    used = slots[np.arange(slots.shape[1]) < counts[:, None]]
    lengths = np.minimum(used["length"], _DATA_BYTES).astype(np.uint8)
    stamps = _differences(used["timestamp_ns"])
    unit = max(1, int(np.gcd.reduce(stamps)))  # ports stamp in whole microseconds, a segment in its bit times
    message = pb.FrameColumns(timestamp_ns=(stamps // unit).tolist(), timestamp_unit=unit)
    keys = used["can_id"].astype(np.uint64) << 16 | used["flags"].astype(np.uint64) << 8 | lengths
    found = keys.tolist()
    places = {key: place for place, key in enumerate(sorted(set(found)))}
    numbers = np.array([places[key] for key in found], np.int64)
    message.stream.extend(numbers.tolist())
    planes = []
    for key, number in places.items():
        can_id, length = key >> 16, key & 0xFF
        data: Bytes = used["data"][numbers == number][:, :length]
        checked = _all_end_in_crc(data, can_id)
        message.streams.add(can_id=can_id, flags=key >> 8 & 0xFF, length=length, crc32=checked)
        planes.append(_planes(data[:, :-_CRC_BYTES] if checked else data))
    message.data = b"".join(planes)
    return message


def _all_end_in_crc(data: Bytes, can_id: int) -> bool:
    """Whether every frame ends in the CRC-32 of what is before it, begun with its identifier (as stage_fd's)."""
    if data.shape[1] <= _CRC_BYTES:
        return False
    return all(
        crc32(row[:-_CRC_BYTES], can_id) == int.from_bytes(row[-_CRC_BYTES:], "little")
        for row in map(bytes, np.ascontiguousarray(data))
    )


def _parts(length: int) -> tuple[tuple[slice, Any], ...]:
    """How a frame's bytes are differenced: its 32-bit words, and the bytes beyond them."""
    whole = length // 4 * 4
    return ((slice(0, whole), np.dtype("<u4")), (slice(whole, length), np.dtype("u1")))


def _planes(data: Bytes) -> bytes:
    differences = np.empty_like(data, order="C")
    for place, kind in _parts(data.shape[1]):
        words = np.ascontiguousarray(data[:, place]).view(kind)
        differences[:, place] = np.ascontiguousarray(_differences(words)).view(np.uint8)
    return differences.T.tobytes()


def _from_planes(planes: bytes, length: int) -> Bytes:
    differences = np.frombuffer(planes, np.uint8).reshape(length, -1).T
    data = np.empty(differences.shape, np.uint8)
    for place, kind in _parts(length):
        words = np.ascontiguousarray(differences[:, place]).view(kind)
        data[:, place] = np.cumsum(words, axis=0, dtype=kind).view(np.uint8)
    return data


def recorded_ticks(message: pb.Cycle) -> Iterator[RecordedTick]:
    """The steps in a Cycle message, in order. Raises ValueError where no recorder can have written it."""
    ticks = len(message.index)
    columns = (message.scheduled_ns, message.lateness_ns, message.flags, message.received_count, message.sent_count)
    lengths = {ticks, *map(len, (*columns, message.command_count))}
    if len(lengths) > 1 or ticks > LONGEST_BATCH or len(message.port) != ticks * N_PORT:
        raise ValueError("its columns differ in length, or are too long")
    if sum(message.command_count) != len(message.commands):
        raise ValueError(f"{len(message.commands)} commands, {sum(message.command_count)} counted")
    goal_count = message.goal_count or [0] * ticks
    if len(goal_count) != ticks or sum(goal_count) != len(message.goals):
        raise ValueError(f"{len(message.goals)} goals, {sum(goal_count)} counted")
    goals = iter(message.goals)
    index, scheduled_ns = _sums(message.index), _sums(message.scheduled_ns)
    now_ns = (scheduled_ns + np.array(message.lateness_ns, np.int64)).tolist()
    ports = _sums(np.reshape(message.port, (-1, N_PORT))).view(np.uint64).tolist()
    received = _decode_frames(message.received, sum(message.received_count))
    sent, commands = _decode_frames(message.sent, sum(message.sent_count)), iter(message.commands)
    for place, (number, due_ns) in enumerate(zip(index.tolist(), scheduled_ns.tolist(), strict=True)):
        taken = [next(commands) for _ in range(message.command_count[place])]
        tick = tick_of((number, due_ns, now_ns[place]), ports[place], taken, message.flags[place])
        tick.goals = tuple(_taken_goal(next(goals)) for _ in range(goal_count[place]))
        inputs = [next(received) for _ in range(message.received_count[place])]
        outputs = [next(sent) for _ in range(message.sent_count[place])]
        yield RecordedTick(message.first + place, tick, inputs, outputs)


def _decode_frames(message: pb.FrameColumns, expected: int) -> Iterator[Frame]:
    """The frames in order. Raises ValueError where the columns do not agree."""
    numbers = np.array(message.stream, np.int64)
    if not len(numbers) == len(message.timestamp_ns) == expected or expected > LONGEST_BATCH * MAX_RECEIVED:
        raise ValueError(f"{len(numbers)} frames, {len(message.timestamp_ns)} times, {expected} counted")
    if expected and int(numbers.max()) >= len(message.streams):
        raise ValueError(f"frames of stream {int(numbers.max())}, where there are {len(message.streams)}")
    streams = [iter(rows) for rows in _streams_data(message, numbers)]
    heads = [(stream.can_id, stream.flags) for stream in message.streams]
    times = (_sums(message.timestamp_ns) * (message.timestamp_unit or 1)).tolist()
    return (
        Frame(heads[number][0], next(streams[number]), heads[number][1], stamp)
        for number, stamp in zip(numbers.tolist(), times, strict=True)
    )


def _streams_data(message: pb.FrameColumns, numbers: NDArray[np.int64]) -> list[list[bytes]]:
    """The data of each stream's frames."""
    counts = np.bincount(numbers, minlength=len(message.streams)).tolist()
    found: list[list[bytes]] = []
    start = 0
    for stream, count in zip(message.streams, counts, strict=True):
        left_out = _CRC_BYTES if stream.crc32 else 0
        length = stream.length - left_out
        if not 0 <= length <= _DATA_BYTES:
            raise ValueError(f"a frame of {stream.length} bytes")
        planes = message.data[start : start + count * length]
        start += len(planes)
        if len(planes) != count * length:
            raise ValueError("fewer bytes than its frames have")
        rows = [bytes(row) for row in _from_planes(planes, length)] if length and count else [b""] * count
        if stream.crc32:
            rows = [row + crc32(row, stream.can_id).to_bytes(_CRC_BYTES, "little") for row in rows]
        found.append(rows)
    return found
