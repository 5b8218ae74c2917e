"""The motions that velocity estimators are compared on: the rig's own task, small circles, moves, rest, friction by
distance, and samples that come late.
"""

from pathlib import Path
from typing import Any

import numpy as np

from hil.control.estimator.gains import filter_parameters
from hil.control.laws import make_law
from hil.control.laws.base import Array, Model
from hil.control.laws.coupled import gather
from hil.control.laws.structured_kalman import StructuredKalman
from hil.control.nominal_model import rig_model
from hil.rig.schema import LawConfig, RigConfig
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import steady_from

RADIUS, FREQUENCY_HZ = 3e-3, 1.7  # m (rad), of the small circle
MOVE, MOVE_S = 1e-3, 0.3  # m (rad), of a minimum-jerk move
JITTER_S = 5e-5
PRESLIDING = 1e-5  # m (rad): the order of ball and crossed-roller guides


def cases_of(rig: RigConfig) -> dict[str, RigConfig]:
    """The rig with each motion, by name. A rig of one axis has moves in place of circles."""
    axes = list(rig.axes.values())
    room = min(min(-axis.limits.position[0], axis.limits.position[1]) for axis in axes)
    fastest = min(axis.limits.speed for axis in axes)
    radius = max(min(RADIUS, 0.4 * room, 0.4 * fastest / (2.0 * np.pi * FREQUENCY_HZ)), 1e-9)
    names = rig.axis_names
    at = rig.plant.initial_position
    start = at if isinstance(at, list) else [at] * len(axes)
    moves: dict[str, Any] = {
        "kind": "point_to_point", "axes": names, "target": [q + min(MOVE, radius) for q in start],
        "move_s": MOVE_S, "dwell_s": 0.2, "approach_s": 0.5, "settle_s": 0.5,
    }  # fmt: skip
    circle = moves
    if len(axes) > 1:
        circle = {"kind": "circle", "axes": names[:2], "radius": radius, "frequency_hz": FREQUENCY_HZ,
                  "approach_s": 0.5, "settle_s": 0.5}  # fmt: skip

    def with_task(task: dict[str, Any], plant: dict[str, Any] | None = None) -> RigConfig:
        return rig.model_copy(
            update={"task": rig.task.model_copy(update=task), "plant": rig.plant.model_copy(update=plant or {})}
        )

    guide = {"presliding": PRESLIDING}
    late = with_task(circle)
    return {
        "own task": rig,
        "small circle": with_task(circle),
        "moves": with_task(moves),
        "rest": with_task({"kind": "hold", "settle_s": 0.5}),
        "small circle, presliding": with_task(circle, guide),
        "rest, presliding": with_task({"kind": "hold", "settle_s": 0.5}, guide),
        "small circle, jitter": late.model_copy(update={"wire": late.wire.model_copy(update={"jitter": JITTER_S})}),
    }


class Data:
    """Of one run, steady window only, arrays (ticks, n_axes): position as measured, setpoint and its velocity, true
    velocity, net force (applied force less nominal friction) and length (s) of the interval before each sample. Then
    velocity as the structured filter has it, as laws see it and as it is shown.

    The length is by the samples' stamps: stuff bits alone move a command by a microsecond, and at 3 m/s that is 3 um.
    """

    def __init__(self, rig: RigConfig, base_dir: Path, seconds: float) -> None:
        run = LockstepRun(rig, base_dir)
        model = rig_model(rig)
        watcher = _structured_filter(rig)
        rows: list[Array] = []
        for _ in range(round(seconds * rig.rate_hz)):
            run.tick()
            cycle = run.cycle
            inputs = gather(cycle.inputs)
            if run.index - 1 <= run.activated_at or run.activated_at < 0:
                watcher.reset(inputs.position.copy(), model.gravity)
            if run.activated_at >= 0:
                watcher.force(inputs)
            rows.append(
                np.stack(
                    [inputs.position, inputs.sample.position, inputs.sample.velocity, run.true_velocity,
                     inputs.force_before, inputs.sample_interval, inputs.sample.velocity + watcher.error_rate,
                     [motion.velocity for motion in cycle.filters], [shown.velocity for shown in cycle.axes.shown]]
                )
            )  # fmt: skip
        first = steady_from(run, len(rows))
        columns = np.moveaxis(np.array(rows[first:]), 1, 0)
        self.position, self.setpoint, self.reference, self.truth, force, self.interval, *estimates = columns
        self.structured, self.for_laws, self.shown = estimates
        self.state = run.cycle.state.name
        self.period = rig.period_ns * 1e-9
        self.net = force - _nominal_friction(model, self.reference) - model.gravity
        self.model = model
        self.parameters = filter_parameters(rig)


def _structured_filter(rig: RigConfig) -> StructuredKalman:
    config = LawConfig(name="structured-kalman", tuned=rig.law.tuned)
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    law = make_law(config, rig_model(rig), rig.period_ns * 1e-9, limit)
    assert isinstance(law, StructuredKalman)
    return law


def _nominal_friction(model: Model, velocity: Array) -> Array:
    before = np.vstack([velocity[:1], velocity[:-1]])
    total = np.abs(before) + np.abs(velocity)
    sign = (before + velocity) / np.maximum(total, 1e-300)
    mean = 0.5 * (before + velocity)
    friction: Array = model.coulomb * sign + model.viscous * mean + model.quadratic * mean * np.abs(mean)
    return friction
