"""An estimator that says what the rig's own filter says, and writes down what it is told."""

from hil import Estimator


class Notes(Estimator):
    told = []  # noqa: RUF012 - of all objects: (id, position of a reset or measurement)
    made = []  # noqa: RUF012

    def __init__(self, model, period, resolution):
        self.made.append((model, period, resolution))

    def reset(self, position):
        self.told.append((id(self), position))

    def update(self, measurement):
        self.told.append((id(self), measurement))
        return measurement.position_estimate, measurement.velocity_estimate
