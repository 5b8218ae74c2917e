"""A task that cannot be done is refused before anything moves, by name; one that is accepted runs without a fault."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.analysis.feasibility import (
    SAMPLES_A_PERIOD,
    corner_starts,
    start_notes,
    task_problems,
    unit_questions,
    violations,
)
from hil.control.trajectories import make_trajectory
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun, activate_when_ready
from tests.support.paths import RIGS

AXES = ("x", "y")


@pytest.mark.parametrize("name", ["paper", "paper-dbc", "microscope-ideal"])
def test_the_shipped_rigs_can_do_their_tasks(name: str) -> None:
    assert task_problems(load_rig(RIGS / f"{name}.toml")) == []


def test_a_circle_of_twenty_metres_on_a_stage_of_millimetres_is_refused() -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml", ["task.kind=circle", 'task.axes=["x", "y"]', "task.radius=20"])
    problems = "\n".join(task_problems(rig))
    for word in ("axis x: position", "axis y: speed", "axes.x.limits.force = 15.0", "after the start", "[task]"):
        assert word in problems


def test_where_the_stage_stands_matters() -> None:
    sets = ["task.kind=point_to_point", 'task.axes=["x"]', "task.target=[0.02]", "task.move_s=1.0"]
    rig = load_rig(RIGS / "microscope-ideal.toml", sets)
    assert task_problems(rig) == []
    (note,) = [line for line in start_notes(rig) if "speed" in line]
    assert "from the lower ends of the travel: axis x: speed" in note
    assert violations(rig, [-0.025, 0.0, 0.0, 0.0])[0].quantity == "speed"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ("axes.x.model.mass=900", "grams"),
        ("axes.x.limits.position=[-26.0, 26.0]", "millimetres"),
        ("axes.x.encoder_resolution=0.02", "counts"),
        ("axes.x.model.coulomb=600", "newtons"),
        ("axes.x.model.gravity=-600", "grams"),
        ("axes.x.limits.speed=80", "mm/s"),
        ("axes.x.limits.following_error=5e-10", "count"),
    ],
)
def test_a_unit_that_is_off_by_thousands_is_asked_back(change: str, word: str) -> None:
    (question,) = unit_questions(load_rig(RIGS / "microscope-ideal.toml", [change]))
    assert question.startswith("axes.x.")
    assert word in question


@pytest.mark.parametrize(
    ("at", "beyond"),
    [
        ({"limits.force": 1.0, "model.mass": 20.0}, {"model.mass": 20.0001}),
        ({"limits.force": 1.0, "model.mass": 1e-5}, {"model.mass": 0.99999e-5}),
        ({"limits.force": 1.0, "model.coulomb": 1.0}, {"model.coulomb": 1.0001}),
        ({"limits.force": 1.0, "model.gravity": -1.0}, {"model.gravity": -1.0001}),
        ({"limits.position": [-0.25, 0.25], "limits.speed": 500.0}, {"limits.speed": 500.1}),
    ],
    ids=["heaviest", "lightest", "friction", "weight", "speed"],
)
def test_what_is_just_possible_is_not_asked_back(at: dict[str, Any], beyond: dict[str, Any]) -> None:
    for sets, asked in ((at, 0), (at | beyond, 1)):
        rig = load_rig(RIGS / "microscope-ideal.toml", [f"axes.x.{key}={value}" for key, value in sets.items()])
        assert len(unit_questions(rig)) == asked


def test_a_loop_too_slow_for_its_task_is_refused() -> None:
    rig = load_rig(RIGS / "paper.toml", ["task.frequency_hz=60", "task.radius=1e-7"])
    assert {violation.quantity for violation in violations(rig, [0.0, 0.0])} == {"control periods per oscillation"}


# any task, limits and place -------------------------------------------------------------------------------------------


@st.composite
def tasks(draw: st.DrawFn) -> dict[str, Any]:
    """Keys and values of a rig on the paper's stage, sizes on either side of what it can do."""
    kind = draw(st.sampled_from(["circle", "lissajous", "point_to_point"]))
    size = 10.0 ** draw(st.floats(-2.5, -0.2))
    sets: dict[str, Any] = {"task.kind": kind, "task.settle_s": 0.0, "task.axes": list(AXES)}
    if kind == "point_to_point":
        sets |= {
            "task.target": [size, -size / 2],
            "task.move_s": 10.0 ** draw(st.floats(-1.3, 0.0)),
            "task.dwell_s": 0.05,
        }
    else:
        sets |= {"task.radius": size, "task.frequency_hz": draw(st.floats(0.7, 4.0))}
        sets |= {"task.approach_s": 10.0 ** draw(st.floats(-1.0, 0.0)), "task.phase": draw(st.floats(0.0, 6.3))}
    for axis in AXES:
        limits = f"axes.{axis}.limits"
        travel = 10.0 ** draw(st.floats(-1.0, 0.3))
        sets[f"{limits}.position"] = [-travel, travel]
        sets[f"{limits}.following_error"] = 10.0 ** draw(
            st.floats(-2.0, -0.5)
        )  # more than the travel margin's bound, too
        sets[f"{limits}.speed"] = 10.0 ** draw(st.floats(0.0, 1.0))
        sets[f"{limits}.force"] = draw(st.floats(4.0, 9.0))
        sets[f"{limits}.force_rate"] = 10.0 ** draw(st.floats(3.0, 4.3))
        sets[f"axes.{axis}.rated_force"] = 10.0
    sets["plant.initial_position"] = [draw(st.floats(-0.9, 0.9)) * sets[f"axes.{a}.limits.position"][1] for a in AXES]
    return sets


def rig_with(sets: Mapping[str, Any]) -> RigConfig:
    def written(value: Any) -> str:
        return f'"{value}"' if isinstance(value, str) else str(value).replace("'", '"')

    overrides = ["law.name=structured-kalman", *(f"{key}={written(value)}" for key, value in sets.items())]
    return load_rig(RIGS / "paper.toml", overrides)


def really_broken(rig: RigConfig, start: list[float], axis: str, quantity: str) -> bool:
    """By another road: instant by instant, in plain Python, five times as finely as the control loop, with no margin
    but the stated ones.
    """
    index, config = rig.axis_names.index(axis), rig.axes[axis]
    limits, model = config.limits, config.model
    trajectory = make_trajectory(rig.task, rig.axis_names, start, rig.period_ns)
    end = (trajectory.repeat_from_ns or 0) + (trajectory.repeat_ns or 0)
    step = rig.period_ns // 5
    margin = min(0.5 * limits.following_error, 0.05 * (limits.position[1] - limits.position[0]))
    low, high = limits.position[0] + margin, limits.position[1] - margin
    forces: list[float] = []
    for t in range(0, end + 2 * rig.period_ns, step):
        q, v, a = trajectory.at(index, t)
        stopped = q + v * abs(v) * model.mass / limits.force
        smooth = model.mass * a + v * (model.viscous + model.quadratic * abs(v)) - model.gravity
        forces.append(smooth)
        force = abs(smooth + model.coulomb * float(np.sign(v)))
        rate = abs(forces[-1] - forces[-6]) / (rig.period_ns * 1e-9) if len(forces) > 5 else 0.0
        broken = {
            "position": not (low <= q <= high and low <= stopped <= high),
            "speed": abs(v) > 0.95 * limits.speed,
            "force": force > 0.85 * limits.force,
            "force rate": rate > 0.85 * limits.force_rate,
        }
        if broken.get(quantity):
            return True
    return False


def judged(sets: Mapping[str, Any]) -> bool:
    """Hold the verdict on one rig to what is so; whether it was accepted."""
    rig = rig_with(sets)
    start = [float(value) for value in sets["plant.initial_position"]]
    found = violations(rig, start)
    for violation in found:
        assert violation.time_s >= 0.0 or math.isnan(violation.time_s)
        if "control periods" not in violation.quantity:
            assert really_broken(rig, start, violation.axis, violation.quantity), violation
    run = LockstepRun(rig, RIGS, operator=activate_when_ready)
    if found:
        for _ in range(30):  # the operator asks for ACTIVATE in every tick of READY
            run.tick()
        assert run.cycle.commands.refused
        assert run.cycle.state.name == "READY"
        return False
    trajectory = make_trajectory(rig.task, rig.axis_names, start, rig.period_ns)
    horizon = trajectory.repeat_from_ns + (trajectory.repeat_ns or 0)
    for _ in range(200 + horizon // rig.period_ns):
        run.tick()
    faults = {name: count for name, count in run.cycle.monitor.named_counts().items() if count}
    assert (run.cycle.state.name, faults) == ("ACTIVE", {})
    return True


@pytest.mark.requirement(id="SR-4.4")
@pytest.mark.long
@pytest.mark.usefixtures("filterpy_loaded")
@given(tasks())
@settings(max_examples=14, suppress_health_check=list(HealthCheck))
def test_what_is_accepted_runs_and_what_is_refused_is_broken(sets: dict[str, Any]) -> None:
    judged(sets)


@pytest.mark.slow
@pytest.mark.usefixtures("filterpy_loaded")
def test_five_hundred_of_each_kind() -> None:
    verdicts = {True: 0, False: 0}

    @given(tasks())
    @settings(max_examples=1200, suppress_health_check=list(HealthCheck))
    def all_of_them(sets: dict[str, Any]) -> None:
        verdicts[judged(sets)] += 1

    all_of_them()
    assert min(verdicts.values()) >= 500, verdicts


def test_the_corners_are_within_the_travel() -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml")
    for start in corner_starts(rig).values():
        for value, axis in zip(start, rig.axes.values(), strict=True):
            assert axis.limits.position[0] < value < axis.limits.position[1]
    assert start_notes(rig_with({"task.kind": "hold"})) == []


def test_a_violation_tells_the_first_moment_and_what_is_wanted_then() -> None:
    rig = load_rig(RIGS / "paper.toml", ["axes.x.limits.speed=1.0"])
    (found,) = [v for v in violations(rig, [0.0, 0.0]) if (v.axis, v.quantity) == ("x", "speed")]
    trajectory = make_trajectory(rig.task, rig.axis_names, [0.0, 0.0], rig.period_ns)
    at = round(found.time_s * 1e9)
    assert abs(trajectory.at(0, at)[1]) > 0.95
    assert max(abs(trajectory.at(0, t)[1]) for t in range(0, at, rig.period_ns)) <= 0.95


def test_a_move_of_a_few_control_periods_is_refused_and_one_of_enough_is_not() -> None:
    def quantities(move_s: float) -> set[str]:
        sets = ["task.kind=point_to_point", 'task.axes=["x"]', "task.target=[1e-9]", f"task.move_s={move_s}"]
        return {violation.quantity for violation in violations(load_rig(RIGS / "paper.toml", sets), [0.0, 0.0])}

    assert "control periods per move" in quantities((SAMPLES_A_PERIOD - 1) * 1e-3)
    assert "control periods per move" not in quantities((SAMPLES_A_PERIOD + 1) * 1e-3)
