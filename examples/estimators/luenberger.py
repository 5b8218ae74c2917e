"""An observer of position, velocity and disturbance whose three poles are one: a bandwidth in place of noises."""

import math

from hil import Estimator, Measurement, Model


class Luenberger(Estimator):
    """bandwidth_hz: of the observer, Hz; a list has one for each axis. Gains: Brookner, Tracking and Kalman Filtering
    Made Easy (1998), critically damped g-h-k filter.
    """

    def __init__(self, model: Model, period: float, resolution: float, bandwidth_hz: float = 60.0) -> None:
        if not 0.0 < bandwidth_hz <= 0.25 / period:
            raise ValueError(f"bandwidth_hz = {bandwidth_hz}: above 0, at most {0.25 / period:g}")
        pole = math.exp(-2.0 * math.pi * bandwidth_hz * period)
        self.mass: float = model.mass
        self.g = 1.0 - pole**3
        self.h = 1.5 * (1.0 - pole) ** 2 * (1.0 + pole) / period
        self.k = (1.0 - pole) ** 3 / period**2

    def reset(self, position: float) -> None:
        self.position, self.velocity, self.push = position, 0.0, 0.0  # m, m/s, m/s^2: of what no model knows

    def update(self, measurement: Measurement) -> tuple[float, float]:
        m = measurement
        self.position, self.velocity = self.moved(m.net_force, m.interval)
        error = (m.position - self.position) * m.fresh
        self.position += self.g * error
        self.velocity += self.h * error
        self.push += self.k * error
        return self.moved(m.next_net_force, m.ahead)  # where the law's force will begin to act

    def moved(self, force: float, seconds: float) -> tuple[float, float]:
        acceleration = force / self.mass + self.push
        speed = self.velocity + acceleration * seconds
        return self.position + 0.5 * (self.velocity + speed) * seconds, speed
