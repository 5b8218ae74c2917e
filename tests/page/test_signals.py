"""What the page draws of a record, and how it travels: nothing untrue, nothing left out."""

import numpy as np
import pytest

from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.page.frames import HEADER, Block, Fate, Message, Pulse, envelope, pulse_message, ticks
from hil.page.server import STATIC
from hil.page.signals import OF_THE_LOOP, rows, signals_of
from tests.page.conftest import RIG
from tests.support.cells import equipped

DESCRIBED = RIG.model_dump(mode="json")
PULSE = Pulse(int(State.ACTIVE), 0, 1, 0.002, Fate.ALIVE, 0.1)


def test_every_signal_has_its_unit_and_its_limits() -> None:
    signals = signals_of(DESCRIBED)
    error = next(signal for signal in signals if signal.quantity == "error" and signal.axis == "x")
    limits = RIG.axes["x"].limits
    assert (error.unit, error.low, error.high) == ("m", -limits.following_error, limits.following_error)
    force = next(signal for signal in signals if signal.quantity == "force" and signal.axis == "y")
    assert (force.unit, force.high) == ("N", RIG.axes["y"].limits.force)
    position = next(signal for signal in signals if signal.quantity == "position")
    assert (position.low, position.high) == tuple(limits.position)
    assert [signal.quantity for signal in signals[-3:]] == list(OF_THE_LOOP)
    assert len(signals) == 8 * len(RIG.axes) + 3


def test_rows_are_in_the_order_of_the_signals() -> None:
    records = np.zeros(3, RECORD)
    records["state"], records["task_ns"] = State.ACTIVE, 0
    records["force"][:, 1] = [1.0, 2.0, 3.0]
    records["scheduled_ns"], records["now_ns"] = 1000, [1500, 1000, 4000]
    records["cpu_ns"] = 200
    values = dict(zip(signals_of(DESCRIBED), rows(records, len(RIG.axes)), strict=True))
    named = {(signal.quantity, signal.axis): row.tolist() for signal, row in values.items()}
    assert named["force", "y"] == [1.0, 2.0, 3.0]
    assert named["force", "x"] == [0.0, 0.0, 0.0]
    assert named["lateness", ""] == pytest.approx([5e-7, 0.0, 3e-6])
    assert named["CPU time", ""] == pytest.approx([1e-6] * 3)


def test_the_readings_of_sensors_are_signals_behind_those_of_the_axes() -> None:
    rig = equipped(1).model_dump(mode="json")
    records = np.zeros(2, RECORD)
    records["readings"][:, 0], records["readings"][:, 2] = [np.nan, 4e-4], [1.0, 2.0]
    signals = signals_of(rig)
    values = dict(zip(signals, rows(records, len(rig["axes"]), len(rig["sensors"])), strict=True))
    named = {(signal.axis, signal.unit): row.tolist() for signal, row in values.items() if signal.quantity == "reading"}
    assert list(named) == [("force", "N"), ("shift", "m"), ("tip", "m"), ("bolus", "1")]
    assert np.isnan(named["force", "N"][0])
    assert (named["force", "N"][1], named["tip", "m"]) == (4e-4, [1.0, 2.0])
    assert [signal.quantity for signal in signals[-3:]] == list(OF_THE_LOOP)


@pytest.mark.parametrize("state", [State.READY, State.FAULT, State.STOPPING, State.ESTOP])
def test_where_nothing_is_followed_there_is_no_setpoint_and_no_error(state: State) -> None:
    records = np.zeros(2, RECORD)
    records["state"], records["task_ns"] = [State.ACTIVE, state], 0
    records["following_error"] = 3e-3
    values = dict(zip(signals_of(DESCRIBED), rows(records, len(RIG.axes)), strict=True))
    for signal, row in values.items():
        absent = signal.quantity in ("setpoint", "error")
        assert np.isnan(row).tolist() == [False, absent], signal
    errors = [row[0] for signal, row in values.items() if signal.quantity == "error"]
    assert errors == [3e-3, 3e-3]


def test_an_envelope_has_the_newest_least_and_largest_of_all_ticks() -> None:
    values = np.array([[1.0, -5.0, 2.0], [np.nan, 7.0, np.nan], [np.nan] * 3])
    read = np.frombuffer(envelope(PULSE, Block(np.array([0.5, 0.501, 0.502]), values, 4)), "<f8")
    assert read[:HEADER].tolist() == [Message.ENVELOPE, 3, 0.5, 0.502, 3, 4, *PULSE]
    newest, least, largest = read[HEADER:].reshape(3, 3)
    assert (newest[0], least[0], largest[0]) == (2.0, -5.0, 2.0)
    assert (least[1], largest[1]) == (7.0, 7.0)
    assert np.isnan(newest[1:]).all()
    assert np.isnan([least[2], largest[2]]).all()


def test_chosen_ticks_come_with_their_instants_and_a_pulse_without_any() -> None:
    block = Block(np.array([1.0, 2.0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), 0)
    read = np.frombuffer(ticks(PULSE, block, (2, 0)), "<f8")
    assert read[HEADER:].tolist() == [2, 0, 1.0, 2.0, 5.0, 6.0, 1.0, 2.0]
    assert read[1] == 2
    bare = np.frombuffer(pulse_message(PULSE), "<f8")
    assert bare.tolist() == pytest.approx([Message.PULSE, 0, np.nan, np.nan, 0, 0, *PULSE], nan_ok=True)
    assert len(bare) == HEADER


def test_the_browser_reads_the_numbers_that_are_sent() -> None:
    script = (STATIC / "feed.js").read_text()
    assert f"const HEADER = {HEADER};" in script
    assert 'const FATES = ["is not running", "", "ended", "was killed"];' in script
    assert [(fate.name, int(fate)) for fate in Fate] == [("NONE", 0), ("ALIVE", 1), ("ENDED", 2), ("KILLED", 3)]
    assert (Message.PULSE, Message.ENVELOPE, Message.TICKS) == (0, 1, 2)
    order = "[kind, signals, first, last, ticks, lost, state, fault, motion, tickAge, fate, wordAge] = numbers"
    assert order in script
