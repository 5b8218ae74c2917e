"""Records of ticks for tests: kept for later, or with numbers of one's choice in them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.cycle.axes import MotionFilter, axis_inputs  # in the compiled build, those that a rig's cycle works with
from hil.cycle.record_builder import RecordBuilder
from hil.cycle.tick import PortCounters, Tick

Records = NDArray[np.void]


def kept(record: np.void) -> np.void:
    """A copy, by its bytes: 1 us. numpy's own copy goes through every field, and takes a sixth of a tick."""
    copy: np.void = np.frombuffer(bytearray(record.tobytes()), record.dtype)[0]
    return copy


def table(records: Sequence[np.void]) -> Records:
    """Records one after the other as an array, (n,)."""
    return np.frombuffer(bytearray().join(record.tobytes() for record in records), records[0].dtype)


def put_tick(builder: RecordBuilder, tick: Tick, state: int, *, task_ns: int = -1, faults_active: int = 0) -> None:
    """Begin a record; the sequence number is the tick's index."""
    builder.tick(tick, state, 0, faults_active, sending=False)
    builder.progress(tick.index, task_ns)


def put_axis(builder: RecordBuilder, axis: int, values: Sequence[float], stamp_ns: int = 0, changed: int = 0) -> None:
    """One axis' motion. values: measured position; the filter's position, velocity, disturbance and innovation; the
    setpoint's position and velocity; force asked for and applied.
    """
    inputs, motion = axis_inputs(), MotionFilter([0.0, 0.0, 0.0], 1.0)
    inputs.position, motion.position, motion.velocity, motion.disturbance, motion.innovation = values[:5]
    inputs.sample.position, inputs.sample.velocity = values[5:7]
    builder.axis(axis, inputs, motion, values[2], stamp_ns)
    builder.force(axis, values[7], values[8], changed)


def bare_tick(index: int, now_ns: int, *, scheduled_ns: int | None = None, flags: int = 0) -> Tick:
    """A tick without commands. flags: as in a record; bit 4, which says whether frames were sent, is not the tick's."""
    return Tick(
        index,
        now_ns if scheduled_ns is None else scheduled_ns,
        now_ns,
        PortCounters(),
        stop=bool(flags & 1),
        recorder_ok=bool(flags & 2),
        realtime_ok=bool(flags & 4),
        rig_ok=bool(flags & 8),
        estop=bool(flags & 32),
    )
