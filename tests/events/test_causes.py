"""Why a fault came, of a whole kind each: answers that came and were rejected, a bus that is cut, a stuck encoder."""

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.protocols.base import Reject
from hil.cycle.fault_table import ROWS, Fault
from hil.cycle.record import EVERY_AXIS, RECORD
from hil.cycle.state_machine import State
from hil.events.axis_model import AxisModel
from hil.events.event import Event
from hil.events.stream import EventStream
from hil.events.table import Kind

PERIOD, TICKS, LATCHED_AT = 1_000_000, 400, 202
AXES = [("x", "linear"), ("y", "linear"), ("theta", "rotary")]
SUSPECT = {
    Reject.STALE: "sequence", Reject.DUPLICATE: "sequence", Reject.BAD_CHECKSUM: "checksum",
    Reject.WRONG_LENGTH: "length", Reject.WRONG_FORMAT: "format", Reject.INVALID_VALUE: "range",
}  # fmt: skip


def silent(axes: list[int], reason: Reject | None = None, skipped: int = 0) -> NDArray[np.void]:
    """Axes that do not answer from tick 200 on; ENCODER_LOST latches in the third tick, BAD_FRAMES is seen in the
    fifth where their answers were rejected."""
    records = np.zeros(TICKS, RECORD)
    records["index"] = np.arange(TICKS)
    records["index"][198:] += skipped
    records["now_ns"] = records["scheduled_ns"] = PERIOD * records["index"]
    records["state"], records["flags"] = int(State.ACTIVE), 8
    total = 0
    for tick in range(200, 206):
        age = tick - 199
        found = [(Fault.ENCODER_GAP, axis, age, 0) for axis in axes]
        found += [(Fault.ENCODER_LOST, axis, age, 3) for axis in axes if age >= 3]
        if reason is not None:
            records["rejects"][tick:, reason] += len(axes)
            found += [(Fault.BAD_FRAMES, EVERY_AXIS, age * len(axes), 5)] if age >= 5 else []
        records["age_ticks"][tick, axes] = age
        for place, (fault, axis, value, limit) in enumerate(found[:8]):
            records["evidence_of"][tick, place] = int(fault) | axis << 16
            records["evidence_value"][tick, place], records["evidence_limit"][tick, place] = value, limit
            records["faults_active"][tick] |= np.uint64(1 << fault)
        records["n_evidence"][tick] = len(found)
        total += len(found)
        records["evidence_total"][tick:] = total
    records["fault"][LATCHED_AT:] = int(Fault.ENCODER_LOST)
    return records


MODEL = AxisModel(resolution=5e-9, mass=0.9, dry=0.6, wet=3.0, gravity=0.0)


def told(records: NDArray[np.void], chunk: int = TICKS, gravity: float = 0.0) -> list[Event]:
    stream = EventStream(AXES, PERIOD, models=[MODEL._replace(gravity=gravity)] * len(AXES))
    found = [event for at in range(0, TICKS, chunk) for event in stream.tell(records[at : at + chunk])]
    return [*found, *stream.close()]


def one(events: list[Event], kind: Kind, name: str) -> Event:
    [found] = [event for event in events if event.kind is kind and event.name == name]
    return found


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("reason", "word"), SUSPECT.items())
def test_rejected_answers_are_told_by_axis_and_reason_and_not_as_silence(reason: Reject, word: str, axis: int) -> None:
    events = told(silent([axis], reason))
    name = AXES[axis][0]
    for kind, fault in ((Kind.FAULT_LATCHED, "encoder_lost"), (Kind.FAULT_SEEN, "bad_frames")):
        event = one(events, kind, fault)
        assert event.axis == name
        assert word in event.cause
        assert "no answer came" not in event.line
        assert f" on {name}" in event.line


def test_a_silent_axis_is_a_drive_or_its_cable_beside_which_the_others_answer() -> None:
    latched = one(told(silent([1])), Kind.FAULT_LATCHED, "encoder_lost")
    assert latched.axis == "y"
    assert latched.cause.startswith("this axis does not answer, the others do: its drive is off or its cable is loose")


def test_all_axes_in_one_tick_are_one_happening_of_the_bus_or_of_this_computer() -> None:
    cut = told(silent([0, 1, 2]))
    for event in (one(cut, Kind.FAULT_SEEN, "encoder_gap"), one(cut, Kind.FAULT_LATCHED, "encoder_lost")):
        assert event.axis == ""
        assert ("the bus is cut" if event.kind is Kind.FAULT_LATCHED else "answered in time") in event.cause
    busy = one(told(silent([0, 1, 2], skipped=4)), Kind.FAULT_LATCHED, "encoder_lost")
    assert "this computer was too busy: it skipped 4 ticks" in busy.cause
    rejected = one(told(silent([0, 1, 2], Reject.BAD_CHECKSUM)), Kind.FAULT_LATCHED, "encoder_lost")
    assert "of all axes" in rejected.cause
    assert "checksum" in rejected.cause


def test_what_was_first_is_told_with_what_followed() -> None:
    events = told(silent([1], Reject.STALE))
    assert "after encoder_gap on y at tick 200" in one(events, Kind.FAULT_LATCHED, "encoder_lost").cause
    assert "after encoder_lost on y at tick 202" in one(events, Kind.FAULT_SEEN, "bad_frames").cause
    assert "; after " not in one(events, Kind.FAULT_SEEN, "encoder_gap").cause


@pytest.mark.parametrize("chunk", [1, 7, 64, 201, 202, 203])
def test_the_story_does_not_depend_on_how_the_ticks_come(chunk: int) -> None:
    records = silent([2], Reject.BAD_CHECKSUM, skipped=2)
    assert told(records, chunk) == told(records)


def following_error(noise: int) -> NDArray[np.void]:
    records = silent([])
    records["setpoint_position"][:, 1] = np.arange(TICKS) * 1e-6
    records["position"][:, 1] = np.arange(TICKS) * 1e-6
    records["position"][150:, 1] = 150e-6 + noise * 1e-9 * (np.arange(TICKS - 150) % 3)
    records["following_error"] = records["position"] - records["setpoint_position"]
    number = int(Fault.FOLLOWING_ERROR)
    records["evidence_of"][LATCHED_AT, 0] = number | 1 << 16
    records["n_evidence"][LATCHED_AT] = 1
    records["evidence_total"][LATCHED_AT:] = 1
    records["faults_active"][LATCHED_AT] = np.uint64(1 << number)
    records["fault"][LATCHED_AT:] = number
    return records


def test_one_count_for_ever_is_a_stuck_encoder_and_an_axis_that_trembles_is_blocked() -> None:
    stuck = one(told(following_error(0)), Kind.FAULT_LATCHED, "following_error")
    assert stuck.cause.startswith("encoder stuck")
    assert "53 ticks" in stuck.cause
    blocked = one(told(following_error(1)), Kind.FAULT_LATCHED, "following_error")
    assert blocked.cause == ROWS[Fault.FOLLOWING_ERROR].cause


def leaving(way: NDArray[np.float64], force: float) -> Event:
    """The latched error of an axis at rest that has gone `way`, (ticks,), m, in the ticks up to it."""
    records = following_error(0)
    records["setpoint_position"][:, 1], records["force"][:, 1] = 0.0, force
    records["position"][:, 1] = 0.0
    records["position"][LATCHED_AT + 1 - len(way) : LATCHED_AT + 1, 1] = way
    records["following_error"] = records["position"] - records["setpoint_position"]
    return one(told(records), Kind.FAULT_LATCHED, "following_error")


def test_an_axis_that_gains_speed_against_its_force_was_pushed() -> None:
    seconds = np.arange(12) * 1e-3
    pushed = leaving(0.5 * 4.0 * seconds**2, force=-2.0)  # 0.9 kg * 4 m/s^2, 2 N against it, viscous friction
    assert pushed.cause.startswith("the axis was pushed or pulled: about 5.7 N (N m) upwards")
    assert leaving(0.5 * 2.0 * seconds**2, force=1.8).cause == ROWS[Fault.FOLLOWING_ERROR].cause, "its own force did"


def test_a_force_that_does_the_opposite_of_what_is_asked_for_is_no_push() -> None:
    ticks = np.arange(16)
    growing = 5.0 * np.exp(0.2 * (ticks - 15))  # N
    records = following_error(0)
    records["setpoint_position"][:, 1] = records["position"][:, 1] = 0.0
    shown = slice(LATCHED_AT - 15, LATCHED_AT + 1)
    records["force"][shown, 1] = growing
    way = np.cumsum(np.cumsum(np.concatenate((growing[:1], growing[:-1])))) * 1e-6 / MODEL.mass
    for sign, cause in ((-1.0, "the axis goes against the force asked for"), (1.0, ROWS[Fault.FOLLOWING_ERROR].cause)):
        records["position"][shown, 1] = sign * way
        records["following_error"] = records["position"]
        assert one(told(records), Kind.FAULT_LATCHED, "following_error").cause.startswith(cause)


def test_an_axis_that_sinks_by_no_more_than_its_weight_has_a_weak_drive_or_is_pulled() -> None:
    records = following_error(0)
    seconds = np.arange(12) * 1e-3
    records["setpoint_position"][:, 1], records["force"][:, 1] = 0.0, 5.0
    records["position"][:, 1] = 0.0
    records["position"][LATCHED_AT - 11 : LATCHED_AT + 1, 1] = -0.5 * 2.0 * seconds**2
    records["following_error"] = records["position"]
    sunk = one(told(records, gravity=-5.0), Kind.FAULT_LATCHED, "following_error")
    assert sunk.cause.startswith("the drive gives less force than asked for and the axis sinks, or something pulls")
    assert "downwards" in sunk.cause


def test_one_step_is_a_jump_and_steps_to_and_fro_are_noise() -> None:
    jumped = leaving(np.full(3, 4e-4), force=0.0)
    assert jumped.cause.startswith("encoder jump: a step of 80000 counts in one tick")
    noisy = leaving(4e-4 * (np.arange(20) % 2), force=0.0)
    assert noisy.cause.startswith("noise at the encoder or its cable")


def test_an_axis_that_stops_from_one_tick_to_the_next_at_full_speed_has_a_stuck_encoder() -> None:
    records = following_error(0)
    speed = 1e-3 * np.arange(TICKS)  # 1 mm a tick, 1 m/s
    records["setpoint_position"][:, 1] = records["position"][:, 1] = speed
    records["setpoint_velocity"][:, 1], records["force"][:, 1] = 1.0, 300.0
    records["position"][LATCHED_AT - 6 :, 1] = speed[LATCHED_AT - 6]
    records["following_error"] = records["position"] - records["setpoint_position"]
    stuck = one(told(records), Kind.FAULT_LATCHED, "following_error")
    assert stuck.cause.startswith("encoder stuck: not one new count for 7 ticks")


@pytest.mark.parametrize("axis", range(3))
def test_answers_that_come_twice_are_told_as_such_with_their_axis(axis: int) -> None:
    records = silent([])
    records["rejects"][198:203, Reject.DUPLICATE] = np.arange(1, 6)
    records["rejects"][203:, Reject.DUPLICATE] = 5
    records["evidence_of"][202, 0] = int(Fault.BAD_FRAMES) | axis << 16
    records["evidence_value"][202, 0], records["evidence_limit"][202, 0] = 5, 5
    records["n_evidence"][202] = 1
    records["evidence_total"][202:] = 1
    records["faults_active"][202] = np.uint64(1 << Fault.BAD_FRAMES)
    records["fault"][LATCHED_AT:] = int(Fault.BAD_FRAMES)
    twice = one(told(records), Kind.FAULT_LATCHED, "bad_frames")
    assert (twice.axis, twice.cause[:29]) == (AXES[axis][0], "answers came twice (5): a dri")
