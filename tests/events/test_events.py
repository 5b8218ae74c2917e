"""Events told from records: a latched fault whole, the same again in replay, and a storm that is counted."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.cli.exit_status import EXIT_FAULT
from hil.cycle.fault_table import ROWS, Fault
from hil.cycle.record import MAX_EVIDENCE, RECORD
from hil.cycle.state_machine import State
from hil.events.marks import marks_of
from hil.events.storm import TOLD
from hil.events.stream import EventStream
from hil.events.table import KINDS, Kind
from hil.telemetry.event_log import own_event
from hil.virtual.replay import replay_run
from tests.support.paths import RIGS, ROOT

SCENARIO = ROOT / "deploy" / "scenarios" / "bad-day.toml"


@pytest.mark.requirement(id="SR-9.1")
def test_every_kind_and_every_fault_has_its_text() -> None:
    assert KINDS.keys() == set(Kind)
    assert all(text.measured and text.cause and text.action for text in ROWS.values())


@pytest.mark.long
def test_a_run_that_ends_in_a_fault_says_which_axis_when_and_by_how_much_and_replay_says_the_same(
    tmp_path: Path,
) -> None:
    recording = tmp_path / "run.mcap"
    words = ["sim", str(RIGS / "microscope-ideal.toml"), "--seconds", "3.5", "--faults", str(SCENARIO)]
    done = CliRunner().invoke(
        build_app("sim"), [*words, "--record", str(recording), "--json", str(tmp_path / "r.json")]
    )
    assert done.exit_code == EXIT_FAULT
    told = "tick 3375 (3.375 s): fault latched: encoder_lost on z: age of the axis' sample 3 ticks, limit 3 ticks"
    assert told in done.output
    replayed = replay_run(recording)
    assert replayed.latched is not None
    assert replayed.latched.line.startswith(told)
    assert [event.line for event in replayed.events if event.kind is Kind.STATE][-1].endswith(
        "hil command microscope-ideal reset"
    )


def test_ticks_of_a_ring_that_states_no_period_are_told_too() -> None:
    records = np.zeros(3, RECORD)
    records["index"], records["state"], records["flags"] = range(3), [int(State.READY)] * 2 + [int(State.ACTIVE)], 8
    told = EventStream([("x", "linear")], 0).tell(records)
    assert [event.name for event in told if event.kind is Kind.STATE] == ["BOOT -> READY", "READY -> ACTIVE"]


def test_a_storm_is_bounded_and_loses_no_fault_uncounted() -> None:
    """Ten faults a tick that come and go, at 1 kHz: 10 000 a second, of which a record keeps eight."""
    ticks, flagged = 2000, 20
    records = np.zeros(ticks, RECORD)
    records["index"] = records["now_ns"] = records["scheduled_ns"] = np.arange(ticks)
    records["state"], records["flags"] = int(State.ACTIVE), 8
    records["n_evidence"][::2] = flagged  # every other tick, so that each is seen anew
    records["evidence_total"] = np.cumsum(records["n_evidence"], dtype=np.uint64)
    faults = list(Fault)[1 : MAX_EVIDENCE + 1]
    records["evidence_of"][::2] = [int(fault) for fault in faults]
    records["faults_active"][::2] = sum(1 << fault for fault in faults)
    stream = EventStream([("x", "linear")], 1_000_000)
    events = [event for part in np.array_split(records, 37) for event in stream.tell(part)] + stream.close()
    seen = [event for event in events if event.kind is Kind.FAULT_SEEN]
    assert sum(event.times for event in seen) == flagged * ticks // 2
    assert max(Counter((event.name, event.tick // 1000) for event in seen).values()) <= TOLD + 1


def test_a_picture_tells_latched_faults_and_lost_accuracy_in_words() -> None:
    kinds = (Kind.ACCURACY_LOST, Kind.FAULT_LATCHED, Kind.FAULT_SEEN, Kind.STATE)
    events = [own_event(kind, kind.name, 0)._replace(tick=number) for number, kind in enumerate(kinds)]
    marks = marks_of(events, np.arange(4))
    assert [mark.label for mark in marks if mark.worded] == ["ACCURACY_LOST", "FAULT_LATCHED"]
