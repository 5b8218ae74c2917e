"""The start of a move from rest: friction holds an axis until the force exceeds what nobody knows yet.

Until then the axis says only that friction holds. Gravity's misfit and friction's cannot be told apart before it has
slid in both directions. A filter that takes "it has not moved" for agreement grows sure of what it never saw. So while
the reference leads and the axis still stands where it rested, the force creeps up until it slides. A breakaway force is
measured so (Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994, section 5).
"""

from typing import Any

from hil.control.laws.structured_filter import TINY, Covariance
from hil.control.number import Number, at_least, copy, select, zeros_like


def anywhere(condition: Any) -> bool:
    """Whether a condition holds for the one axis or for any of many."""
    return condition if isinstance(condition, bool) else bool(condition.any())


class Breakaway:
    """Of one axis (floats), or of many (arrays of one shape).

    rate: N/s, of the creep; 0: none, and nothing is ever held back. lag: m, how far the reference must lead before the
    force creeps, and how far the axis must have gone to have broken away: beyond noise, above a count.
    """

    def __init__(self, rate: Number, lag: Number) -> None:
        self._rate, self._lag = rate, lag
        self.ever = anywhere(rate > 0.0)
        self.reset(zeros_like(rate))

    def reset(self, position: Number) -> None:
        """At rest at `position`, m."""
        self._held = copy(position)
        self._slides = position != position  # nowhere

    def watch(self, position: Number, fresh: Number, before: Number, after: Number) -> tuple[Any, Any, Number]:
        """The newest sample (m, where it is fresh) and the reference's speeds at both ends of the interval before it.
        Returns where the reference rests, where it has left rest and the axis has not, and where the axis stands, m.
        """
        moves = (before != 0.0) | (after != 0.0)
        if moves is True and self._slides is True:
            return False, False, position  # one axis under way, as mostly
        acts = self._rate > 0.0
        seen = select(fresh != 0.0, position, self._held)
        self._held = select(moves, self._held, seen)
        self._slides = (self._slides | (abs(seen - self._held) > self._lag)) & moves
        return (moves == 0) & acts, moves & (self._slides == 0) & acts, seen

    def creep(self, error: Number, velocity: Number, time: Number, p: Covariance) -> tuple[Number, Number]:
        """What bias and friction grow by, N, in `time` s of an axis that stands with that error (m) against a reference
        of that velocity (m/s).

        Shared as P says what the force that is missing, d0 + theta1 sgn(v), is made of: after a move in one direction,
        so that what is known of that direction stays as it is.
        """
        step = self._rate * time
        step = select(error * velocity < -self._lag * abs(velocity), step, zeros_like(step))
        sign = select(velocity < 0.0, -1.0, 1.0)
        both = sign * p[12]
        bias, dry = at_least(p[11] + both, 0.0), at_least(p[15] + both, 0.0)
        step = step / (bias + dry + TINY)
        return sign * (step * bias), step * dry
