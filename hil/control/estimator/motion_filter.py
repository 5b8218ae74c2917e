"""One axis' motion filter: position, velocity and disturbance from encoder samples, with constant gains (gains.py);
and the velocity that people are shown.
"""

from collections.abc import Sequence
from typing import Final

from hil.control.laws.base import LawInputs
from hil.control.number import Number, anywhere, select, zeros_like

FORGETTING: Final = 0.7  # of the squared errors, from one tick to the next
ALPHA: Final = 0.9  # of the filter on the reference: shares of the innovation, for position and velocity
BETA: Final = 0.8
BETA_ALONE: Final = 1.2679491924311228  # 3 - sqrt(3), with alpha = 1


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
        self.reseed(zeros_like(mass))

    def reseed(self, position: Number) -> None:
        """At rest at `position`, without disturbance."""
        self.position = self.ahead_position = position
        self.velocity = self.disturbance = self.innovation = self.ahead_velocity = zeros_like(position)

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


def expected_acceleration(inputs: LawInputs) -> Number:
    """Of the reference from the latest sample to the next one, m/s^2; before the setpoints move on."""
    return 0.5 * (inputs.sample.acceleration + inputs.start.acceleration)


class VelocityBlend:
    """The velocity shown of one axis, m/s at the latest sample, blended of three estimates, each good where the others
    are not:

    - the Kalman filter above: knows the force; wrong where friction is not as its model says.
    - one that expects the motion to go as the reference does (alpha-beta, Kalata, IEEE TAES 20(2), 1984): best where
      the law follows closely, whatever friction does; late where it does not.
    - one that expects nothing: best where neither force nor reference say what the axis does, as where it sticks. Its
      gains are the limit of the Kalman filter on white acceleration; a finite difference has beta = 1.

    Each weight falls with the fourth power of the error that its predictions of the position had (RMS, forgotten within
    a few ticks). No law acts on this: a loop whose filter depends on the motion has no margins that could be stated. On
    the paper's stage PD loops err less with the filter alone, whose error at a reversal pushes the right way. Floats
    (one axis) or arrays, as MotionFilter.
    """

    __slots__ = ("_coaster", "_errors_alone", "_errors_followed", "_errors_known", "_follower", "velocity")

    def __init__(self, still: Number, period: float) -> None:
        """still: 0.0, or an array of zeros. period: s."""
        one = still + 1.0
        self._follower = MotionFilter((still + ALPHA, still + BETA / period, still), one)
        self._coaster = MotionFilter((one, still + BETA_ALONE / period, still), one)
        self.reseed(still)

    def reseed(self, position: Number) -> None:
        """At rest at `position` (m)."""
        self._follower.reseed(position)
        self._coaster.reseed(position)
        self.velocity: Number = zeros_like(position)
        self._errors_known: Number = self.velocity
        self._errors_followed: Number = self.velocity
        self._errors_alone: Number = self.velocity

    def take(
        self, known: MotionFilter, expected: Number, interval: Number, measured: Number, fresh: Number, stretch: Number
    ) -> None:
        """The sample (m) that `known` has just been corrected by. expected: the reference's acceleration, m/s^2; the
        others as of MotionFilter.correct.
        """
        follower, coaster = self._follower, self._coaster
        follower.correct(expected, interval, measured, fresh, stretch)
        coaster.correct(zeros_like(expected), interval, measured, fresh, stretch)
        a = self._errors_known = FORGETTING * self._errors_known + known.innovation * known.innovation
        b = self._errors_followed = FORGETTING * self._errors_followed + follower.innovation * follower.innovation
        c = self._errors_alone = FORGETTING * self._errors_alone + coaster.innovation * coaster.innovation
        a, b, c = a * a, b * b, c * c
        first, second, third = b * c, a * c, a * b
        total = first + second + third
        certain = total > 0.0  # none has been wrong, or one has not for long: they agree
        blended = first * known.velocity + second * follower.velocity + third * coaster.velocity
        if anywhere(certain):
            self.velocity = select(certain, blended / select(certain, total, 1.0 + total), known.velocity)
        else:
            self.velocity = known.velocity
