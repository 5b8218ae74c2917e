"""Events over Zenoh: a client that joins late has all of them, in order, once; and what it missed it asks for again."""

import time
from collections.abc import Callable

import pytest
import zenoh

from hil.events.table import Kind
from hil.telemetry import events_pb2 as pb
from hil.telemetry.event_feed import EventFeed
from hil.telemetry.event_log import KEPT, EventLog, own_event
from hil.telemetry.publisher import Publisher


def tell(log: EventLog, *names: str) -> None:
    log.tell(own_event(Kind.SIDECAR, name, time.monotonic_ns()) for name in names)


def gathered(feed: EventFeed, publisher: Publisher, log: EventLog, enough: Callable[[list[str]], bool]) -> list[str]:
    """Names in the order in which they came, until there are enough."""
    names: list[str] = []
    until = time.monotonic() + 20.0
    while not enough(names):
        assert time.monotonic() < until, names
        publisher.answer_queries({"events": log.history})
        names += [event.name for event in feed.take()]
        time.sleep(0.01)
    return names


def test_who_joins_late_has_what_was_before_and_what_comes(publisher: Publisher, session: zenoh.Session) -> None:
    log = EventLog("rig", publisher)
    tell(log, "a", "b")
    feed = EventFeed(session, "hil/rig/events")
    assert gathered(feed, publisher, log, lambda names: feed.answered) == ["a", "b"]
    tell(log, "c")
    assert gathered(feed, publisher, log, lambda names: bool(names)) == ["c"]


def test_a_message_that_was_lost_on_its_way_is_asked_for_again(
    publisher: Publisher, session: zenoh.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = EventLog("rig", publisher)
    tell(log, "a")
    feed = EventFeed(session, "hil/rig/events")
    assert gathered(feed, publisher, log, lambda names: feed.answered) == ["a"]
    with monkeypatch.context() as lost:
        lost.setattr(publisher, "put", lambda topic, data: True)
        tell(log, "b")
    tell(log, "c")
    assert sorted(gathered(feed, publisher, log, lambda names: len(names) == 2)) == ["b", "c"]


def test_the_latched_fault_is_kept_whatever_storm_follows_until_it_is_cleared(publisher: Publisher) -> None:
    log = EventLog("rig", publisher)
    log.tell([own_event(Kind.FAULT_LATCHED, "speed", 1)])
    tell(log, *map(str, range(KEPT + 1)))
    log.tell([own_event(Kind.FAULT_SEEN, "slots", 2), own_event(Kind.FAULT_CLEARED, "slots", 3)])
    assert log.latched is not None
    assert (log.latched.name, log.latched.line) == ("speed", own_event(Kind.FAULT_LATCHED, "speed", 1).line)
    log.tell([own_event(Kind.FAULT_CLEARED, "speed", 4)])
    assert log.latched is None


def test_what_is_kept_is_bounded_and_the_rest_counted(publisher: Publisher) -> None:
    log = EventLog("rig", publisher)
    tell(log, *map(str, range(KEPT + 7)))
    message = pb.Events.FromString(log.history())
    assert (len(message.events), message.dropped) == (KEPT, 7)
    assert [event.sequence for event in message.events] == list(range(7, KEPT + 7))


def test_what_a_busy_machine_has_in_every_second_pushes_nothing_else_out(
    publisher: Publisher, session: zenoh.Session
) -> None:
    log = EventLog("rig", publisher)
    tell(log, "a")
    log.tell(own_event(Kind.TICK_LATE, "deadline", at) for at in range(KEPT + 7))
    tell(log, "b")
    feed = EventFeed(session, "hil/rig/events")
    names = gathered(feed, publisher, log, lambda names: feed.answered)
    assert (names.count("a"), names.count("b"), names.count("deadline")) == (1, 1, KEPT)
    tell(log, "c")
    assert gathered(feed, publisher, log, lambda names: bool(names)) == ["c"]


def test_a_second_sidecar_is_not_taken_for_the_first(publisher: Publisher, session: zenoh.Session) -> None:
    feed = EventFeed(session, "hil/rig/events")
    first, second = EventLog("rig", publisher), EventLog("rig", publisher)
    tell(first, "a")
    assert gathered(feed, publisher, first, lambda names: feed.answered and bool(names)) == ["a"]
    tell(second, "b")
    assert gathered(feed, publisher, second, lambda names: bool(names)) == ["b"]


def test_garbage_and_bounds_of_numbers_do_no_harm(publisher: Publisher, session: zenoh.Session) -> None:
    feed = EventFeed(session, "hil/rig/events")
    log = EventLog("rig", publisher)
    far = pb.Events(sidecar=2**64 - 1, dropped=2**64 - 1, events=[pb.Event(sequence=2**64 - 1, kind=99)])
    for data in (b"\xff" * 50, far.SerializeToString(), pb.Events().SerializeToString()):
        publisher.put("events", data)
    tell(log, "a")
    assert "a" in gathered(feed, publisher, log, lambda names: "a" in names)


def test_a_storm_of_the_sidecars_own_is_bounded_and_counted(
    publisher: Publisher, capsys: pytest.CaptureFixture[str]
) -> None:
    log = EventLog("rig", publisher)
    second = 1_000_000_000
    for number in range(10_000):
        log.own(second + number, own_event(Kind.SIDECAR, "a", second + number))
    log.turn(2 * second)
    events = pb.Events.FromString(log.history()).events
    assert sum(event.times for event in events) == 10_000
    assert len(events) == len(capsys.readouterr().err.splitlines()) < 10
