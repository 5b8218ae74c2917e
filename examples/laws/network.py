"""A small neural network in numpy: two hidden layers on error and rate, beside the nominal feedforward."""

import numpy as np

from hil import Law, LawInputs, Model

WIDTH = 8


class Network(Law):
    """The weights make a PD loop that saturates smoothly; a trained network has the same shape."""

    GAINS = {"stiffness": 0.0, "damping": 0.0, "reach": 0.4}

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: float,
        stiffness: float = 0.0,
        damping: float = 0.0,
        reach: float = 0.4,
    ) -> None:
        self.model = model
        omega = 0.25 / period
        mass: float = model.mass
        kp = stiffness or mass * omega**2
        kd = damping or 1.4 * mass * omega
        self.out = reach * force_limit
        scale = np.linspace(0.5, 1.5, WIDTH)
        self.first = np.outer(scale, [kp, kd]) / self.out
        self.second = np.eye(WIDTH)
        self.last = np.full(WIDTH, self.out / scale.sum())

    def reset(self, position: float, force: float) -> None:
        pass

    def force(self, inputs: LawInputs) -> float:
        error = inputs.position_estimate - inputs.start.position
        rate = inputs.velocity_estimate - inputs.start.velocity
        hidden = np.tanh(self.first @ np.array([error, rate]))
        feedback = self.last @ np.tanh(self.second @ hidden)
        m, v = self.model, inputs.mean_velocity
        known = m.mass * inputs.mean_acceleration + m.coulomb * inputs.mean_sign
        known = known + (m.viscous + m.quadratic * abs(v)) * v + m.gravity
        return float(known - feedback)
