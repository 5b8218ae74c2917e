"""A linear-quadratic regulator on the tracking error, its gains by the discrete algebraic Riccati equation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from hil import Gain, Knob, Law, LawInputs, Model


class Lqr(Law):
    """tau = feedforward - K [e, de/dt], K by DARE on the double integrator of the nominal mass with a force that comes
    one period late (the third state).
    """

    elementwise = True
    GAINS = {
        "error": Gain(4e-4, "m", "error worth as much as the force", least=1e-9, tune=Knob(1e-5, 1e-2)),
        "effort": Gain(1.0, "N", "force worth as much as the error", least=1e-9, tune=Knob(0.1, 10.0)),
    }

    def __init__(self, model: Model, period: float, force_limit: Any, error: Any = 4e-4, effort: Any = 1.0) -> None:
        self.model = model
        gains = np.vectorize(self.design, excluded=[1], signature="(),(),()->(k)")
        found = gains(model.mass, period, error, effort)
        self.kp, self.kd = found[..., 0], found[..., 1]
        if np.ndim(model.mass) == 0:
            self.kp, self.kd = float(self.kp), float(self.kd)

    @staticmethod
    def design(mass: float, period: float, error: float, effort: float) -> NDArray[np.floating[Any]]:
        a = np.array([[1.0, period, period**2 / (2 * mass)], [0.0, 1.0, period / mass], [0.0, 0.0, 0.0]])
        b = np.array([[0.0], [0.0], [1.0]])
        q, r = np.diag([1.0 / error**2, 1e-12, 1e-12]), np.array([[1.0 / effort**2]])
        p = solve_discrete_are(a, b, q, r)
        return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)[0, :2]

    def reset(self, position: Any, force: Any) -> None:
        pass

    def force(self, inputs: LawInputs) -> Any:
        m, v = self.model, inputs.mean_velocity
        known = m.mass * inputs.mean_acceleration + m.coulomb * inputs.mean_sign
        known = known + (m.viscous + m.quadratic * abs(v)) * v + m.gravity
        error = inputs.position_estimate - inputs.start.position
        rate = inputs.velocity_estimate - inputs.start.velocity
        return known - self.kp * error - self.kd * rate
