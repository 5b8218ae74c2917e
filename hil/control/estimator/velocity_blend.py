"""The velocity shown of one axis: of three estimates, each good where the others are not, weighed by how well each has
foretold the latest samples.

- the rig's Kalman filter (motion_filter.py): knows the force; wrong where friction is not as its model says.
- a filter that expects the motion to go as the reference does (alpha-beta, Kalata, IEEE TAES 20(2), 1984): best where
  the law follows closely, whatever friction does; late where it does not.
- one that expects nothing: best where neither force nor reference say what the axis does, as where it sticks. Its gains
  are the limit of the Kalman filter on white acceleration; a finite difference has beta = 1, and lags by half a period.

Each weight falls with the fourth power of the error that its predictions of the position had (RMS, forgotten within a
few ticks). No law acts on this: a loop whose filter depends on the motion has no margins that could be stated, and on
the paper's stage PD loops err less with the filter alone, whose error at a reversal pushes the right way.
"""

from typing import Final

from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws.base import LawInputs
from hil.control.number import Number, anywhere, select

FORGETTING: Final = 0.7  # of the squared errors, from one tick to the next
ALPHA: Final = 0.9  # of the filter on the reference: shares of the innovation, for position and velocity
BETA: Final = 0.8
BETA_ALONE: Final = 1.2679491924311228  # 3 - sqrt(3), with alpha = 1


def expected_acceleration(inputs: LawInputs) -> Number:
    """Of the reference from the latest sample to the next one, m/s^2; before the setpoints move on."""
    return 0.5 * (inputs.sample.acceleration + inputs.start.acceleration)


class VelocityBlend:
    """velocity: m/s, at the latest sample's time. Floats (one axis) or arrays, as MotionFilter."""

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
        self.velocity: Number = position - position
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
        coaster.correct(expected - expected, interval, measured, fresh, stretch)
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
