"""What the page gets of statuses and events: JSON that a browser can read, and buttons for safe commands alone."""

import json
import math

import pytest

from hil.page.words import event_words, safe_command, status_words
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb


@pytest.mark.parametrize(
    ("action", "command"),
    [
        ("then hil command NAME reset", "reset"),
        ("look; then hil command microscope reset, twice", "reset"),
        ("hil command microscope stop", "stop"),
        ("hil command microscope activate", ""),
        ("hil command microscope shutdown", ""),
        ("hil doctor", ""),
        ("reset", ""),
    ],
)
def test_only_a_reset_or_a_stop_becomes_a_button(action: str, command: str) -> None:
    assert safe_command(action) == command


def test_what_was_not_measured_is_null_and_the_whole_is_json() -> None:
    event = pb_events.Event(
        kind=pb_events.Event.FAULT_LATCHED, severity=pb_events.Event.ERROR, value=math.nan, limit=3.0
    )
    status = pb.Status(max_error=[math.inf, 1.0], lateness_p50=math.nan, drive_status=[0], latched=event)
    words = status_words(status)
    assert json.loads(json.dumps(words, allow_nan=False)) == words
    assert words["max_error"] == [None, 1.0]
    assert (words["latched"]["value"], words["latched"]["limit"]) == (None, 3.0)
    assert words["latched"]["kind"] == "FAULT_LATCHED"
    assert status_words(pb.Status())["latched"] is None
    assert event_words(event, "paper")["button"] == ""


def test_a_next_step_names_the_rig_so_that_it_can_be_pasted() -> None:
    event = pb_events.Event(action="hil check, then hil command NAME reset; hil monitor NAME")
    assert event_words(event, "paper")["action"] == "hil check, then hil command paper reset; hil monitor paper"
