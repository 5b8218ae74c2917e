"""LQR on the estimate of a Kalman filter of its own, both designed when the law is made; one axis at a time."""

import numpy as np
from scipy.linalg import solve_discrete_are

from hil import Law, LawInputs, Model


class Lqg(Law):
    GAINS = {"error": 1e-3, "effort": 1.0, "walk": 10.0, "noise": 3e-8}

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: float,
        error: float = 1e-3,
        effort: float = 1.0,
        walk: float = 10.0,
        noise: float = 3e-8,
    ) -> None:
        t, self.model, self.limit = period, model, force_limit
        self.mass: float = model.mass
        # State [e, de/dt, disturbance]; input: net force on the error.
        self.a = np.array([[1.0, t, -t * t / (2 * self.mass)], [0.0, 1.0, -t / self.mass], [0.0, 0.0, 1.0]])
        self.b = np.array([t * t / (2 * self.mass), t / self.mass, 0.0])
        c = np.array([[1.0, 0.0, 0.0]])
        w = np.diag([1e-18, 1e-8, walk**2 * t])
        p = solve_discrete_are(self.a.T, c.T, w, np.array([[noise**2]]))
        self.l = (p @ c.T / (c @ p @ c.T + noise**2))[:, 0]
        # The force acts one period late: it is a state of the controller's plant.
        late = np.zeros((3, 3))
        late[:2, :2], late[:2, 2] = self.a[:2, :2], self.b[:2]
        x = solve_discrete_are(late, np.eye(3)[:, 2:], np.diag([error**-2, 1e-12, 1e-12]), np.array([[effort**-2]]))
        self.k = (x[2] @ late / (effort**-2 + x[2, 2]))[:2]
        self.reset(0.0, model.gravity)

    def reset(self, position: float, force: float) -> None:
        self.x = np.array([0.0, 0.0, 0.0])
        self.known: float = self.model.gravity
        self.known_before = self.known

    def force(self, inputs: LawInputs) -> float:
        net = inputs.force_before - self.known_before
        self.x = self.a @ self.x + self.b * net
        if inputs.fresh:
            self.x = self.x + self.l * (inputs.position - inputs.sample.position - self.x[0])
        self.x[2] = min(max(self.x[2], -0.5 * self.limit), 0.5 * self.limit)
        ahead = self.a @ self.x + self.b * (inputs.force_last - self.known)
        m, v = self.model, inputs.mean_velocity
        self.known_before = self.known
        self.known = m.mass * inputs.mean_acceleration + m.coulomb * inputs.mean_sign
        self.known += (m.viscous + m.quadratic * abs(v)) * v + m.gravity
        return float(self.known + ahead[2] - self.k @ ahead[:2])
