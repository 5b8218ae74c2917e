"""Statuses and events as the page gets them: JSON of texts that hil.telemetry.client has already made printable."""

import math
import re
from typing import Any

from hil.operate.monitor import drive_words
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.window import silent_axes

SAFE = ("reset", "stop")  # what the page's buttons may ask for


def event_words(event: pb_events.Event, rig: str) -> dict[str, Any]:
    """One event. value, limit: None where nothing was measured. rig: its name, for commands that can be pasted."""
    return {
        "number": event.sequence,
        "kind": pb_events.Event.Kind.Name(event.kind),
        "severity": pb_events.Event.Severity.Name(event.severity),
        "name": event.name,
        "axis": event.axis,
        "wall": event.wall_ns * 1e-9,
        "run": event.run_ns * 1e-9,
        "value": _number(event.value),
        "limit": _number(event.limit),
        "unit": event.unit,
        "measured": event.measured,
        "cause": event.cause,
        "action": re.sub(r"\b(hil [a-z]+) NAME\b", rf"\1 {rig}", event.action),
        "button": safe_command(event.action),
        "times": event.times,
        "line": event.line,
    }


def cell_words(cell: pb.Cell) -> dict[str, Any]:
    """One cell of a batch. phase: empty where it is over; verdict: empty where it is not. Lengths in m, forces in N."""
    return {
        "number": cell.number,
        "phase": cell.phase.replace("_", " "),
        "verdict": cell.verdict.replace("_", " "),
        "seconds": _number(cell.ended - cell.began),
        "force": _number(cell.pierced_force),
        "peak": _number(cell.peak_force),
        "depth": _number(cell.deposit),
    }


def safe_command(action: str) -> str:
    """The command among SAFE that a next step names, as `hil command RIG reset`; empty where it names none."""
    found = re.search(rf"hil command \S+ ({'|'.join(SAFE)})\b", action)
    return found[1] if found else ""


def status_words(status: pb.Status) -> dict[str, Any]:
    """What the page shows of a status beside the ring's numbers."""
    counts = status.counters
    return {
        "law": status.law,
        "realtime": status.realtime,
        "alive": status.control_alive,
        "faults": list(status.faults_active),
        "latched": event_words(status.latched, status.rig) if status.HasField("latched") else None,
        "problems": list(status.drive_problems),
        "tip": status.tip,
        "silent": silent_axes(status.axes, status.answer_age),
        "drives": [drive_words(bits).plain.strip() or "-" for bits in status.drive_status],
        "max_error": list(map(_number, status.max_error)),
        "late": [*map(_number, (status.lateness_p50, status.lateness_p99, status.lateness_max))],
        "missed": [counts.missed_own, counts.missed_host],
        "frames": [counts.sent, counts.received, counts.samples_lost, sum(counts.rejects), counts.refused],
        "recording": status.recording,
        "dropped": status.dropped,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
