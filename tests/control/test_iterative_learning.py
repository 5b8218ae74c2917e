"""Iterative learning around a law: what comes back every repeat goes away, and nothing is learnt that is not there."""

import numpy as np
import pytest

from hil.control.laws import make_law
from hil.control.laws.iterative_learning import IterativeLearning
from hil.control.nominal_model import blank_inputs
from hil.rig.file import load_rig
from hil.rig.schema import LawConfig
from hil.virtual.sim import simulate
from tests.control.test_laws import LIMIT, PERIOD, law, model
from tests.support.paths import RIGS


def test_learning_needs_a_task_that_repeats_on_the_grid_and_before_memory_ends() -> None:
    with pytest.raises(ValueError, match="does not repeat"):
        make_law(LawConfig(iterative_learning=True), model(), PERIOD, LIMIT)
    with pytest.raises(ValueError, match="not a multiple"):
        make_law(LawConfig(iterative_learning=True), model(), PERIOD, LIMIT, repeat=(1_000_500, 0))
    with pytest.raises(ValueError, match="repeats every 100001 ticks; at most 100000 can be learnt"):
        make_law(LawConfig(iterative_learning=True), model(), PERIOD, LIMIT, repeat=(100_001_000_000, 0))


def test_learning_removes_what_comes_back_every_repeat() -> None:
    """PD holds a mass against a force that repeats every 50 ticks; ten repeats later a tenth of the error is left."""
    gains = {"kp": 1500.0, "kd": 8.0, "learning_kp": 1500.0, "learning_kd": 8.0}
    controller = law("learning", np.zeros(2), **gains)
    assert isinstance(controller, IterativeLearning)
    controller.reset(np.zeros(2), np.zeros(2))
    mass = model().mass
    position, velocity, last, before = (np.zeros(2) for _ in range(4))
    largest = []
    for k in range(50 * 20):
        inputs = blank_inputs((2,))
        inputs.position = position.copy()
        inputs.fresh[:] = 1.0
        inputs.task_ns = k * 1_000_000
        inputs.force_last, inputs.force_before = last.copy(), before.copy()
        disturbance = 0.3 * np.sin(2 * np.pi * (k - 1) / 50) * np.ones(2)
        change = (last - disturbance) / mass * PERIOD
        position = position + (velocity + 0.5 * change) * PERIOD
        velocity = velocity + change
        inputs.position_estimate, inputs.velocity_estimate = position, velocity
        last, before = controller.force(inputs).copy(), last
        largest.append(np.abs(position).max())
    assert max(largest[-50:]) < 0.1 * max(largest[50:100])


@pytest.mark.long
def test_structured_kalman_inside_learning_meets_what_neither_meets_alone() -> None:
    """Ripple that the model does not know; what is learnt is told to the filter, or both would diverge."""
    changes = ["task.radius=0.1", "task.approach_s=0.5", "task.settle_s=0.5", "plant.modelling_error=0.3"]
    changes += ["law.name=structured-kalman", "plant.ripple_amplitude=0.05", "plant.ripple_period=0.05"]
    alone, _ = simulate(load_rig(RIGS / "paper.toml", changes), RIGS, 3.0)
    both, _ = simulate(
        load_rig(RIGS / "paper.toml", [*changes, "law.iterative_learning=true", "task.settle_s=14"]), RIGS, 17.0
    )
    for axis in ("x", "y"):
        assert both.axes[axis]["max_error"] < min(0.5e-6, 0.5 * alone.axes[axis]["max_error"])
