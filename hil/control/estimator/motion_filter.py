"""One axis' motion filter: position, velocity and disturbance from encoder samples, with constant gains (gains.py)."""

from collections.abc import Sequence

from hil.control.laws.base import LawInputs
from hil.control.number import Number


class MotionFilter:
    """Constant-gain Kalman filter; `position`, `velocity`, `disturbance` are its state at the latest sample's time.

    `ahead_position` and `ahead_velocity` are the same predicted to the start of the interval in which the next force
    will act. gains: of position, velocity and disturbance; mass: kg. All are floats (one axis) or all arrays (...,
    n_axes): see hil/control/number.py. The object's arrays are new in every step.
    """

    __slots__ = (
        "_disturbance_gain", "_inverse_mass", "_position_gain", "_velocity_gain", "ahead_position", "ahead_velocity",
        "disturbance", "innovation", "position", "velocity",
    )  # fmt: skip

    def __init__(self, gains: Sequence[Number], mass: Number) -> None:
        self._position_gain, self._velocity_gain, self._disturbance_gain = gains
        self._inverse_mass = 1.0 / mass
        self.reseed(mass - mass)

    def reseed(self, position: Number) -> None:
        """At rest at `position`, without disturbance."""
        self.position = self.ahead_position = position
        self.velocity = self.disturbance = self.innovation = self.ahead_velocity = position - position

    def correct(
        self, force: Number, interval: Number, measured: Number, fresh: Number = 1.0, stretch: Number = 1.0
    ) -> None:
        """Move the state `interval` s forward under a constant input `force` (N); correct it by a sample (m).

        fresh: 1.0, or 0.0 where there is no trusted sample: the prediction stands, nothing is learnt, and the
        innovation is 0. stretch: interval since the last sample over the period the gains were designed for, at least
        1. The velocity's gain is divided by it and the disturbance's by its square, as for an alpha-beta-gamma filter:
        left as they are, they would make the filter run away.
        """
        disturbance, velocity = self.disturbance, self.velocity
        change = (force - disturbance) * self._inverse_mass * interval
        position = self.position + (change * 0.5 + velocity) * interval
        self.innovation = innovation = (measured - position) * fresh
        self.position = position + self._position_gain * innovation
        self.velocity = velocity + change + self._velocity_gain * innovation / stretch
        self.disturbance = disturbance + self._disturbance_gain * innovation / (stretch * stretch)

    def look_ahead(self, force: Number, ahead: Number) -> None:
        """Compensate the period between sample and force: predict `ahead` s under `force` (N), into ahead_*."""
        velocity = self.velocity
        change = (force - self.disturbance) * self._inverse_mass * ahead
        self.ahead_position = self.position + (change * 0.5 + velocity) * ahead
        self.ahead_velocity = velocity + change

    def tell(self, inputs: LawInputs) -> None:
        """What a law sees of this."""
        inputs.position_estimate = self.ahead_position
        inputs.velocity_estimate = self.ahead_velocity
        inputs.disturbance_estimate = self.disturbance
