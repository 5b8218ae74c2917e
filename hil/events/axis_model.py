"""What is known of an axis beforehand, and what its model says of a few ticks: what can be force, and what cannot."""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROTARY: Final = {"m": "rad", "m/s": "rad/s", "N": "N m"}  # units of a rotary axis, by those of a linear one

_BEFORE: Final = 8  # ticks whose forces count
_MARGIN: Final = 4.0  # a tool on a spring leaves the encoder's side lighter
_UNSURE: Final = 0.25  # of a period, that a sample's instant may be off by
_JUMP: Final = 100.0  # counts
_SURE: Final = 1000.0  # counts: less is no jump because it is new
_SEEN: Final = 5.0  # times the largest that was seen
_BACK: Final = 0.5  # of a step, that the tick beside it takes back


class AxisModel(NamedTuple):
    """SI units. resolution: a count. dry, wet: friction. gravity: as it acts."""

    resolution: float
    mass: float
    dry: float
    wet: float
    gravity: float


def axis_models(axes: Mapping[str, Mapping[str, Any]]) -> list[AxisModel]:
    """From the tables [axes.NAME] of a validated rig."""
    found = []
    for axis in axes.values():
        model = axis["model"]
        known = (model["mass"], model["coulomb"], model["viscous"], model["gravity"])
        found.append(AxisModel(float(axis["encoder_resolution"]), *map(float, known)))
    return found


class Steps(NamedTuple):
    """size, most: of the position at each tick from the third on, (n - 2,), m. sudden: whether it is the position that
    stepped, and not the speed.
    """

    size: Floats
    most: Floats
    sudden: NDArray[np.bool_]

    @property
    def beyond(self) -> int:
        """How many are too large: of a jump a few, of noise many."""
        return int(np.count_nonzero((self.size > self.most) & self.sudden))

    @property
    def good(self) -> bool:
        """Whether none is too large, sudden or not: a push makes an axis gain more speed than its own force can."""
        return not np.any(self.size > self.most)

    @property
    def worst(self) -> tuple[float, float]:
        """(size, most) of the sudden one that is furthest beyond."""
        at = int(np.argmax(np.where(self.sudden, self.size - self.most, -np.inf)))
        return float(self.size[at]), float(self.most[at])


def steps(
    model: AxisModel, period_s: float, position: Floats, force: Floats, velocity: Floats, seen: float = np.inf
) -> Steps:
    """Acceleration times a period squared, and what can act on the axis: forces of the ticks just before, friction,
    gravity, and what the instant of a sample may be off by. Arrays position, force, set-point's velocity: (n,), n > 2.
    seen: the largest step of good ticks, which tells that instant's error and the tool's mass better than the model.
    """
    change, size = np.diff(position, 2), np.abs(force)
    acting = sliding_window_view(np.concatenate((np.full(_BEFORE, size[0]), size)), _BEFORE).max(axis=1)[2:-1]
    known = (acting + model.dry + abs(model.gravity)) * period_s**2 / model.mass
    least = _JUMP * model.resolution
    most = _MARGIN * known + _UNSURE * period_s * np.abs(velocity)[2:] + least
    bound = np.minimum(most, np.maximum(known + _SURE * model.resolution, _SEEN * seen))
    return Steps(np.abs(change), bound, _sudden(change))


def in_step(position: Floats, velocity: Floats, instants: Floats, period_s: float) -> Floats:
    """Positions as they would be a period apart, m. Of drives that send in their own time a tick now and then brings a
    sample that is a whole one early or late; where none does, `position` itself. Arrays (n,): m, m/s, s.
    """
    late = instants - instants[0] - period_s * np.arange(len(instants))
    if np.ptp(np.diff(late)) < 0.5 * period_s:
        return position
    moved: Floats = position - velocity * late
    return moved


def _sudden(change: Floats) -> NDArray[np.bool_]:
    """Where a tick beside takes half of it back, or is not known. change: second difference of the position, (n,), m.

    A position that steps changes by the step, then by its opposite. An axis that is pushed goes on gaining speed.
    """
    size, sign = np.abs(change), np.sign(change)
    edge = np.array([np.inf])
    before = np.concatenate((edge, -change[:-1] * sign[1:]))
    after = np.concatenate((-change[1:] * sign[:-1], edge))
    found: NDArray[np.bool_] = np.maximum(before, after) >= _BACK * size
    return found
