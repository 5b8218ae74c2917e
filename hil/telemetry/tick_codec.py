"""Ring records to Tick messages (tick_schema.py) and back to columns."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from hil.cycle.fault_table import Fault
from hil.cycle.record import MOTION_FIELDS
from hil.events.followed import FIELDS, followed
from hil.telemetry.tick_schema import LATENESS_STEP, NO_TASK_NS, TickSchema, field_of_axis

Records = NDArray[np.void]
PER_TICK = ("index", "scheduled_ns", "now_ns", "state", "fault", "faults_active", "task_ns", "motion")
PER_AXIS = (*MOTION_FIELDS, "age_ticks", "drive_status")
PER_SENSOR = ("readings", "reading_age")


class TickEncoder:
    """Makes the messages of one rig's ticks."""

    def __init__(self, schema: TickSchema) -> None:
        self.schema = schema
        self._fields = [field_of_axis(axis) for axis in schema.axes]
        steps = [[schema.scales[axis][name].step for axis in schema.axes] for name in MOTION_FIELDS]
        self._steps = np.array(steps)  # (fields, axes)
        self._steps_of_readings = np.array(schema.reading_steps)  # (sensors,)
        self._of_a_task = np.isin(MOTION_FIELDS, FIELDS)  # (fields,)

    def encode(self, records: Records, first: int) -> Iterator[bytes]:
        """The serialised messages, in order. first: ring index of the first record."""
        n = len(self._fields)
        motion = np.stack([records[name][:, :n] for name in MOTION_FIELDS], axis=1)
        motion[~followed(records)[:, None] & self._of_a_task] = np.nan
        rows = _rounded(motion, self._steps).transpose(0, 2, 1).tolist()
        lateness = _rounded((records["now_ns"] - records["scheduled_ns"]) * 1e-9, LATENESS_STEP).tolist()
        starts = np.where(records["task_ns"] == -1, NO_TASK_NS, records["scheduled_ns"] - records["task_ns"]).tolist()
        heads = zip(
            *(records[name].tolist() for name in ("index", "state", "fault", "faults_active", "motion")), strict=True
        )
        readings = _rounded(records["readings"][:, : len(self._steps_of_readings)], self._steps_of_readings).tolist()
        reading_ages = records["reading_age"].tolist()
        drives = zip(records["age_ticks"].tolist(), records["drive_status"].tolist(), strict=True)
        for place, ((index, state, fault, active, motion_word), (ages, status)) in enumerate(
            zip(heads, drives, strict=True)
        ):
            message: Any = self.schema.message(
                tick=index,
                sequence=first + place,
                state=state,
                fault=fault,
                task_start_ns=starts[place],
                lateness=lateness[place],
                motion=motion_word,
            )
            if active:
                message.faults_active.extend(int(one) for one in Fault if active >> one & 1)
            for axis, field in enumerate(self._fields):
                part = getattr(message, field)
                (
                    part.position,
                    part.position_estimate,
                    part.velocity_estimate,
                    part.disturbance_estimate,
                    part.innovation,
                    part.setpoint_position,
                    part.setpoint_velocity,
                    part.following_error,
                    part.force_requested,
                    part.force,
                ) = rows[place][axis]
                part.age_ticks = ages[axis]
                part.drive_status = status[axis]
            for channel, field in enumerate(self.schema.sensor_fields):
                part = getattr(message, field)
                part.value, part.age_ticks = readings[place][channel], reading_ages[place][channel]
            yield message.SerializeToString()


def _rounded(values: NDArray[np.float64], steps: Any) -> NDArray[np.float64]:
    """To the nearest multiple of a power of two; as it was where that is beyond a double."""
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = np.rint(values / steps) * steps
    return np.where(np.isfinite(rounded), rounded, values)


def columns(messages: Iterable[Message], times_ns: Iterable[int], schema: TickSchema) -> dict[str, NDArray[Any]]:
    """Ticks as arrays, (ticks,), (ticks, axes) or (ticks, sensors), by the names of the record's fields; of a rig
    without sensors without PER_SENSOR. times_ns: when each was due.
    """
    heads: list[tuple[int, ...]] = []
    motion: list[list[float]] = []
    drives: list[list[int]] = []
    readings: list[list[tuple[float, int]]] = []
    fields = [field_of_axis(axis) for axis in schema.axes]
    for message, due_ns in zip(messages, times_ns, strict=True):
        tick: Any = message
        active = sum(1 << fault for fault in tick.faults_active)
        heads.append(
            (
                tick.tick,
                due_ns,
                round(tick.lateness * 1e9),
                tick.state,
                tick.fault,
                active,
                tick.task_start_ns,
                tick.motion,
            )
        )
        parts = [getattr(tick, field) for field in fields]
        motion.append([getattr(part, name) for name in MOTION_FIELDS for part in parts])
        drives.append([getattr(part, name) for name in ("age_ticks", "drive_status") for part in parts])
        sensors = [getattr(tick, field) for field in schema.sensor_fields]
        readings.append([(sensor.value, sensor.age_ticks) for sensor in sensors])
    head = np.array(heads, np.int64).reshape(-1, 8)
    names = ("index", "scheduled_ns", "lateness_ns", "state", "fault", "faults_active", "task_start_ns", "motion")
    found: dict[str, NDArray[Any]] = {name: head[:, place] for place, name in enumerate(names)}
    due, start = found["scheduled_ns"], found.pop("task_start_ns")
    found["now_ns"] = due + found.pop("lateness_ns")
    found["task_ns"] = np.where(start == NO_TASK_NS, -1, due - start)
    values = np.array(motion).reshape(len(heads), len(MOTION_FIELDS), len(fields))
    found |= {name: values[:, place] for place, name in enumerate(MOTION_FIELDS)}
    pairs = np.array(drives, np.int64).reshape(len(heads), 2, len(fields))
    found |= {"age_ticks": pairs[:, 0], "drive_status": pairs[:, 1]}
    if not schema.sensor_fields:
        return found
    shown = np.array(readings, float).reshape(len(heads), len(schema.sensor_fields), 2)
    return found | {"readings": shown[:, :, 0], "reading_age": shown[:, :, 1].astype(np.int64)}
