"""The protobuf schema of a rig's ticks, for viewers: a message per tick, in it a field for every axis and every sensor,
by its name.

The message type hil.telemetry.Tick is made from the rig, so that any MCAP viewer shows `tick.x.position` without being
told what x is. What makes such messages small is that no value is finer than means something: each is rounded to a
multiple of a power of two (its step), which leaves most of its bits zero. To the last bit, every value follows from
what went into the cycle (cycle_codec.py), by running the cycle again.
"""

import json
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import Message

from drivers.protocols.base import STATUS_NAMES, DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from hil.cycle.record import MOTION_FIELDS
from hil.cycle.state_machine import State

PACKAGE: Final = "hil.telemetry"
TICK: Final = f"{PACKAGE}.Tick"
NO_TASK_NS: Final = -1
LATENESS_STEP: Final = 2.0**-20  # s, about a microsecond
_FIRST_AXIS, _FIRST_SENSOR = 16, 32  # field numbers
_FieldType = descriptor_pb2.FieldDescriptorProto


class Scale(NamedTuple):
    """Unit and step of one axis' quantity."""

    unit: str
    step: float


# Of the message, before the axes: name, number, type, unit and meaning.
TICK_FIELDS: Final = (
    ("tick", 1, "int64", "", "index of the control cycle's slot; more than 1 further: slots were skipped"),
    ("sequence", 2, "uint64", "", "0, 1, 2, ... of this control process; more than 1 further: messages were lost"),
    ("state", 3, "State", "", "of the state machine, after the tick"),
    ("fault", 4, "Fault", "", "that latched; NONE: none"),
    ("faults_active", 5, "Fault*", "", "those that fired in this tick"),
    ("task_start_ns", 6, "sfixed64", "ns", "when the task's clock was zero, monotonic; -1: no task runs"),
    ("lateness", 7, "double", "s", "when the tick woke, after it was due"),
    ("motion", 8, "MotionWord", "", "what the axes do under torque; NONE: they are not ours to move"),
)
# Of each axis, after the motion fields.
_AXIS_FIELDS: Final = (("age_ticks", 11, "uint32"), ("drive_status", 12, "uint32"))
_SENSOR_FIELDS: Final = (("value", 1, "double"), ("age_ticks", 2, "uint32"))
_VELOCITIES = ("velocity_estimate", "setpoint_velocity")
_DIFFERENCES = ("following_error", "innovation")
_FORCES = ("force", "force_requested", "disturbance_estimate")
_TYPES = {name: getattr(_FieldType, f"TYPE_{name.upper()}") for name in ("int64", "uint64", "uint32", "double")}
_TYPES["sfixed64"] = _FieldType.TYPE_SFIXED64


def scales(rig: dict[str, Any]) -> dict[str, dict[str, Scale]]:
    """Unit and step of every motion field, by axis and name. rig: a validated rig as JSON has it.

    Steps, or the power of two below: half a count of positions, a quarter of a count of their differences, an eighth of
    a count per period. Of forces it is a 4096th of the limit (drives that are bought take a thousandth of what they are
    rated).
    """
    found = {}
    for name, axis in rig["axes"].items():
        linear = axis.get("kind", "linear") == "linear"
        count = float(axis["encoder_resolution"])
        position = Scale("m" if linear else "rad", _power_of_two(count / 2))
        difference = Scale(position.unit, _power_of_two(count / 4))
        velocity = Scale(f"{position.unit}/s", _power_of_two(count * float(rig["rate_hz"]) / 8))
        force = Scale("N" if linear else "N m", _power_of_two(float(axis["limits"]["force"]) / 4096))
        found[name] = dict.fromkeys(MOTION_FIELDS, position) | dict.fromkeys(_DIFFERENCES, difference)
        found[name] |= dict.fromkeys(_VELOCITIES, velocity) | dict.fromkeys(_FORCES, force)
    return found


def _power_of_two(value: float) -> float:
    """The largest power of two that is not above a positive value."""
    return float(2.0 ** np.floor(np.log2(value)))


def field_of_axis(axis: str) -> str:
    """The axis' field: its name, unless the message has a field of that name already."""
    return f"axis_{axis}" if axis in {name for name, *_ in TICK_FIELDS} else axis


def _fields_of_sensors(axes: list[str], sensors: list[str]) -> list[str]:
    """Their fields: their names, with as many prefixes as it takes to differ from all others."""
    taken = {name for name, *_ in TICK_FIELDS} | {field_of_axis(axis) for axis in axes}
    found = []
    for sensor in sensors:
        field = sensor
        while field in taken:
            field = f"sensor_{field}"
        taken.add(field)
        found.append(field)
    return found


class TickSchema:
    """The type of a rig's Tick messages. rig: a validated rig as JSON has it, as in a recording's or ring's metadata.

    sensor_fields: of its sensors, in their order. reading_steps: of their values, as scales has them.
    files: the serialised FileDescriptorSet that a foreign reader needs. units: {"x.position": {"unit", "step"}, ...}.
    """

    def __init__(self, rig: dict[str, Any]) -> None:
        self.axes = list(rig["axes"])
        self.scales = scales(rig)
        sensors = rig.get("sensors", {})
        self.sensor_fields = _fields_of_sensors(self.axes, list(sensors))
        self.reading_steps = [_power_of_two(float(sensor["scale"]) / 2) for sensor in sensors.values()]
        file = _file(self.axes, self.sensor_fields)
        self.files = descriptor_pb2.FileDescriptorSet(file=[file])
        pool = descriptor_pool.DescriptorPool()
        pool.Add(file)
        self.message: type[Message] = message_factory.GetMessageClass(pool.FindMessageTypeByName(TICK))
        self.units = {name: unit for name, _, _, unit, _ in TICK_FIELDS if unit} | {
            f"{field_of_axis(axis)}.{name}": scale.unit
            for axis, row in self.scales.items()
            for name, scale in row.items()
        }
        values = [f"{field}.value" for field in self.sensor_fields]
        self.units |= zip(values, (str(sensor["unit"]) for sensor in sensors.values()), strict=True)
        self.steps = {"lateness": LATENESS_STEP} | {
            f"{field_of_axis(axis)}.{name}": scale.step
            for axis, row in self.scales.items()
            for name, scale in row.items()
        }
        self.steps |= zip(values, self.reading_steps, strict=True)

    @property
    def metadata(self) -> dict[str, str]:
        """For the channel: units, steps, and the bits of drive_status, each as JSON."""
        bits = dict(zip(STATUS_NAMES, map(int, DriveStatus), strict=True))
        return {"units": json.dumps(self.units), "steps": json.dumps(self.steps), "drive_status": json.dumps(bits)}


def _file(axes: list[str], sensors: list[str]) -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto(name="tick.proto", package=PACKAGE, syntax="proto3")
    _add_enum(file, State)
    _add_enum(file, Fault)
    _add_enum(file, MotionWord)
    axis = file.message_type.add(name="Axis")
    for number, name in enumerate(MOTION_FIELDS, 1):
        _add_field(axis, name, number, "double")
    for name, number, kind in _AXIS_FIELDS:
        _add_field(axis, name, number, kind)
    tick = file.message_type.add(name="Tick")
    for name, number, kind, _, _ in TICK_FIELDS:
        _add_field(tick, name, number, kind)
    for number, name in enumerate(axes, _FIRST_AXIS):
        _add_part(tick, field_of_axis(name), number, "Axis")
    if sensors:
        sensor = file.message_type.add(name="Sensor")
        for name, number, kind in _SENSOR_FIELDS:
            _add_field(sensor, name, number, kind)
    for number, name in enumerate(sensors, _FIRST_SENSOR):
        _add_part(tick, name, number, "Sensor")
    return file


def _add_part(tick: descriptor_pb2.DescriptorProto, name: str, number: int, kind: str) -> None:
    tick.field.add(
        name=name,
        number=number,
        label=_FieldType.LABEL_OPTIONAL,
        type=_FieldType.TYPE_MESSAGE,
        type_name=f".{PACKAGE}.{kind}",
    )


def _add_enum(file: descriptor_pb2.FileDescriptorProto, kind: type[IntEnum]) -> None:
    """An enum with its members' own names, in a message, as names are else one set for the whole package."""
    holder = file.message_type.add(name=f"{kind.__name__}s")
    enum = holder.enum_type.add(name=kind.__name__)
    for member in kind:
        enum.value.add(name=member.name, number=member.value)


def _add_field(message: descriptor_pb2.DescriptorProto, name: str, number: int, kind: str) -> None:
    label = _FieldType.LABEL_REPEATED if kind.endswith("*") else _FieldType.LABEL_OPTIONAL
    kind = kind.rstrip("*")
    field = message.field.add(name=name, number=number, label=label)
    if kind in _TYPES:
        field.type = _TYPES[kind]
    else:
        field.type = _FieldType.TYPE_ENUM
        field.type_name = f".{PACKAGE}.{kind}s.{kind}"
