"""The rig's own motion filter as a user would write it from its equations: what the law sees must not change by it."""

from hil import Estimator


class HonestFilter(Estimator):
    """gains: of position, velocity and disturbance, each a number or one per axis."""

    def __init__(self, model, period, resolution, position_gain, velocity_gain, disturbance_gain):
        self.mass, self.period = model.mass, period
        self.gains = position_gain, velocity_gain, disturbance_gain

    def reset(self, position):
        self.q, self.v, self.d = position, 0.0, 0.0

    def update(self, measurement):
        m = measurement
        stretch = m.interval / self.period if m.interval > 1.5 * self.period else 1.0
        predicted, speed = self.moved(m.net_force, m.interval)
        error = m.position - predicted if m.fresh else 0.0
        self.q = predicted + self.gains[0] * error
        self.v = speed + self.gains[1] * error / stretch
        self.d += self.gains[2] * error / stretch**2
        return self.moved(m.next_net_force, m.ahead)

    def moved(self, force, seconds):
        acceleration = (force - self.d) / self.mass
        return self.q + self.v * seconds + 0.5 * acceleration * seconds**2, self.v + acceleration * seconds
