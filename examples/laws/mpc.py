"""Model-predictive control with preview: all axes at once, the constraint on force met in the horizon's first step."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil import Law, LawInputs, Model

Array = NDArray[np.float64]  # (axes,)

HORIZON = 12


class PreviewMpc(Law):
    """Least squares over the next HORIZON periods of the nominal model, unconstrained but for the first force, with the
    reference as `inputs.preview` has it.
    """

    coupled = True
    preview = HORIZON
    GAINS = {"effort": 1.0, "error": 2e-4}

    def __init__(self, model: Model, period: float, force_limit: Array, effort: Any = 1.0, error: Any = 2e-4) -> None:
        self.model, self.period, self.limit = model, period, force_limit
        n, t = HORIZON, period
        masses: Array = model.mass
        efforts, errors = np.broadcast_to(effort, masses.shape), np.broadcast_to(error, masses.shape)
        steps = np.arange(1, n + 1)
        self.free = np.stack([np.ones(n), steps * t], axis=1)  # (n, 2) of error and rate now
        age = steps[:, None] - steps[None, :]
        response = np.where(age >= 0, (age + 0.5) * t * t, 0.0)  # of the position to acceleration
        self.gain: list[Array] = []
        for mass, r, q in zip(masses, efforts, errors, strict=True):
            g: Array = response / mass
            # A feedback force that decays, for the error only: the reference's own force is fed forward.
            weighted: Array = g.T @ g / q**2 + np.eye(n) / r**2
            target: Array = g.T / q**2
            self.gain.append(np.linalg.solve(weighted, target)[0])

    def reset(self, position: Array, force: Array) -> None:
        pass

    def force(self, inputs: LawInputs) -> Array:
        m = self.model
        positions = np.array([reference.position for reference in inputs.preview])
        error = inputs.position_estimate - positions[0]
        rate = inputs.velocity_estimate - inputs.start.velocity
        # The previewed path, seen from its first point along its first speed, has the curvature to come: the mean of
        # its first period is what the force must give now.
        curvature = (positions[2] - 2 * positions[1] + positions[0]) / self.period**2
        acceleration = 0.5 * (inputs.mean_acceleration + curvature)
        v = inputs.mean_velocity
        known = m.mass * acceleration + m.coulomb * inputs.mean_sign
        known = known + (m.viscous + m.quadratic * np.abs(v)) * v + m.gravity
        path = self.free @ np.stack([error, rate])  # (n, axes)
        feedback = np.array([gain @ path[:, axis] for axis, gain in enumerate(self.gain)])
        force: Array = np.clip(known - feedback, -self.limit, self.limit)
        return force
