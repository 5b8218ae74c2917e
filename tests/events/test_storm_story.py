"""A thousand overruns after a latched fault: its story stays whole on every screen, and the storm is counted."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from hil.cycle.fault_table import Fault
from hil.cycle.record import EVERY_AXIS, RECORD
from hil.cycle.state_machine import State
from hil.events.event import Event
from hil.events.marks import marks_of
from hil.events.stream import EventStream
from hil.events.table import Kind
from hil.operate.monitor import EVENTS_KEPT, banner, view
from hil.page.words import status_words
from hil.telemetry import events_pb2, telemetry_pb2
from hil.telemetry.event_codec import encode

PERIOD, BEFORE, STORM = 1_000_000, 500, 1000
AXES = [("x", "linear"), ("z", "linear")]


def stormy() -> NDArray[np.void]:
    """SPEED latches on z in tick 500; every second tick from then on is an overrun, late, and behind a lost one."""
    records = np.zeros(BEFORE + 2 * STORM, RECORD)
    records["index"] = np.arange(len(records))
    records["state"][:BEFORE], records["state"][BEFORE:] = int(State.ACTIVE), int(State.FAULT)
    records["flags"] = 8
    records["fault"][BEFORE:] = int(Fault.SPEED)
    records["n_evidence"][BEFORE] = 1
    records["evidence_of"][BEFORE, 0] = int(Fault.SPEED) | 1 << 16
    records["evidence_value"][BEFORE, 0], records["evidence_limit"][BEFORE, 0] = 0.3, 0.25
    records["faults_active"][BEFORE] = np.uint64(1 << Fault.SPEED)
    late = np.arange(BEFORE + 1, len(records), 2)
    for place in late:
        records["index"][place:] += 1
    records["n_evidence"][late] = 1
    records["evidence_of"][late, 0] = int(Fault.OVERRUN) | EVERY_AXIS << 16
    records["evidence_value"][late, 0] = 1.0
    records["faults_active"][late] = np.uint64(1 << Fault.OVERRUN)
    records["evidence_total"] = np.cumsum(records["n_evidence"])
    records["scheduled_ns"] = PERIOD * records["index"]
    records["now_ns"] = records["scheduled_ns"]
    records["now_ns"][late] += PERIOD
    return records


@pytest.fixture(scope="module")
def told() -> tuple[EventStream, list[Event]]:
    stream, records = EventStream(AXES, PERIOD), stormy()
    events = [event for at in range(0, len(records), 64) for event in stream.tell(records[at : at + 64])]
    return stream, [*events, *stream.close()]


def test_the_latched_fault_keeps_axis_value_limit_cause_and_next_step(told: tuple[EventStream, list[Event]]) -> None:
    stream, events = told
    latched = [event for event in events if event.kind is Kind.FAULT_LATCHED]
    assert [(event.name, event.axis, event.tick) for event in latched] == [("speed", "z", BEFORE)]
    assert stream.latched == latched[0]
    for part in ("speed on z", "0.3 m/s, limit 0.25 m/s", "cause: the axis runs away", "next: ", "hil command"):
        assert part in latched[0].line


def test_the_storm_is_bounded_and_none_of_it_is_lost_count_of(told: tuple[EventStream, list[Event]]) -> None:
    overruns = [event for event in told[1] if event.name == "overrun"]
    assert sum(event.times for event in overruns) == STORM
    assert sum(event.times for event in told[1] if event.kind is Kind.TICKS_LOST) == STORM
    assert len(told[1]) < 40


def test_monitor_dashboard_and_picture_show_it_whole(told: tuple[EventStream, list[Event]]) -> None:
    stream, events = told
    messages = [encode(event, number, 0) for number, event in enumerate(events)]
    messages += [events_pb2.Event(kind=events_pb2.Event.TICKS_LOST, line="ticks lost")] * EVENTS_KEPT
    assert stream.latched is not None
    status = telemetry_pb2.Status(
        rig="r", axes=["x", "z"], units=["m", "m"], state="FAULT", fault="SPEED", position=[0, 0], setpoint=[0, 0],
        max_error=[0, 0], force=[0, 0], drive_status=[0, 0], period_ns=PERIOD, latched=encode(stream.latched, 0, 0),
    )  # fmt: skip
    kept = messages[-EVENTS_KEPT:]
    assert banner(status, kept).plain == stream.latched.line
    console = Console(width=80, height=24, record=True, file=io.StringIO())
    console.print(view(status, events=kept))
    shown = " ".join(console.export_text().replace("│", " ").split())
    assert stream.latched.line in shown
    assert "speed on z" in status_words(status)["latched"]["line"]
    marks = marks_of(events, stormy()["index"])
    assert [mark for mark in marks if "speed" in str(mark)]
