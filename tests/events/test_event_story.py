"""One made-up bad day, told in whole: every kind of event with its tick, its numbers, its cause and what to do next."""

import json
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.bus.counters import BusState
from hil.cycle.fault_table import Fault
from hil.cycle.record import EVERY_AXIS, RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.events.event import Event
from hil.events.notes import Note
from hil.events.sources import event_of
from hil.events.storm import TOLD
from hil.events.stream import EventStream
from hil.events.table import REFUSED_ACTION, Kind, Severity

PERIOD = 1_000_000
AXES = [("x", "linear"), ("theta", "rotary")]
STOP, RIG_OK, ESTOP = 1, 8, 32


def quiet(count: int, first: int = 0) -> NDArray[np.void]:
    """Ticks in which nothing happens."""
    records = np.zeros(count, RECORD)
    records["index"] = first + np.arange(count)
    records["now_ns"] = records["scheduled_ns"] = 7 + PERIOD * records["index"]
    records["state"], records["flags"] = int(State.ACTIVE), RIG_OK
    return records


def told(records: NDArray[np.void]) -> list[Event]:
    """What these ticks tell after one in which nothing happened."""
    stream = EventStream(AXES, PERIOD)
    before = quiet(1, int(records["index"][0]) - 1)
    before["state"] = records["state"][0]
    stream.tell(before)
    return [*stream.tell(records), *stream.close()]


def test_a_line_says_when_from_the_first_tick_on_and_nothing_of_it_outside_of_the_loop() -> None:
    event = Event(Kind.STATE, Severity.INFO, "INIT", tick=0, time_ns=7)
    assert event.line == f"tick 0 (0.000 s): {event.text}; next: none"
    assert event._replace(tick=-1).line == f"{event.text}; next: none"
    whole = event._replace(tick=12, run_ns=12 * PERIOD, cause="a hand", action="look", axis="x", times=2)
    assert whole.line == f"tick 12 (0.012 s): {whole.text}; cause: a hand; next: look"
    assert whole.text == f"{event.text} on x (2 times)"


@pytest.mark.parametrize(("measured", "value", "limit", "unit", "words"), [
    ("speed", 0.25, 0.125, "m/s", ": speed 0.25 m/s, limit 0.125 m/s"),
    ("its limit switch is closed", 1.0, math.nan, "", ": its limit switch is closed"),
    ("ratio", math.nan, 3.0, "", ": ratio nan, limit 3"),
    ("force", math.inf, 5.0, "N", ": force inf N, limit 5 N"),
    ("speed", math.nan, math.nan, "m/s", ""),
    ("", 1.0, 2.0, "m", ""),
])  # fmt: skip
def test_what_was_measured_is_told_in_words_and_as_json_can_say_it(
    measured: str, value: float, limit: float, unit: str, words: str
) -> None:
    bare = Event(Kind.FAULT_SEEN, Severity.WARNING, "overspeed", tick=3, time_ns=7, axis="x")
    event = bare._replace(measured=measured, value=value, limit=limit, unit=unit)
    assert event.text == bare.text + words
    document = json.loads(json.dumps(event.document, allow_nan=False))
    numbers = [None if math.isnan(number) else number for number in (value, limit)]
    assert [document["value"], document["limit"]] == ["inf" if number == math.inf else number for number in numbers]
    assert (document["kind"], document["severity"], document["line"]) == ("FAULT_SEEN", "WARNING", event.line)
    assert {document[name] for name in ("name", "axis")} == {"overspeed", "x"}
    assert (document["tick"], document["time_ns"], document["run_ns"], document["times"]) == (3, 7, 0, 1)


def test_slots_that_were_skipped_are_counted_and_a_start_far_behind_its_deadline_is_measured() -> None:
    records = quiet(4, first=3)
    records["index"][2:] += 5
    records["now_ns"][1] += PERIOD // 2  # half a period is not late
    records["now_ns"][3] += PERIOD // 2 + 1
    lost, late = told(records)
    assert (lost.kind, lost.name, lost.tick, lost.value, lost.limit) == (Kind.TICKS_LOST, "slots", 10, 5.0, 0.0)
    assert (lost.run_ns, lost.time_ns) == (10 * PERIOD, 7 + 5 * PERIOD)
    assert (late.kind, late.name, late.tick) == (Kind.TICK_LATE, "deadline", 11)
    assert (late.value, late.limit) == (0.000500001, 0.0005)


def test_a_fault_is_seen_latched_and_cleared_by_a_reset_each_in_its_tick() -> None:
    records = quiet(6, first=20)
    number = int(Fault.FOLLOWING_ERROR)
    records["n_evidence"][1:3] = 1
    records["evidence_total"][1:] = [1, 2, 2, 2, 2]
    records["evidence_of"][1:3, 0] = number | 1 << 16
    records["evidence_value"][1:3, 0], records["evidence_limit"][1:3, 0] = 0.25, 0.125
    records["faults_active"][1:3] = 1 << number
    records["fault"][1:5] = number
    seen, latched, cleared = told(records)
    assert (seen.kind, seen.tick, seen.axis, seen.name) == (Kind.FAULT_SEEN, 21, "theta", "following_error")
    assert (seen.value, seen.limit, seen.unit) == (0.25, 0.125, "rad")
    assert (latched.kind, latched.tick, latched.axis) == (Kind.FAULT_LATCHED, 21, "theta")
    assert "axes.theta." in latched.action or "hil command" in latched.action
    assert "AXIS" not in latched.action
    assert (cleared.kind, cleared.tick, cleared.axis, cleared.name) == (Kind.FAULT_CLEARED, 25, "theta", seen.name)
    assert (cleared.cause, cleared.severity) == ("an operator's reset", Severity.NOTICE)
    assert (cleared.run_ns, cleared.time_ns) == (25 * PERIOD, 7 + 25 * PERIOD)


@pytest.mark.parametrize(
    ("fault", "when_seen", "when_latched"),
    [
        (Fault.FOLLOWING_ERROR, Severity.WARNING, Severity.ERROR),
        (Fault.INTERFACE_DOWN, Severity.WARNING, Severity.CRITICAL),  # after which nothing is sent any more
    ],
)
def test_a_fault_that_latches_is_worse_than_one_that_is_seen(
    fault: Fault, when_seen: Severity, when_latched: Severity
) -> None:
    records = quiet(3, first=20)
    records["n_evidence"][1:], records["evidence_total"][1:] = 1, [1, 2]
    records["evidence_of"][1:, 0], records["faults_active"][1:] = int(fault) | 1 << 16, 1 << int(fault)
    records["fault"][1:] = int(fault)
    assert [(event.name, event.severity) for event in told(records)] == [
        (fault.name.lower(), when_seen),
        (fault.name.lower(), when_latched),
    ]


def test_what_is_to_be_done_about_an_axis_names_it_and_of_none_leaves_a_place_for_the_name() -> None:
    records = quiet(2, first=20)
    number = int(Fault.SPEED_PLANNED)
    records["n_evidence"], records["evidence_total"] = 1, [1, 2]
    records["evidence_of"][:, 0] = [number | 0 << 16, number | EVERY_AXIS << 16]
    records["faults_active"] = 1 << number
    first, second = told(records)
    assert (first.axis, first.unit) == ("x", "m/s")
    assert "raise axes.x.limits.speed" in first.action
    assert (second.axis, second.unit) == ("", "m/s")
    assert "raise axes.NAME.limits.speed" in second.action


def test_a_fault_whose_evidence_found_no_room_is_told_without_numbers() -> None:
    records = quiet(1, first=20)
    records["faults_active"], records["evidence_total"] = 1 << int(Fault.FOLLOWING_ERROR), 3
    bare, more = told(records)
    assert (bare.name, bare.axis) == ("following_error", "")
    assert bare.value != bare.value  # not a number
    assert (more.kind, more.times, more.name) == (Kind.FAULT_SEEN, 3, "more in one tick than a record keeps")


def test_a_record_without_room_is_no_end_of_a_fault_that_was_seen_before() -> None:
    records, number = quiet(3, first=20), int(Fault.FOLLOWING_ERROR)
    records["faults_active"], records["n_evidence"] = 1 << number, [1, 0, 1]
    records["evidence_of"][:, 0], records["evidence_total"] = number | 1 << 16, [1, 3, 4]
    assert [(event.name, event.axis, event.tick) for event in told(records)] == [
        ("following_error", "theta", 20), ("more in one tick than a record keeps", "", 21),
    ]  # fmt: skip


def test_commands_say_whether_they_were_obeyed_and_if_not_why() -> None:
    records = quiet(1, first=20)
    kinds = [CommandKind.HEARTBEAT, CommandKind.STOP, CommandKind.RESET, CommandKind.HEARTBEAT]
    records["n_commands"] = len(kinds)
    records["commands"]["kind"][0] = kinds
    records["commands"]["accepted"][0] = [1, 1, 0, 0]
    records["commands"]["expires_ns"][0] = int(records["now_ns"][0]) - np.array([9, 9, 2 * PERIOD, 0])
    stop, reset, heartbeat = told(records)
    assert [event.name for event in (stop, reset, heartbeat)] == ["STOP accepted", "RESET refused", "HEARTBEAT refused"]
    assert (stop.cause, stop.severity, stop.action) == ("an operator's command", Severity.INFO, "none")
    assert (reset.cause, reset.severity) == ("it expired 2.0 ms before; the state is ACTIVE", Severity.WARNING)
    replayed = "replayed: its number 0 is not above 0, that of an earlier command"
    assert heartbeat.cause == f"{replayed}; the state is ACTIVE"
    assert heartbeat.action == reset.action == REFUSED_ACTION


def test_a_change_of_state_says_why() -> None:
    cases = [
        (State.BOOT, State.CONNECTED, {}, "the bus is up"),
        (State.CONNECTED, State.READY, {}, "every axis answers and is healthy"),
        (State.HOMING, State.STOPPING, {}, "the home position is reached"),
        (State.STOPPING, State.READY, {}, "at rest"),
        (State.STOPPING, State.SHUTDOWN, {}, "at rest, and the process is to end"),
        (State.ACTIVE, State.STOPPING, {"flags": RIG_OK | STOP}, "the process was told to end"),
        (State.ACTIVE, State.ESTOP, {"flags": RIG_OK | ESTOP}, "stop was pressed (hil estop)"),
        (State.ACTIVE, State.STOPPING, {"fault": int(Fault.OVERRUN)}, "fault overrun"),
        (State.READY, State.ACTIVE, {}, "it was so when the records begin"),
    ]
    for before, now, changes, cause in cases:
        records = quiet(2, first=20)
        records["state"] = [int(before), int(now)]
        for name, value in changes.items():
            records[name][1] = value
        event = next(event for event in told(records) if event.kind is Kind.STATE)
        assert (event.name, event.tick, event.cause) == (f"{before.name} -> {now.name}", 21, cause)
        assert event.line.startswith(f"tick 21 (0.021 s): state: {event.name}; cause: {cause}; next: ")
        assert event.severity is (Severity.WARNING if now is State.ESTOP else Severity.NOTICE)


def test_the_bus_and_the_rig_file_tell_how_they_changed_and_when_they_are_well_again() -> None:
    records = quiet(4, first=20)
    records["port"][1, -1] = int(BusState.BUS_OFF)
    records["flags"][2] = 0
    off, on, changed, again = told(records)
    assert (off.kind, off.name, off.tick) == (Kind.BUS, "ERROR_ACTIVE -> BUS_OFF", 21)
    assert off.text == "bus: ERROR_ACTIVE -> BUS_OFF"
    assert (on.name, on.severity, on.cause) == ("BUS_OFF -> ERROR_ACTIVE", Severity.NOTICE, "the controller recovered")
    assert off.severity.value < on.severity.value
    assert [(event.kind, event.name, event.tick) for event in (changed, again)] == [
        (Kind.RIG_FILE, "changed", 22),
        (Kind.RIG_FILE, "as it was read", 23),
    ]


def test_other_flags_of_a_tick_say_nothing_of_the_rig_file() -> None:
    records = quiet(9)
    records["flags"] |= np.uint32(1) << np.arange(9, dtype=np.uint32) & ~np.uint32(RIG_OK)
    assert [event for event in told(records) if event.kind is Kind.RIG_FILE] == []


def test_of_each_second_s_alike_events_three_are_told_and_one_more_counts_the_rest() -> None:
    assert TOLD == 3
    records = quiet(3000, first=1000)
    late = np.arange(100, 1000, 100)
    records["flags"][late] = 0  # and well again in the tick after: nine times
    records["flags"][2500] = 0
    events = [event for event in told(records) if event.name == "changed"]
    assert [(event.tick - 1000, event.times) for event in events] == [
        (100, 1), (200, 1), (300, 1), (900, 6), (2500, 1),
    ]  # fmt: skip


def test_records_that_were_lost_are_told_once_and_make_no_lost_ticks() -> None:
    stream = EventStream(AXES, PERIOD)
    records = quiet(2, first=500)
    stream.tell(quiet(1, first=10))
    (event,) = stream.tell(records, lost=489)
    assert (event.kind, event.name, event.tick, event.value, event.limit) == (
        Kind.RECORDS_LOST,
        "ring",
        500,
        489.0,
        0.0,
    )


def test_words_of_the_cycle_are_an_event_of_their_tick() -> None:
    refused = event_of(Note(Kind.DRIVE, "axis x: 6502h has no CST", 3, 77), PERIOD)
    assert (refused.kind, refused.name, refused.cause) == (Kind.DRIVE, "not ready", "axis x: 6502h has no CST")
    assert (refused.tick, refused.time_ns, refused.run_ns) == (3, 77, 3 * PERIOD)
    assert event_of(Note(Kind.LAW, "my_law.py:7: no", 5, 78), PERIOD).name == "failed"
    assert event_of(Note(Kind.LAW, "my_law.py:7: no", -1, 78), PERIOD).run_ns == 0


def test_what_a_busy_machine_has_in_every_second_is_told_once_in_it() -> None:
    records = quiet(1000, first=1000)
    for tick in (100, 300, 500, 700):
        records["index"][tick:] += 2
        records["now_ns"][tick + 50] += PERIOD
    events = told(records)
    kinds = (Kind.TICKS_LOST, Kind.TICK_LATE)
    found = {kind: [(event.tick - 1000, event.times) for event in events if event.kind is kind] for kind in kinds}
    assert found == {Kind.TICKS_LOST: [(102, 1), (708, 3)], Kind.TICK_LATE: [(152, 1), (758, 3)]}


@pytest.mark.parametrize("apart", [False, True], ids=["in one batch", "in two"])
def test_slots_skipped_right_after_the_first_tick_are_counted_and_those_before_it_are_none(apart: bool) -> None:
    records = quiet(2)
    records["index"][1] = 4
    stream = EventStream(AXES, PERIOD)
    events = [event for part in np.array_split(records, 1 + apart) for event in stream.tell(part)]
    assert [(e.tick, e.value) for e in events if e.kind is Kind.TICKS_LOST] == [(4, 3.0)]
    assert not [e for e in EventStream(AXES, PERIOD).tell(quiet(2, first=9)) if e.kind is Kind.TICKS_LOST]


@pytest.mark.parametrize("later", [0, 1, 2, 5])
def test_what_was_flagged_in_lost_records_is_told_with_the_first_one_behind_them(later: int) -> None:
    stream = EventStream(AXES, PERIOD)
    stream.tell(quiet(2))
    records = quiet(3, first=10)
    records["evidence_total"] = [2, 2, 2 + later]
    records["n_evidence"][2], records["evidence_of"][2] = later, int(Fault.FOLLOWING_ERROR)
    events = [event for event in stream.tell(records, lost=8) if event.name == "more in one tick than a record keeps"]
    assert [(event.tick, event.times) for event in events] == [(10, 2)]
