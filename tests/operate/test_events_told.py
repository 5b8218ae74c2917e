"""An injected fault of every row of the fault table can be told from each of these alone: the journal's lines, `hil
events`, summary.json, the marks of tracking.png and its text, the recording in plain mcap and protobuf, and a Zenoh
subscriber that joined late. In lockstep, through a ring; a sample of it live: tests/telemetry/test_live_events.py.
"""

import json
import math
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest
import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.cli.pictures import tracking_picture
from hil.cycle.fault_table import ROWS, Fault, Form, Reaction
from hil.cycle.faults.row import OF_SENSOR
from hil.events.event import Event
from hil.events.sources import RingEvents
from hil.events.table import Kind
from hil.live.ring import RingReader, RingWriter
from hil.live.teller import print_events
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from hil.runs.summary import load_run, summarise
from hil.telemetry.event_log import EventLog
from hil.telemetry.events_pb2 import Events
from hil.telemetry.publisher import Publisher
from hil.telemetry.recorder import LockstepRecorder
from hil.telemetry.session import client_config
from hil.virtual.replay import replay_run
from hil.virtual.sim import simulate
from tests.support.every_fault import CAUSES, Cause
from tests.support.paths import MISBEHAVES, RIGS
from tests.telemetry.test_sidecar import free_endpoint


def test_every_row_of_the_fault_table_has_a_cause() -> None:
    assert {cause.fault for cause in CAUSES} == set(ROWS)


@pytest.fixture(scope="module")
def publisher() -> Iterator[Publisher]:
    with Publisher("hil", "paper", [free_endpoint()]) as publisher:
        yield publisher


@pytest.fixture(scope="module")
def late(publisher: Publisher) -> Iterator[zenoh.Session]:
    """A client of plain eclipse-zenoh."""
    with zenoh.open(client_config(publisher.listen[0])) as session:
        yield session


ALONE = "this axis does not answer, the others do"
SEEN_BEFORE = {  # what the ticks before say is told instead of what may be
    Fault.ENCODER_GAP: ALONE,
    Fault.ENCODER_LOST: ALONE,
    Fault.ENCODER_DEAD: ALONE,
    Fault.BAD_FRAMES: "answers came and were rejected (",
    Fault.ENCODER_STUCK: "encoder stuck: not one new count for 56 ticks",
}


class Told:
    """One run with a cause, recorded, and its records in a ring."""

    def __init__(self, cause: Cause, folder: Path) -> None:
        rig = cause.believed
        self.recording = folder / "run.mcap"
        self.ring = folder / "ring"
        recorder = LockstepRecorder(self.recording, rig, RIGS / "paper.toml")
        with RingWriter(self.ring, 4096, period_ns=rig.period_ns, metadata=describe_run(rig, RIGS)) as writer:

            def observe(tick: Any, frames: Sequence[Any], result: Any) -> None:
                recorder.observe(tick, frames, result)
                writer.append(result.record)

            cause.run(observe)
            with RingReader(self.ring) as reader:
                events = RingEvents(reader, folder / "notes")
                self.events: list[Event] = []
                while len((batch := reader.read(100)).records):
                    self.events += events.tell(batch)
                self.events += events.close()
        recorder.tell(self.events)
        recorder.close()


def expected(cause: Cause, events: Sequence[Event]) -> Event:
    """The event that all must tell; what it says of the fault is held against the table and the cause."""
    name = cause.fault.name.lower()
    seen = next(event for event in events if event.kind is Kind.FAULT_SEEN and event.name == name)
    text = ROWS[cause.fault]
    assert seen.axis == cause.axis
    assert cause.begin <= seen.tick < cause.begin + 120
    assert seen.run_ns == seen.tick * cause.believed.period_ns
    assert seen.unit == ("N" if text.unit == OF_SENSOR else text.unit)
    if (known := SEEN_BEFORE.get(cause.fault)) is None:
        assert seen.cause.split("; after ")[0] == text.cause
    else:
        assert seen.cause.startswith(known)
    action = text.action.replace("AXIS", cause.axis or "NAME").replace("sensors.NAME", f"sensors.{cause.axis}")
    assert known or seen.action == seen._replace(action=action).pasted(cause.believed.name).action
    assert not math.isnan(seen.value)
    if text.form is not Form.THRESHOLD:
        assert seen.measured in {text.measured.format(word) for word in text.words or (0x80,)}
        assert math.isnan(seen.limit)
        return seen
    assert seen.measured == text.measured
    assert not math.isnan(seen.limit)
    assert seen.value != seen.limit or seen.unit in ("ticks", "frames"), "what is measured is beyond the limit"
    return seen


def holds(found: dict[str, Any], event: Event) -> bool:
    """A document says the same. JSON has no infinity."""
    document = {key: math.nan if key in ("value", "limit") and found[key] is None else found[key] for key in found}
    document |= {key: float(document[key]) for key in ("value", "limit")}
    return document["kind"] == event.kind.name and same({**document, "kind": int(event.kind)}, event)


@pytest.mark.long
@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.fault.name)
def test_it_is_told_by_each_alone(
    cause: Cause, tmp_path: Path, capsys: pytest.CaptureFixture[str], publisher: Publisher, late: zenoh.Session
) -> None:
    told = Told(cause, tmp_path)
    event = expected(cause, told.events)
    if ROWS[cause.fault].reaction >= Reaction.STOP:
        assert any(found.kind is Kind.FAULT_LATCHED for found in told.events)

    print_events(told.events)
    journal = capsys.readouterr().err.splitlines()
    assert len(journal) == len(told.events)
    assert event.line in journal

    shown = CliRunner().invoke(build_app("events"), ["events", str(tmp_path)])
    assert shown.output.splitlines() == journal

    run = load_run(told.recording)
    summary = json.loads(json.dumps(summarise(run)))
    assert any(holds(found, event) for found in summary["events"])

    place = int((run.columns["index"] < event.tick).sum())
    assert (place, event.line, event.axis) in [(mark.place, mark.line, mark.axis) for mark in run.marks]
    assert event.line in by_plain_readers(told.recording, event)

    log = EventLog("paper", publisher)
    log.tell(told.events)
    assert event.line in [found["line"] for found in of_a_late_subscriber(publisher, late, log) if same(found, event)]

    if not cause.inside:
        replayed = replay_run(told.recording)
        assert replayed.different == 0
        assert [found.line for found in replayed.events if found.kind not in (Kind.DRIVE, Kind.LAW)] == journal


FIELDS = ("kind", "name", "tick", "axis", "value", "limit", "cause", "action", "line")


def same(found: dict[str, Any], event: Event) -> bool:
    """The plain fields of a message."""
    pairs = [(found[field], getattr(event, field)) for field in FIELDS]
    return all(one == other or (one != one and other != other) for one, other in pairs)  # NaN: a state has no limit


def by_plain_readers(path: Path, event: Event) -> list[str]:
    """Lines of the topic's messages that say the same, read with mcap and protobuf and the schema in the file."""
    found = []
    with path.open("rb") as file:
        reader = make_reader(file)
        for number, (schema, channel, message) in enumerate(reader.iter_messages(topics=["events"])):
            assert schema is not None
            pool = descriptor_pool.DescriptorPool()
            for part in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(part)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            decoded = kind.FromString(message.data)
            assert decoded.sequence == number
            names = kind.DESCRIPTOR.fields_by_name
            if same({field: getattr(decoded, field) for field in FIELDS}, event):
                assert names["kind"].enum_type.values_by_number[decoded.kind].name == event.kind.name
                found.append(decoded.line)
            assert channel.message_encoding == "protobuf"
    return found


def of_a_late_subscriber(publisher: Publisher, late: zenoh.Session, log: EventLog) -> list[dict[str, Any]]:
    """What one that joins now is told of what happened before."""
    ended = threading.Event()

    def serve() -> None:
        while not ended.wait(0.005):
            publisher.answer_queries({"events": log.history})

    server = threading.Thread(target=serve)
    server.start()
    try:
        replies = list(late.get("hil/*/events", timeout=10.0))
    finally:
        ended.set()
        server.join()
    messages = [Events.FromString(reply.ok.payload.to_bytes()) for reply in replies if reply.ok]
    return [{field: getattr(event, field) for field in FIELDS} for message in messages for event in message.events]


@pytest.mark.long
def test_the_picture_alone_tells_it(tmp_path: Path) -> None:
    """In words, and as text inside the file."""
    cause = next(cause for cause in CAUSES if cause.fault.name == "ENCODER_LOST")
    told = Told(cause, tmp_path)
    run = load_run(told.recording)
    tracking_picture(tmp_path / "tracking.png", run.rig, run, run.lateness, run.marks)
    data = (tmp_path / "tracking.png").read_bytes()
    latched = next(event for event in told.events if event.kind is Kind.FAULT_LATCHED)
    assert latched.line.encode() in data
    bare, marked = tmp_path / "bare.png", tmp_path / "marked.png"
    tracking_picture(bare, run.rig, run)
    tracking_picture(marked, run.rig, run, marks=run.marks)
    assert (
        matplotlib.image.imread(bare).shape != matplotlib.image.imread(marked).shape
        or (matplotlib.image.imread(bare) != matplotlib.image.imread(marked)).any()
    )


def test_what_a_users_law_did_wrong_is_an_event() -> None:
    rig = load_rig(RIGS / "paper.toml", [f"law.name={MISBEHAVES}:Misbehaves", "law.gains={how='raises', after=0.1}"])
    report, _ = simulate(rig, RIGS, 0.5)
    law = next(event for event in report.events if event.kind is Kind.LAW)
    assert "misbehaves.py:" in law.cause
    assert "ZeroDivisionError" in law.cause
    assert report.latched is not None
    assert (report.latched.name, report.latched.tick) == ("not_finite", law.tick)


def test_why_an_axis_got_no_task_is_an_event(tmp_path: Path) -> None:
    cause = next(cause for cause in CAUSES if cause.fault.name == "AXIS_NOT_AS_STATED")
    words = [event for event in replay_run(Told(cause, tmp_path).recording).events if event.kind is Kind.DRIVE]
    assert ["axis x: pushed by" in event.cause for event in words] == [True]
