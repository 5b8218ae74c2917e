"""A rig's law on plain floats, one law object an axis."""

from collections.abc import Sequence

from hil.control.laws.base import Law, LawInputs


class PerAxis:
    """AxisLaws that know nothing of each other."""

    def __init__(self, laws: Sequence[Law]) -> None:
        self.laws = list(laws)
        self.failure = ""

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """See AxisLaws."""
        for law, q, tau in zip(self.laws, position, force, strict=True):
            law.reset(q, tau)

    def force(self, axes: Sequence[LawInputs]) -> list[float]:
        """See AxisLaws."""
        return [law.force(axes[axis]) for axis, law in enumerate(self.laws)]

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws."""
        floors = 0
        for law in self.laws:
            floors += law.denominator_floors
        return floors
