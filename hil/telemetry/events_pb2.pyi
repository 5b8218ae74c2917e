from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Event(_message.Message):
    __slots__ = ("sequence", "kind", "severity", "name", "tick", "time_ns", "wall_ns", "run_ns", "axis", "measured", "value", "limit", "unit", "cause", "action", "times", "line")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNKNOWN_KIND: _ClassVar[Event.Kind]
        STATE: _ClassVar[Event.Kind]
        FAULT_SEEN: _ClassVar[Event.Kind]
        FAULT_LATCHED: _ClassVar[Event.Kind]
        FAULT_CLEARED: _ClassVar[Event.Kind]
        COMMAND: _ClassVar[Event.Kind]
        TICKS_LOST: _ClassVar[Event.Kind]
        TICK_LATE: _ClassVar[Event.Kind]
        BUS: _ClassVar[Event.Kind]
        RIG_FILE: _ClassVar[Event.Kind]
        REQUEST: _ClassVar[Event.Kind]
        RECORDER: _ClassVar[Event.Kind]
        SIDECAR: _ClassVar[Event.Kind]
        RECORDS_LOST: _ClassVar[Event.Kind]
        DRIVE: _ClassVar[Event.Kind]
        LAW: _ClassVar[Event.Kind]
        ACCURACY_LOST: _ClassVar[Event.Kind]
        TIP: _ClassVar[Event.Kind]
    UNKNOWN_KIND: Event.Kind
    STATE: Event.Kind
    FAULT_SEEN: Event.Kind
    FAULT_LATCHED: Event.Kind
    FAULT_CLEARED: Event.Kind
    COMMAND: Event.Kind
    TICKS_LOST: Event.Kind
    TICK_LATE: Event.Kind
    BUS: Event.Kind
    RIG_FILE: Event.Kind
    REQUEST: Event.Kind
    RECORDER: Event.Kind
    SIDECAR: Event.Kind
    RECORDS_LOST: Event.Kind
    DRIVE: Event.Kind
    LAW: Event.Kind
    ACCURACY_LOST: Event.Kind
    TIP: Event.Kind
    class Severity(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNKNOWN_SEVERITY: _ClassVar[Event.Severity]
        CRITICAL: _ClassVar[Event.Severity]
        ERROR: _ClassVar[Event.Severity]
        WARNING: _ClassVar[Event.Severity]
        NOTICE: _ClassVar[Event.Severity]
        INFO: _ClassVar[Event.Severity]
    UNKNOWN_SEVERITY: Event.Severity
    CRITICAL: Event.Severity
    ERROR: Event.Severity
    WARNING: Event.Severity
    NOTICE: Event.Severity
    INFO: Event.Severity
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    WALL_NS_FIELD_NUMBER: _ClassVar[int]
    RUN_NS_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    MEASURED_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    ACTION_FIELD_NUMBER: _ClassVar[int]
    TIMES_FIELD_NUMBER: _ClassVar[int]
    LINE_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    kind: Event.Kind
    severity: Event.Severity
    name: str
    tick: int
    time_ns: int
    wall_ns: int
    run_ns: int
    axis: str
    measured: str
    value: float
    limit: float
    unit: str
    cause: str
    action: str
    times: int
    line: str
    def __init__(self, sequence: _Optional[int] = ..., kind: _Optional[_Union[Event.Kind, str]] = ..., severity: _Optional[_Union[Event.Severity, str]] = ..., name: _Optional[str] = ..., tick: _Optional[int] = ..., time_ns: _Optional[int] = ..., wall_ns: _Optional[int] = ..., run_ns: _Optional[int] = ..., axis: _Optional[str] = ..., measured: _Optional[str] = ..., value: _Optional[float] = ..., limit: _Optional[float] = ..., unit: _Optional[str] = ..., cause: _Optional[str] = ..., action: _Optional[str] = ..., times: _Optional[int] = ..., line: _Optional[str] = ...) -> None: ...

class Events(_message.Message):
    __slots__ = ("rig", "sidecar", "dropped", "events")
    RIG_FIELD_NUMBER: _ClassVar[int]
    SIDECAR_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    rig: str
    sidecar: int
    dropped: int
    events: _containers.RepeatedCompositeFieldContainer[Event]
    def __init__(self, rig: _Optional[str] = ..., sidecar: _Optional[int] = ..., dropped: _Optional[int] = ..., events: _Optional[_Iterable[_Union[Event, _Mapping]]] = ...) -> None: ...
