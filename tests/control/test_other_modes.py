"""Resonances beside the first one in the observer of presliding-kalman, and what they take of its speed."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from hil.analysis.flexible_plant import AxisDynamics, FlexiblePlant
from hil.analysis.loop_corners import CornerFinding, CornerTrial, check_corners
from hil.analysis.pulse_loop import RigidPlant, loop_of, nominal_plant, try_together
from hil.control.laws.base import Model
from hil.control.laws.motion_observer import Channel, MotionModel, MotionObserver
from hil.control.laws.presliding_kalman import PreslidingKalman
from hil.control.nominal_model import rig_model
from hil.rig.file import load_rig
from hil.rig.measured_table import MeasuredConfig
from hil.rig.schema import LawConfig, RigConfig
from tests.golden.laws.tell import play
from tests.support.paths import RIGS

PERIOD, MASS, LAG = 1e-3, 0.9, 2e-4
SECOND, THIRD = (260.0, 0.01, 0.05), (380.0, 0.02, 0.08)
LAW = LawConfig(name="presliding-kalman")


def model(first: float, *others: tuple[float, float, float]) -> Model:
    """Of one axis. first: Hz of a tool on an undamped spring; 0: none."""
    rigid = Model(MASS, 0.6, 3.0, 0.0, 0.0, LAG, first, 0.0, 0.3)
    for name, mode in zip(("second", "third"), others, strict=False):
        rigid = replace(rigid, **dict(zip((f"{name}_frequency", f"{name}_damping", f"{name}_load"), mode, strict=True)))
    return rigid


@pytest.mark.parametrize("first", [0.0, 120.0])
@pytest.mark.parametrize("others", [(SECOND,), (SECOND, THIRD)])
def test_the_observer_foretells_the_motor_of_masses_that_hang_on_it(first: float, others: Any) -> None:
    """Without a correction it is the stage that `hil check` has, step by step."""
    plant = FlexiblePlant([[AxisDynamics(MASS, LAG, first, 0.0, 0.3, others=others)]], PERIOD)
    observer, random = MotionObserver(MotionModel(model(first, *others), PERIOD), 0.0), np.random.default_rng(5)
    seen, true = [], []
    for force in random.uniform(-1.0, 1.0, 200):
        plant.advance(np.array([[force]]))
        observer.advance(float(force), 0.0)
        seen.append(observer.seen)
        true.append(plant.error[0, 0])
    assert seen == pytest.approx(true, rel=1e-6, abs=1e-9 * np.abs(true).max())


def test_a_channel_is_what_an_observer_makes_of_a_force_it_does_not_know() -> None:
    motion = MotionModel(model(120.0, SECOND, THIRD), PERIOD)
    gains = motion.gains(5.0, 2.0, 10.0, [9.0, 12.0])
    axis, observer, channel = MotionObserver(motion, 0.0), MotionObserver(motion, 0.0), Channel(0.0)
    for force in np.random.default_rng(6).uniform(-1.0, 1.0, 50):
        axis.d = float(force)
        axis.advance(0.0, 0.0)
        observer.advance(0.0, 0.0)
        innovation = axis.seen - observer.seen
        observer.correct(innovation, gains)
        assert channel.innovation(float(force), motion, gains) == pytest.approx(innovation, rel=1e-6, abs=1e-12)


def test_a_force_that_was_another_than_expected_is_put_right_by_one_sample() -> None:
    motion = MotionModel(model(120.0, SECOND, THIRD), PERIOD)
    axis, observer = MotionObserver(motion, 0.0), MotionObserver(motion, 0.0)
    axis.f = 0.4
    axis.advance(0.0, 0.0)
    observer.advance(0.0, 0.0)
    observer.correct(axis.seen, motion.thrown)
    axis.f = observer.f
    for _ in range(20):
        axis.advance(0.0, 0.0)
        observer.advance(0.0, 0.0)
        assert observer.seen == pytest.approx(axis.seen, rel=1e-6)


def test_a_light_resonance_is_no_tool_that_the_law_would_follow() -> None:
    assert MotionModel(model(0.0, SECOND), PERIOD).tool_lag == 0.0
    assert MotionModel(model(120.0, SECOND), PERIOD).tool_lag == MotionModel(model(120.0), PERIOD).tool_lag > 0.0


def pair(*models: Model) -> Model:
    """Of arrays, an axis each."""
    return Model(*(np.array([float(getattr(one, field.name)) for one in models]) for field in fields(Model)))


@pytest.mark.parametrize("first", [0.0, 120.0])
def test_floats_and_arrays_are_the_same_bits_and_an_axis_without_is_as_it_was(first: float) -> None:
    """Beside an axis with two further resonances stands one without any, or with one."""
    plain = np.array(play(LAW, pair(model(first), model(first)))[0])
    without = np.array(play(LAW, pair(model(first), model(first, SECOND, THIRD))))
    one_more = np.array(play(LAW, pair(model(first, THIRD), model(first, SECOND, THIRD))))
    assert without[0].tobytes() == without[1].tobytes()
    assert one_more[0].tobytes() == one_more[1].tobytes()
    assert without[0][:, 0].tobytes() == plain[:, 0].tobytes()
    assert without[0][:, 1].tobytes() == one_more[0][:, 1].tobytes() != plain[:, 1].tobytes()
    assert one_more[0][:, 0].tobytes() != plain[:, 0].tobytes()


def test_a_law_made_from_what_another_was_designed_to_be_is_the_same() -> None:
    known = model(120.0, SECOND, THIRD)
    law = PreslidingKalman(known, PERIOD, 5.0)
    again = PreslidingKalman(known, PERIOD, 5.0, designed=law.designed())
    assert again.designed() == law.designed()
    assert again._motion.thrown.values() == law._motion.thrown.values()


def test_the_loop_is_slower_the_nearer_and_heavier_the_resonance() -> None:
    def bandwidth(*others: tuple[float, float, float], known: float = 0.0, first: float = 0.0) -> float:
        return float(PreslidingKalman.own_gains(replace(model(first, *others), known=known), PERIOD)["bandwidth"])

    for first in (0.0, 120.0):
        free, far, near = (
            bandwidth(first=first),
            bandwidth((400.0, 0.01, 0.05), first=first),
            bandwidth(SECOND, first=first),
        )
        assert free > far > near > bandwidth(SECOND, THIRD, first=first)
        assert near > bandwidth((260.0, 0.01, 0.08), first=first)
        assert near < bandwidth(SECOND, known=1.0, first=first)


def test_the_nominal_stage_has_them() -> None:
    rig = load_rig(
        RIGS / "microscope.toml", [f"axes.{name}.model.mode_frequency_hz=0" for name in ("x", "y", "z", "theta")]
    )
    period = rig.period_ns * 1e-9
    assert isinstance(nominal_plant(rig_model(rig), period, (1, 4)), RigidPlant)
    rig = _stated(rig, {"y": [list(SECOND), list(THIRD)]})
    found = nominal_plant(rig_model(rig), period, (1, 4))
    mass, lag = rig.axes["y"].model.mass, rig.axes["y"].model.torque_lag
    rows = [[AxisDynamics(axis.model.mass) for axis in rig.axes.values()]]
    rows[0][1] = AxisDynamics(mass, lag, 0.0, 0.02, 0.3, others=(SECOND, THIRD))
    expected = FlexiblePlant(rows, period)
    for force in (1.0, -2.0, 0.5):
        found.advance(np.full((1, 4), force))
        expected.advance(np.full((1, 4), force))
    assert found.error.tolist() == expected.error.tolist()


def _stated(rig: RigConfig, others: dict[str, list[list[float]]], first_hz: float | None = None) -> RigConfig:
    axes = {}
    for name, axis in rig.axes.items():
        changes: dict[str, Any] = {"other_modes": others.get(name, [])}
        if first_hz is not None:
            changes["mode_frequency_hz"] = first_hz * 0.7**0.5
        axes[name] = axis.model_copy(update={"model": axis.model.model_copy(update=changes)})
    return rig.model_copy(update={"axes": axes})


def _problems(first_hz: float, others: list[list[list[float]]]) -> list[CornerFinding]:
    rig = load_rig(RIGS / "microscope.toml", ["law.name=presliding-kalman"])
    stated = dict(zip(rig.axes, others, strict=True))
    return [one for one in check_corners(_stated(rig, stated, first_hz)) if one.lacks()]


@pytest.mark.long
@pytest.mark.parametrize(
    ("first_hz", "hertz"), [(0.0, (150.0, 210.0, 300.0)), (0.0, (175.0, 250.0, 400.0)), (150.0, (235.0, 300.0, 400.0))]
)
@pytest.mark.parametrize(("damping", "load"), [(0.005, 0.02), (0.005, 0.08), (0.02, 0.08)])
def test_a_loop_whose_further_resonance_is_stated_has_the_margins(
    first_hz: float, hertz: tuple[float, ...], damping: float, load: float
) -> None:
    """Of hard stages, on the model and with all resonances 10 % off."""
    others = [[[at, damping, load]] for at in hertz] + [[[hertz[0], damping, load], [1.5 * hertz[0], damping, load]]]
    assert [one.lacks() for one in _problems(first_hz, others)] == []


@pytest.mark.long
def test_a_loop_has_the_margins_of_a_measured_axis_with_further_resonances() -> None:
    """As four hard stages were identified, whose friction varies, too: learning that takes a part of the margins."""
    others = [
        [[242.0, 0.0101, 0.075], [429.0, 0.0164, 0.069]],
        [[263.0, 0.0169, 0.06], [380.0, 0.0156, 0.056]],
        [[283.0, 0.0053, 0.07], [310.0, 0.0113, 0.072]],
        [[307.0, 0.0168, 0.072], [327.0, 0.0105, 0.039]],
    ]
    rig = load_rig(RIGS / "microscope.toml", ["law.name=presliding-kalman"])
    stated = _stated(rig, dict(zip(rig.axes, others, strict=True)), 150.0)
    axes = {}
    for name, axis in stated.axes.items():
        model = axis.model.model_copy(update={"torque_lag": 2e-4, "friction_period": 8e-4})
        measured = {key: [getattr(model, key), 0.0] for key in ("mass", "torque_lag", "mode_frequency_hz")}
        measured |= {f"other_mode_{n}_frequency_hz": [one[0], 0.0] for n, one in enumerate(model.other_modes, 1)}
        axes[name] = axis.model_copy(update={"model": model, "measured": MeasuredConfig.model_validate(measured)})
        assert axes[name].tolerances.known == 1.0
    findings = check_corners(stated.model_copy(update={"axes": axes}))
    assert [one.lacks() for one in findings if one.lacks()] == []


@pytest.mark.long
def test_a_loop_whose_further_resonance_is_not_stated_rings() -> None:
    """The law of a rigid axis, on that stage: what the test above asks for is no matter of course."""
    bare = _stated(load_rig(RIGS / "microscope.toml", ["law.name=presliding-kalman"]), {}, 0.0)
    trial = CornerTrial(_stated(bare, {"x": [[300.0, 0.005, 0.08]]}))
    try_together(loop_of(bare, [trial]), [trial])
    unstable = [one.axis for one in trial.findings() if one.nominal and not one.stable]
    assert unstable == ["x"]
