"""Friction that varies with a known period: the sine, what is learnt of it, and what an axis without one does."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.control.laws.base import Array, Model
from hil.control.laws.friction_wave import WAVES, FrictionWave, sine
from hil.control.laws.motion_observer import MotionModel
from hil.control.laws.presliding_kalman import KEPT
from hil.rig.file import load_rig
from hil.rig.schema import ModelConfig, RigConfig
from hil.studies.evidence.stages import nominal, only, stage_of
from hil.studies.evidence.trials import LONG, TRIALS, columns, trajectory_of
from hil.studies.population import run
from hil.virtual.batch import FIRST_ON_TASK, BatchRun
from sim_plant.physics.truth import Truth
from tests.support.paths import RIGS

STROKE = 500  # ticks
MICROSCOPE = nominal(load_rig(RIGS / "microscope.toml"), 0.0)
X = only(MICROSCOPE, ["x"])


def stated(rig: RigConfig, period: float) -> RigConfig:
    """With this period in X's model."""
    x = rig.axes["x"]
    known = x.model_copy(update={"model": x.model.model_copy(update={"friction_period": period})})
    return rig.model_copy(update={"axes": {**rig.axes, "x": known}})


def strokes(rig: RigConfig, period: float, count: int, variation: float = 0.1) -> tuple[Array, BatchRun]:
    """RMS error of strokes of 20 mm, m, on a drawn stage whose friction varies over this period."""
    truth: Truth = columns(stage_of(MICROSCOPE, 7, 0, 0.0), [0])
    varied = {"friction_variation": variation, "friction_period": period, "friction_phase": 1.0}
    truth = Truth.stack([replace(truth, **{name: np.array([value]) for name, value in varied.items()})])
    batch = BatchRun(rig, truth, trajectory_of(rig, next(trial for trial in TRIALS if trial.name == LONG)))
    error = np.zeros((count, STROKE))

    def after(tick: int) -> None:
        if tick >= 0:
            error[tick // STROKE, tick % STROKE] = batch.error[0, 0]

    run(batch, range(-FIRST_ON_TASK, count * STROKE), lambda tick: None, after)
    rms: Array = np.sqrt((error * error).mean(axis=1))
    return rms, batch


def test_the_sine_is_a_sine() -> None:
    turns = np.linspace(-50.0, 50.0, 20_001)
    assert np.abs(np.asarray(sine(turns)) - np.sin(2.0 * np.pi * turns)).max() < 3e-4
    assert [sine(value) for value in turns[:500].tolist()] == np.asarray(sine(turns[:500])).tolist()
    assert math.isnan(sine(math.nan))


@pytest.mark.long
@pytest.mark.parametrize("period", [0.6e-3, 1.7e-3])
def test_friction_of_a_known_period_is_learnt_within_strokes(period: float) -> None:
    """The table alone leaves more than 10 times as much of 0.6 mm."""
    without, _ = strokes(X, period, 6)
    rms, batch = strokes(stated(X, period), period, 6)
    smooth, _ = strokes(X, 20e-3, 6)
    assert rms[-1] < 0.2 * without[-1]
    assert rms[-1] < 1.3 * smooth[-1]
    amplitudes = np.array([float(value[0, 0]) for value in batch.law.learnt_state()[-WAVES:]])
    size = 0.1 * float(stage_of(MICROSCOPE, 7, 0, 0.0).coulomb[0])
    assert np.hypot(*amplitudes[:2]) == pytest.approx(size, rel=0.15)
    assert np.hypot(*amplitudes[2:]) == pytest.approx(size, rel=0.15)
    assert amplitudes[:2] == pytest.approx(-amplitudes[2:], abs=0.4 * size), "friction: its sign follows the motion"


def test_a_run_that_begins_with_what_was_learnt_needs_no_stroke() -> None:
    rig = stated(X, 0.9e-3)
    rms, batch = strokes(rig, 0.9e-3, 4)
    state = [float(np.ravel(value)[0]) for value in batch.law.learnt_state()]
    assert len(state) == KEPT
    begun = rig.model_copy(update={"law": rig.law.model_copy(update={"learnt_state": [state]})})
    again, _ = strokes(begun, 0.9e-3, 1)
    assert again[0] < 0.5 * rms[0]


def test_a_period_that_the_table_resolves_changes_no_bit() -> None:
    plain, batch = strokes(X, 5e-3, 1)
    same, other = strokes(stated(X, 4e-3), 5e-3, 1)
    assert same.tolist() == plain.tolist()
    assert np.array(other.law.learnt_state()).tolist() == np.array(batch.law.learnt_state()).tolist()


def test_where_a_period_passes_within_a_few_ticks_nothing_is_fed_forward() -> None:
    wave = FrictionWave(1e-3, 1e-3, 0.5, MotionModel(Model(0.9, 0.5, 0.0, 0.0, 0.0, 2e-4), 1e-3))
    wave.fill([0.05, 0.0, -0.05, 0.0])
    assert wave.force(0.25e-3, 0.24e-3, 1.0) == pytest.approx(0.05, rel=1e-3)
    assert wave.force(0.25e-3, -0.24e-3, 0.0) == pytest.approx(-0.05, rel=1e-3)
    assert wave.force(0.25e-3, 0.26e-3, 1.0) == 0.0


def test_a_period_below_a_micrometre_is_refused() -> None:
    with pytest.raises(ValueError, match="friction_period = 1e-07: allowed: 0, or 1e-06 and more"):
        ModelConfig(mass=1.0, friction_period=1e-7)
