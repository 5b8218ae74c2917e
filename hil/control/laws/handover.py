"""One law takes over from another under torque, without a step of the force."""

from collections.abc import Sequence

from hil.control.laws.base import AxisLaws, LawInputs

BLEND_S = 0.05  # s, in which the one's force goes over into the other's


class Handover:
    """AxisLaws: `old`, then more of `new` and less of `old` in every tick, and after BLEND_S `new` alone.

    In the tick in which it is first asked, the force is still the old law's, and the new one is reset with it, as a
    bumpless start. Both are told the force that acts, so what each has learnt of disturbances stays true. period_s: s.
    """

    def __init__(self, old: AxisLaws, new: AxisLaws, period_s: float) -> None:
        self._floors = old.denominator_floors
        self._old: AxisLaws | None = old.shortest() if isinstance(old, Handover) else old
        self._new = new
        self._ticks = max(1, round(BLEND_S / period_s))
        self._done = 0

    def shortest(self) -> AxisLaws:
        """What acts as this does: the old law before the first tick, the new one at the end."""
        if self._old is None:
            return self._new
        return self if self._done else self._old

    @property
    def failure(self) -> str:
        """See AxisLaws."""
        return self._new.failure or ("" if self._old is None else self._old.failure)

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws; the old law's as it was before."""
        return self._floors + self._new.denominator_floors

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """See AxisLaws; the new one begins at once."""
        self._old = None
        self._new.reset(position, force)

    def force(self, axes: Sequence[LawInputs]) -> list[float]:
        """See AxisLaws."""
        old = self._old
        if old is None:
            return self._new.force(axes)
        held = old.force(axes)
        if self._done == 0:
            self._new.reset([x.position for x in axes], held)
        asked, share = self._new.force(axes), self._done / self._ticks
        self._done += 1
        if self._done > self._ticks:
            self._old = None
        return [force + share * (asked[axis] - force) for axis, force in enumerate(held)]
