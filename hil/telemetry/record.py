"""The fixed-size record of one tick: what the control process leaves in the ring, and all that replay needs.

Little-endian, SI units, 4096 bytes. Per-axis arrays have MAX_AXES places; those beyond the rig's axes are zero.
"""

import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from drivers.frame import Frame
from hil.config import MAX_AXES
from hil.tick import OperatorCommand

MAX_RECEIVED = 32
MAX_SENT = 6
MAX_COMMANDS = 4
REJECT_REASONS = 10  # drivers.protocols.base.Reject

_AXES = (MAX_AXES,)

FRAME = np.dtype(
    [
        ("timestamp_ns", "<i8"),
        ("can_id", "<u4"),
        ("length", "u1"),
        ("flags", "u1"),
        ("reserved", "<u2"),
        ("data", "u1", 64),
    ]
)  # 80 bytes
COMMAND = np.dtype([("kind", "<u4"), ("accepted", "<u4"), ("sequence", "<u8"), ("expires_ns", "<i8")])

_FIELDS = [
    # the tick
    ("index", "<i8"),
    ("scheduled_ns", "<i8"),
    ("now_ns", "<i8"),
    ("state", "<u4"),  # hil.state_machine.State
    ("fault", "<u4"),  # hil.faults.Fault that latched, 0: none
    ("faults_active", "<u8"),  # bit f set: detector f fires in this tick
    ("flags", "<u4"),  # bit 0 stop, 1 recorder_ok, 2 realtime_ok, 3 rig_ok, 4 sending
    ("sequence", "<u4"),
    ("task_ns", "<i8"),  # time on the task's clock; -1: no task runs
    # per axis
    ("position", "<f8", _AXES),  # measured, m
    ("position_estimate", "<f8", _AXES),
    ("velocity_estimate", "<f8", _AXES),
    ("disturbance_estimate", "<f8", _AXES),
    ("innovation", "<f8", _AXES),
    ("setpoint_position", "<f8", _AXES),  # at the sample's time stamp
    ("setpoint_velocity", "<f8", _AXES),
    ("following_error", "<f8", _AXES),  # position - setpoint_position, both at the sample's time stamp
    ("force_requested", "<f8", _AXES),  # by the law
    ("force", "<f8", _AXES),  # let out by the gate
    ("stamp_ns", "<i8", _AXES),
    ("age_ticks", "<u4", _AXES),  # since the last accepted sample
    ("drive_status", "<u4", _AXES),
    # counters, cumulative
    ("port", "<u8", (12,)),  # hil.tick.PortCounters, state last
    ("rejects", "<u8", (REJECT_REASONS,)),
    ("samples_lost", "<u8"),
    ("missed_own", "<u8"),
    ("missed_host", "<u8"),
    ("longest_streak", "<u8"),
    ("illegal_events", "<u8"),
    ("commands_refused", "<u8"),
    ("law_floors", "<u8"),  # denominators floored by the law
    ("saturations", "<u8", _AXES),  # ticks in which the gate clamped or rate-limited
    # of the previous tick, written by the shell: ns of CPU per stage, and of run delay
    ("cpu_ns", "<u4", (5,)),  # read, estimate, control, gate, send
    ("run_delay_ns", "<u4"),
    # everything replay needs
    ("n_commands", "<u2"),
    ("n_received", "<u2"),
    ("n_sent", "<u2"),
    ("reserved", "<u2"),
    ("commands", COMMAND, (MAX_COMMANDS,)),
    ("sent", FRAME, (MAX_SENT,)),
    ("received", FRAME, (MAX_RECEIVED,)),
]

_USED = np.dtype(_FIELDS).itemsize
RECORD_SIZE: Final = 4096
RECORD = np.dtype([*_FIELDS, ("padding", "u1", RECORD_SIZE - _USED)])

MOTION_FIELDS = (
    "position",
    "position_estimate",
    "velocity_estimate",
    "disturbance_estimate",
    "innovation",
    "setpoint_position",
    "setpoint_velocity",
    "following_error",
    "force_requested",
    "force",
)
_OFFSET = {name: int(offset[1]) for name, offset in (RECORD.fields or {}).items()}
_COUNTS_AT: Final = _OFFSET["n_commands"]
_COMMANDS_AT: Final = _OFFSET["commands"]
_SENT_AT: Final = _OFFSET["sent"]
_RECEIVED_AT: Final = _OFFSET["received"]
_FRAME = struct.Struct("<qIBB2x64s")
_pack_frame: Final = _FRAME.pack_into
_FRAME_SIZE: Final = _FRAME.size
_COMMAND: Final = struct.Struct("<IIQq")
_pack_counts: Final = struct.Struct("<3H2x").pack_into
_MAX_U32, _MAX_U64, _MAX_I64 = 2**32 - 1, 2**64 - 1, 2**63 - 1


class RecordBuilder:
    """One record, written over and over; packing beats a numpy field assignment four times over.

    state: takes everything from `index` to `saturations` in the record's order, one value per axis for the per-axis
    fields, and packs it in one call. Zeros stand for missed_own, missed_host and longest_streak, which the shell knows.
    """

    def __init__(self, n_axes: int) -> None:
        self.buffer = bytearray(RECORD_SIZE)
        self.record: np.void = np.frombuffer(self.buffer, dtype=RECORD)[0]
        rest = MAX_AXES - n_axes
        motion = f"{n_axes}d{8 * rest}x" * len(MOTION_FIELDS)
        ages = f"{n_axes}I{4 * rest}x"
        layout = f"<qqqIIQIIq{motion}{n_axes}q{8 * rest}x{ages}{ages}12Q{REJECT_REASONS}Q7Q{n_axes}Q"
        self.state: Callable[..., None] = partial(struct.Struct(layout).pack_into, self.buffer, 0)

    def traffic(
        self, commands: Sequence[tuple[OperatorCommand, bool]], sent: Sequence[Frame], received: Sequence[Frame]
    ) -> None:
        """All that went in and out of the tick."""
        buffer = self.buffer
        _pack_counts(buffer, _COUNTS_AT, len(commands), len(received), len(sent))
        offset = _COMMANDS_AT
        for command, accepted in commands:
            # Cut to the fields' widths: no sender's number, however absurd, may raise in the control process.
            expires_ns = min(max(command.expires_ns, -_MAX_I64 - 1), _MAX_I64)
            kind, sequence = command.kind & _MAX_U32, command.sequence & _MAX_U64
            _COMMAND.pack_into(buffer, offset, kind, accepted, sequence, expires_ns)
            offset += _COMMAND.size
        offset = _SENT_AT
        for can_id, data, flags, stamp in sent:
            _pack_frame(buffer, offset, stamp, can_id, len(data), flags, data)
            offset += _FRAME_SIZE
        offset = _RECEIVED_AT
        for can_id, data, flags, stamp in received:
            _pack_frame(buffer, offset, stamp, can_id, len(data), flags, data)
            offset += _FRAME_SIZE
