"""Experiments as plans, and a push and an ordinary run identified end to end."""

from pathlib import Path

import numpy as np
import pytest

from hil.identify.excitation import PERIOD_S
from hil.identify.experiments import EXPERIMENTS, HOLD_HZ, ROW_S, Known, Plan, rig_document
from hil.identify.findings import from_run
from hil.identify.lockstep import Trial, identify, in_virtual_time
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.runs.api import Recording, Run, load_run, simulate
from hil.runs.rigs import Rig
from hil.virtual.replay import code_of_recording
from tests.identify import rigs
from tests.support.paths import ROOT


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_plan_stays_inside_the_limits_and_ends_at_rest(experiment: str) -> None:
    for axis in load_rig(by_name("rigs", Path("microscope"))).axes.values():
        plan = EXPERIMENTS[experiment](axis, Known(axis.model.mass, 0.0, axis.model.coulomb), 1.0)
        low, high = axis.limits.position
        assert low < plan.positions.min() <= plan.positions.max() < high
        assert np.abs(np.diff(plan.positions)).max() / ROW_S < 0.6 * axis.limits.speed
        assert np.ptp(plan.positions[-20:]) == 0.0
        assert plan.gains.get("until_s", 0.0) < 1.0 + len(plan.positions) * ROW_S
        for begin, end, speed in plan.spans:
            rows = plan.positions[round((begin - 1.0) / ROW_S) : round((end - 1.0) / ROW_S) + 1]
            assert np.diff(rows) / ROW_S == pytest.approx(speed)


@pytest.mark.long
def test_the_other_axes_rest_while_one_is_excited() -> None:
    rig = load_rig(by_name("rigs", Path("microscope")))
    plan = EXPERIMENTS["moves"](rig.axes["x"], Known(0.9, 0.0, 0.6), 0.1)
    short = Plan(plan.positions[:20], plan.gains)
    document, seconds = rig_document(rig, "x", short, 0.1)
    run = simulate(Rig.build(document, Path()), seconds + 1.5)
    assert run.summary()["faults"] == []
    others = run.columns["force"][:, 1:]
    assert np.isfinite(others).all()
    assert np.nanmax(np.abs(run.columns["following_error"][:, 1:])) < 1e-5


@pytest.mark.long
def test_a_weight_that_nobody_has_measured_yet_is_held_while_another_axis_is_excited() -> None:
    """Gravity and mass 30 % too small; the loose loop of 10 Hz let the axis sink beyond its following error."""
    file = by_name("rigs", Path("microscope"))
    rig = load_rig(file, ["axes.z.model.gravity=-1.75", "axes.z.model.mass=0.175"])
    plan = EXPERIMENTS["push"](rig.axes["x"], Known(0.9, 0.0, 0.6), 0.3)
    document, seconds = rig_document(rig, "x", Plan(plan.positions[:20], plan.gains), 0.3)
    run = simulate(Rig.build(document, file.parent), seconds + 1.0)
    assert run.summary()["faults"] == []
    assert np.nanmax(np.abs(run.columns["following_error"][:, 2])) < 0.8 * rig.axes["z"].limits.following_error


def test_an_axis_with_a_weight_comes_first_and_is_then_held_by_what_was_found() -> None:
    rig = load_rig(by_name("rigs", Path("microscope")))
    trials: list[Trial] = []

    def runner(trial: Trial) -> tuple[Run, str]:
        trials.append(trial)
        return simulate(Rig.build(trial.document, by_name("rigs", Path("microscope")).parent), 0.01), ""

    found = identify(rig, Path(), ["x", "z"], lambda text: None, ["push"], runner)
    assert list(found) == ["x", "z"]
    assert [trial.axis for trial in trials] == ["z", "x"]
    first, second = (trial.document["law"]["gains"] for trial in trials)
    assert first["hold_hz"] == second["hold_hz"] == [0.0, 0.0, HOLD_HZ, 0.0], "no other axis has a weight"
    assert second["gravity"][2] == 2.45, "as it was found"


@pytest.mark.parametrize("speed", [0.08, 4e-3])
def test_passes_of_opposite_sign_meet_the_same_places_at_the_same_instants_of_the_multisine(speed: float) -> None:
    """Else cogging stays in their difference: at 12.8 Hz, half a period late, it made 4 dB of theta's line at 12 Hz."""
    axis = rigs.one_axis().config.axes["x"]
    limits = axis.limits.model_copy(update={"speed": speed})
    plan = EXPERIMENTS["frequency"](axis.model_copy(update={"limits": limits}), Known(1.0, 0.0, 0.6), 1.0)
    begins = np.array([begin for begin, *_ in plan.spans])
    assert plan.gains["alternate_s"] == pytest.approx(begins[2] - begins[0])
    for number in (0, 1, 4, 5, 8, 9):
        periods = (begins[number + 2] - begins[number]) / PERIOD_S
        assert periods == pytest.approx(round(periods), abs=1e-6)
        places = [plan.positions[round((begins[at] - 1.0) / ROW_S)] for at in (number, number + 2)]
        assert places[0] == pytest.approx(places[1], abs=1e-9)
    assert len({round(way, 6) for _, _, way in plan.spans}) == 6, "three ways, there and back"


def test_check_moves_slowly_where_friction_that_passes_would_shake_the_axis() -> None:
    """Swings count as an oscillation from 5 Hz on; friction of a period of 2 mm passes at 4 Hz then."""
    axis = rigs.one_axis().config.axes["x"]
    steady, light = Known(1.0, 0.0, 0.6, 0.1, 2e-3), Known(0.1, 0.0, 0.6, 0.1, 2e-3)
    fast, slow = (
        np.abs(np.diff(EXPERIMENTS["check"](axis, one, 1.0).positions)).max() / ROW_S for one in (steady, light)
    )
    assert fast == pytest.approx(0.2 * axis.limits.speed, rel=0.1)
    assert slow == pytest.approx(2e-3 * 4.0, rel=0.1)


@pytest.mark.long
def test_a_push_finds_the_friction_of_a_stage_that_the_rig_file_does_not_know() -> None:
    rig = rigs.one_axis()
    found = identify(rig.config, rig.folder, ["x"], lambda text: None, ["push"])["x"]
    assert found.refused == {}
    assert found.found["push_coulomb"].holds(rigs.COULOMB)


@pytest.mark.long
@pytest.mark.parametrize(("axis", "gravity"), [("x", 0.0), ("z", -1.75)])
def test_an_axis_holds_still_before_its_push_although_it_carries_a_resonance(axis: str, gravity: float) -> None:
    """The shipped microscope: 200 Hz, damped by 0.02. A quick hold without a filter rang there and ended in SPEED."""
    rig = load_rig(by_name("rigs", Path("microscope")), [f"axes.{axis}.model.gravity={gravity}"])
    own = rig.axes[axis]
    plan = EXPERIMENTS["push"](own, Known(own.model.mass, 0.0, own.model.coulomb), 0.5)
    document, _ = rig_document(rig, axis, Plan(plan.positions[: round(1.6 / ROW_S)], plan.gains), 0.5)
    run = simulate(Rig.build(document, by_name("rigs", Path("microscope")).parent), 2.2)
    assert run.summary()["faults"] == []
    error = run.columns["following_error"][:, rig.axis_names.index(axis)]
    held = error[np.isfinite(error)]
    assert np.abs(held).max() < 0.6 * own.limits.following_error, "also with a weight 30 % off"
    assert np.ptp(np.diff(held[-200:])) < 2e-6, "it does not ring"


def test_an_ordinary_run_tells_mass_and_friction() -> None:
    task = {"kind": "point_to_point", "axes": ["x"], "target": [2e-3], "move_s": 0.15, "dwell_s": 0.1}
    rig = rigs.one_axis(task=task, law={"name": "pid"})
    found = from_run(simulate(rig, 3.0), "x").found
    assert found["mass"].value == pytest.approx(rigs.MASS, rel=0.05)
    assert found["coulomb"].value == pytest.approx(rigs.COULOMB, rel=0.05)


def test_a_run_without_motion_is_refused_by_name() -> None:
    rig = rigs.one_axis(task={"kind": "hold"})
    assert "not enough motion" in from_run(simulate(rig, 1.0), "x").refused["force balance"]


@pytest.mark.slow
def test_all_experiments_identify_a_stage() -> None:
    rig = rigs.one_axis()
    found = identify(rig.config, rig.folder, ["x"], lambda text: None)["x"].found
    for name, truth, within in (
        ("mass", rigs.MASS, 0.01), ("torque_lag", 2e-4, 0.1), ("coulomb", rigs.COULOMB, 0.03),
        ("viscous", rigs.VISCOUS, 0.15), ("presliding", rigs.LENGTH, 0.2),
    ):  # fmt: skip
        assert found[name].value == pytest.approx(truth, rel=within), name


def test_a_recording_of_an_experiment_replays_without_asking(tmp_path: Path) -> None:
    rig = rigs.one_axis().config
    plan = EXPERIMENTS["push"](rig.axes["x"], Known(rigs.MASS), 0.3)
    document, _ = rig_document(rig, "x", plan, 0.3)
    run = simulate(Rig.build(document), 1.5, record=tmp_path / "run.mcap")
    recorded = load_run(tmp_path)
    assert isinstance(recorded, Recording)
    assert recorded.exact, "the law of the experiments is ours"
    assert np.array_equal(recorded.columns["force"], run.columns["force"])
    assert code_of_recording(tmp_path / "run.mcap") == []


@pytest.mark.long
def test_a_scale_that_slips_is_refused() -> None:
    """The head of a linear encoder that is not screwed tight: 0.2 mm over the passes."""
    plant = {"mass": [rigs.MASS], "coulomb": [rigs.COULOMB], "viscous": [rigs.VISCOUS], "friction_variation": [0.1],
             "friction_period": [8e-3]}  # fmt: skip
    rig = rigs.one_axis(plant=plant).config

    def refused(slip: float) -> str:
        def runner(trial: Trial) -> tuple[Run, str]:
            run, trace = in_virtual_time(trial)
            run.columns["position"][:, 0] += np.linspace(0.0, slip, len(run.columns["position"]))
            return run, trace

        return identify(rig, Path(), ["x"], lambda _: None, ["moves"], runner)["x"].refused.get("position_drift", "")

    assert refused(0.0) == ""
    assert "positions shifted by 0.0" in refused(2e-4)


@pytest.mark.long
def test_axes_that_move_together_are_refused() -> None:
    """Flexures that lean on each other: y is pulled off its place as x moves."""
    stage = {"stage": "./leaning.py:Leaning", "parameters": {"stiffness": 200.0, "lean": 0.5}}
    source = (ROOT / "examples/stages/leaning.py").read_text(encoding="utf-8")
    document = rigs.one_axis().config.model_dump(mode="json")
    document["axes"]["y"] = document["axes"]["x"]
    alone = {"mass": [rigs.MASS] * 2, "coulomb": [0.1] * 2, "viscous": [rigs.VISCOUS] * 2}

    def together(plant: dict[str, object]) -> str:
        rig = Rig.build(document | {"plant": alone | plant}).config
        return identify(rig, Path(), ["x"], lambda _: None, ["moves"])["x"].refused.get("together", "")

    assert together({}) == ""
    assert "y was moved by" in together(stage | {"source": source})
