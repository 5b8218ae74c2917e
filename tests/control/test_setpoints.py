"""Setpoints of a tick: the references of its instants, however they were come by."""

import random

import numpy as np
import pytest

from hil.control.laws.base import Reference, axis_inputs
from hil.control.setpoints import Setpoints
from hil.control.trajectories import make_trajectory
from hil.rig.schema import TaskConfig

PERIOD = 1_000_000
TASKS = [
    TaskConfig(),
    TaskConfig(kind="circle", axes=["x", "y"], radius=0.5, frequency_hz=0.5, approach_s=0.01),
    TaskConfig(kind="point_to_point", axes=["y"], target=[0.2], move_s=0.5, dwell_s=0.25),
    TaskConfig(kind="path", axes=["y"], samples=[[0.0, 0.0], [0.5, 0.01], [1.0, 0.03], [2.0, 0.0]], approach_s=0.02),
]


@pytest.mark.parametrize("preview", [0, 3])
def test_setpoints_are_those_of_their_instants_whatever_was_asked_for_before(preview: int) -> None:
    """What the tick before has computed is not computed again: numbers must not tell, however tasks and ticks go."""
    draw = random.Random(preview)
    inputs = [axis_inputs(), axis_inputs()]
    for x in inputs:
        x.preview = [Reference(0.0, 0.0, 0.0) for _ in range(preview)]
    setpoints, now = Setpoints(inputs, PERIOD), 0
    for _ in range(400):
        now += draw.choice((1, 1, 1, 1, 0, 2, 700)) * PERIOD + draw.choice((0, 0, 0, 0, 1))
        if setpoints.trajectory is None or draw.random() < 0.2:
            task, start = draw.choice(TASKS), np.array([draw.random(), draw.random()])
            origin = [now + draw.choice((0, PERIOD, -PERIOD)) for _ in inputs]
            setpoints.follow(make_trajectory(task, ["x", "y"], start, PERIOD), origin)
        acts = PERIOD + draw.choice((0, 0, 0, 300))
        setpoints.update([now, now], [now + acts, now + acts])
        trajectory = setpoints.trajectory
        assert trajectory is not None
        for axis, x in enumerate(inputs):
            sampled, begins = now - setpoints.origin[axis], now + acts - setpoints.origin[axis]
            instants = [sampled, begins, begins + PERIOD, *(begins + k * PERIOD for k in range(preview))]
            seen = [(r.position, r.velocity, r.acceleration) for r in (x.sample, x.start, x.end, *x.preview)]
            assert seen == [trajectory.at(axis, instant) for instant in instants]
            assert x.task_ns == begins
            assert x.mean_velocity == (x.end.position - x.start.position) / (PERIOD * 1e-9)
            assert x.mean_acceleration == (x.end.velocity - x.start.velocity) / (PERIOD * 1e-9)
        assert setpoints.task_ns == now - setpoints.origin[0]
