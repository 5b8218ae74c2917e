"""Quiet faults, each of a whole kind: told with axis, time and signature within half a second; none in sound runs."""

import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.cycle.goal import MotionWord
from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.events.axis_model import AxisModel
from hil.events.event import Event
from hil.events.stream import EventStream
from hil.events.table import Kind, Severity

PERIOD, TICKS, COUNT = 1_000_000, 9000, 5e-9
AXES: Final = [("x", "linear"), ("theta", "rotary")]
MODELS: Final = [AxisModel(COUNT, 0.9, 0.6, 3.0, -2.0), AxisModel(COUNT, 2e-4, 2e-3, 5e-4, 0.0)]
Floats = NDArray[np.float64]
Change = Callable[[NDArray[Any], int, NDArray[np.bool_], Floats], None]


def sound(noise: float = 0.5, seed: int = 1, *, constant: bool = False) -> NDArray[np.void]:
    """A second of motion, a second at rest, to and fro; encoders with noise (counts) and a floor that shakes."""
    draw = np.random.default_rng(seed)
    records = np.zeros(TICKS, RECORD)
    seconds = np.arange(TICKS) * 1e-3
    records["index"] = np.arange(TICKS)
    records["now_ns"] = records["scheduled_ns"] = PERIOD * records["index"]
    records["task_ns"] = PERIOD * records["index"]
    records["state"], records["flags"] = int(State.ACTIVE), 8
    for axis, model in enumerate(MODELS):
        way = np.select([seconds % 4 < 1, seconds % 4 >= 3], [1.0, -1.0], 0.0)  # 0..1 out, 3..4 back
        velocity = 4e-3 * way * (1.0 if constant else 1.5 * np.sin(np.pi * (seconds % 1)))
        error = (noise * draw.standard_normal(TICKS) + 8 * noise * np.sin(2 * np.pi * 25 * seconds)) * COUNT
        records["setpoint_velocity"][:, axis] = velocity
        records["setpoint_position"][:, axis] = np.cumsum(velocity) * 1e-3
        records["force"][:, axis] = model.dry * np.sign(velocity) + model.wet * velocity - model.gravity
        show(records, axis, records["setpoint_position"][:, axis] + error)
    return records


def show(records: NDArray[Any], axis: int, position: Floats) -> None:
    """As an encoder shows it."""
    records["position"][:, axis] = np.round(position / COUNT) * COUNT
    records["following_error"][:, axis] = records["position"][:, axis] - records["setpoint_position"][:, axis]


def told(records: NDArray[np.void], chunk: int = TICKS) -> list[Event]:
    stream = EventStream(AXES, PERIOD, models=MODELS)
    events = [event for at in range(0, TICKS, chunk) for event in stream.tell(records[at : at + chunk])]
    return [event for event in [*events, *stream.close()] if event.kind is Kind.ACCURACY_LOST]


def noise(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """Of 40 counts, RMS."""
    draw = np.random.default_rng(7)
    show(records, axis, records["position"][:, axis] + where * 40 * COUNT * draw.standard_normal(TICKS))


def vibration(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """At 40 Hz."""
    show(records, axis, records["position"][:, axis] + where * 100 * COUNT * np.sin(2 * np.pi * 40 * seconds))


def scale(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """An error that repeats each 20 um."""
    travel = records["setpoint_position"][:, axis]
    show(records, axis, records["position"][:, axis] + where * 200 * COUNT * np.sin(2 * np.pi * travel / 20e-6))


def friction(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """Twice what it was."""
    velocity = records["setpoint_velocity"][:, axis]
    records["force"][:, axis] += where * MODELS[axis].dry * np.sign(velocity)


def stuck(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """From the first of these ticks on."""
    position = records["position"][:, axis].copy()
    position[where] = position[int(np.argmax(where))]
    show(records, axis, position)


def jump(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """By 40000 counts; the loop has brought the shown position back after 20 ms."""
    begin = seconds[int(np.argmax(where))]
    show(records, axis, records["position"][:, axis] + where * 40_000 * COUNT * np.exp(-(seconds - begin) / 0.02))


def push(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """By 1.2 times the dry friction; the law holds against it."""
    records["force"][:, axis] += where * 1.2 * MODELS[axis].dry


def tug(records: NDArray[Any], axis: int, where: NDArray[np.bool_], seconds: Floats) -> None:
    """Along the motion back, by three times the dry friction."""
    records["force"][:, axis] += where * 3.0 * MODELS[axis].dry


QUIET: Final[dict[str, tuple[Change, str, list[float]]]] = {  # when it shows: in motion, at rest or both
    "noise": (noise, "noise", [5.31, 6.02, 7.1]),
    "vibration": (vibration, "oscillation", [5.31, 6.02, 7.1]),
    "scale": (scale, "periodic error", [7.02, 7.3]),
    "jump": (jump, "encoder jump", [5.31, 7.1]),
    "friction": (friction, "friction up", [7.02, 7.3]),
    "push": (push, "bias", [6.02, 6.3]),
    "tug": (tug, "bias", [7.02, 7.3]),
    "stuck": (stuck, "encoder stuck", [5.31, 6.02, 6.4, 7.1]),
}


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("name", "begin"), [(name, at) for name, row in QUIET.items() for at in row[2]])
def test_a_quiet_fault_is_told_within_half_a_second_with_axis_and_signature(name: str, begin: float, axis: int) -> None:
    change, signature, _ = QUIET[name]
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    change(records, axis, seconds >= begin, seconds)
    first = told(records)[0]
    assert (first.name, first.axis) == (signature, AXES[axis][0])
    assert begin < first.run_ns * 1e-9 <= begin + 0.5
    assert first.severity is Severity.WARNING
    assert first.value > first.limit
    assert f"accuracy lost: {signature} on {AXES[axis][0]}" in first.line
    if name == "vibration":
        assert "at 39.1 Hz" in first.measured or "at 39.7 Hz" in first.measured
    if name == "scale":
        assert float(first.measured.split("period of ")[1].split()[0]) == pytest.approx(20e-6, rel=0.1)


@pytest.mark.parametrize("axis", [0, 1])
def test_noise_at_rest_is_told_as_noise_though_the_law_answers_it_with_a_force(axis: int) -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    noise(records, axis, seconds >= 6.02, seconds)
    push(records, axis, seconds >= 6.02, seconds)
    first = told(records)[0]
    assert (first.name, first.axis) == ("noise", AXES[axis][0])
    assert 6.02 < first.run_ns * 1e-9 <= 6.52


def test_the_largest_steps_of_noise_that_was_told_are_no_jumps() -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    noise(records, 0, seconds >= 6.02, seconds)
    show(records, 0, records["position"][:, 0] + (np.arange(TICKS) == 6700) * 4000 * COUNT)  # its one outlier
    assert [event.name for event in told(records)] == ["noise"]


@pytest.mark.parametrize("change", [vibration, scale])
def test_at_a_constant_speed_frequency_and_period_are_both_told(change: Change) -> None:
    records, seconds = sound(constant=True), np.arange(TICKS) * 1e-3
    change(records, 0, seconds >= 7.1, seconds)
    first = told(records)[0]
    assert first.name == "oscillation"
    assert re.search(r"at \S+ Hz, or with a period of \S+ of travel: the speed was constant", first.measured)


@pytest.mark.parametrize(("held_s", "is_told"), [(0.15, False), (0.45, True)])
def test_an_axis_that_friction_holds_as_it_sets_off_is_not_stuck_unless_it_stays(held_s: float, is_told: bool) -> None:
    records, seconds = sound(noise=0.0), np.arange(TICKS) * 1e-3
    stuck(records, 0, (seconds >= 7.0) & (seconds < 7.0 + held_s), seconds)
    assert ("encoder stuck" in {event.name for event in told(records)}) is is_told


@pytest.mark.parametrize("counts", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(10))
def test_nothing_is_told_of_sound_axes_with_and_without_noise(counts: float, seed: int) -> None:
    assert not told(sound(counts, seed))


@pytest.mark.parametrize("chunk", [pytest.param(1, marks=pytest.mark.long), 7, 50, 64, 1000])
def test_how_the_ticks_come_makes_no_difference(chunk: int) -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    noise(records, 1, seconds >= 5.31, seconds)
    assert told(records, chunk) == told(records)


def test_one_happening_is_told_once_and_again_when_it_was_gone() -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    noise(records, 0, (seconds >= 5.2) & (seconds < 5.8) | (seconds >= 8.3), seconds)
    events = told(records)
    assert [event.name for event in events] == ["noise"] * len(events)
    assert len(events) == 2


def test_where_nothing_is_followed_and_where_no_model_is_known_nothing_is_judged() -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    noise(records, 0, seconds >= 5.3, seconds)
    assert [e for e in EventStream(AXES, PERIOD).tell(records) if e.kind is Kind.ACCURACY_LOST] == []
    records["state"] = int(State.FAULT)
    assert not told(records)


def test_at_rest_several_times_the_force_names_a_weak_drive_too_and_the_other_way_round_it_does_not() -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    records["force"][seconds >= 6.3, 0] *= 2.0  # gravity is held by a drive that gives half
    assert "its drive gives less force" in told(records)[0].cause
    records = sound()
    records["force"][seconds >= 6.3, 0] -= 4.0
    (pushed,) = told(records)
    assert (pushed.name, pushed.axis) == ("bias", "x")
    assert pushed.cause.startswith("something pushes or pulls the axis upwards")
    assert "drive" not in pushed.cause


def test_an_axis_that_is_driven_back_is_pushed_and_one_that_only_drags_has_friction() -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    records["force"][seconds >= 7.1, 0] -= 3.0
    assert told(records)[0].name == "friction up"
    back = 3e-4 * np.exp(-((seconds - 7.15) ** 2) / (2 * 0.01**2)) * (seconds >= 7.1)
    show(records, 0, records["position"][:, 0] + back)
    first = told(records)[0]
    assert first.name == "bias"
    assert "upwards" in first.cause


def test_noise_beyond_any_force_is_noise_and_a_step_within_the_force_limits_is_a_jump() -> None:
    records, seconds = sound(), np.arange(TICKS) * 1e-3
    draw = np.random.default_rng(3)
    loud = (seconds >= 6.1) * 2000 * COUNT * draw.standard_normal(TICKS)
    show(records, 0, records["position"][:, 0] + loud)
    assert told(records)[0].name == "noise"
    records = sound()
    records["force"][:, 0] += (seconds >= 6.1) * 14.0 * (np.arange(TICKS) % 2 * 2 - 1)  # it could have been the force
    jump(records, 0, seconds >= 6.2, seconds)
    assert told(records)[0].name == "encoder jump"


@pytest.mark.parametrize("word", [MotionWord.MOVE, MotionWord.JOG, MotionWord.STREAM])
def test_goals_and_homing_are_watched_as_a_task_is(word: MotionWord) -> None:
    for state in (State.ACTIVE, State.HOMING):
        records, seconds = sound(), np.arange(TICKS) * 1e-3
        records["task_ns"], records["motion"], records["state"] = -1, int(word), int(state)
        assert not told(records)
        noise(records, 1, seconds >= 5.31, seconds)
        assert told(records)[0].name == "noise"
