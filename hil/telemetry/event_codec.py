"""Events to protobuf messages and back."""

from hil.events.event import Event
from hil.events.table import Kind, Severity
from hil.telemetry import events_pb2 as pb

_TEXTS = ("name", "axis", "measured", "unit", "cause", "action")
_NUMBERS = ("tick", "time_ns", "run_ns", "value", "limit", "times")


def encode(event: Event, sequence: int, wall_offset_ns: int) -> pb.Event:
    """The event as message. wall_offset_ns: from the monotonic clock to UTC."""
    message = pb.Event(sequence=sequence, line=event.line)
    for name in ("kind", "severity", *_TEXTS, *_NUMBERS):
        setattr(message, name, getattr(event, name))
    message.wall_ns = event.time_ns + wall_offset_ns
    return message


def decode(message: pb.Event) -> Event:
    """The message as event, of whatever version; of an unknown kind or severity: SIDECAR, INFO."""
    known, levels = {kind.value: kind for kind in Kind}, {level.value: level for level in Severity}
    kind, severity = known.get(int(message.kind), Kind.SIDECAR), levels.get(int(message.severity), Severity.INFO)
    words = {name: getattr(message, name) for name in (*_TEXTS, *_NUMBERS)}
    return Event(kind, severity, **words)
