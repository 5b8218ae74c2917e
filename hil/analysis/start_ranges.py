"""Where a task may begin: the range of positions, per axis, from which it keeps every limit (see feasibility.py).

Worked out once, when a control process starts, so that ACTIVATE costs a comparison per axis.

Rules:
- A range holds what `violations` of feasibility.py accepts, to a millionth of the travel.
- Axes do not depend on each other, so each has a range of its own; all axes must be within theirs.

Theory of operation: at any instant a task's position, velocity and acceleration are affine in the position where the
axis began. Minimum-jerk approaches are linear in it, and what follows them does not depend on it. Two plans, from
either end of the travel, so give the motion from everywhere. By how much it exceeds its limits is convex in the place:
travel with the way to stop, speed and smooth force are. The jump of Coulomb friction where a velocity changes sign is
not, and FORCE_MARGIN covers it. So where both ends are accepted all between them is; else the least excess is looked
for, and from there the borders, by bisection.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from hil.analysis.feasibility import CHUNK, horizon, measures, too_quick, travel_margin
from hil.control.laws.base import Array
from hil.control.trajectories import Trajectory, plan_task
from hil.rig.schema import RigConfig
from hil.rig.tables import AxisConfig

CANDIDATES = 17  # looked at together while the least excess is looked for
NARROWINGS = 5  # each to an eighth
BISECTIONS = 20
SMALLEST = 1e-12  # limits are no smaller
ROUNDING = 1e-9  # of a limit

Range = tuple[float, float]
NOWHERE: Range = (np.inf, -np.inf)
_Motion = tuple[Array, Array, Array]  # position, velocity, acceleration; (instants,)


def start_ranges(rig: RigConfig) -> list[Range]:
    """By axis, the least and the greatest position (m, rad) from which the task keeps the limits; NOWHERE: none.

    Raises ValueError as plan_task.
    """
    return list(_start_ranges(_Key(rig)))


class _Key:
    """A rig, as far as the ranges depend on it: simulations make many cycles of one."""

    def __init__(self, rig: RigConfig) -> None:
        self.rig = rig
        self._text = (rig.rate_hz, rig.task.model_dump_json(), *(x.model_dump_json() for x in rig.axes.values()))
        self._names = tuple(rig.axes)

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and (self._text, self._names) == (other._text, other._names)


@lru_cache(maxsize=16)
def _start_ranges(key: _Key) -> tuple[Range, ...]:
    rig = key.rig
    limits = [axis.limits for axis in rig.axes.values()]
    plan = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts)
    ends = plan([li.position[0] for li in limits]), plan([li.position[1] for li in limits])
    hasty = {violation.axis for violation in too_quick(rig, ends[0])}
    found = []
    for index, (name, axis) in enumerate(rig.axes.items()):
        margin = travel_margin(axis.limits)
        low, high = axis.limits.position[0] + margin, axis.limits.position[1] - margin
        if name in hasty:
            low, high = NOWHERE
        for motions in _motions(ends, index, len(rig.axes), rig.period_ns):
            if low <= high:
                low, high = _AxisStarts(name, axis, motions, rig.period_ns * 1e-9).within(low, high)
        found.append((low, high))
    return tuple(found)


def _motions(
    ends: tuple[Trajectory, Trajectory], index: int, n_axes: int, period_ns: int
) -> Iterator[tuple[_Motion, _Motion]]:
    """The motion of one axis from both ends of its travel, chunk by chunk; neighbouring chunks share an instant."""
    count = max(horizon(end) for end in ends) // period_ns + 2
    for first in range(0, count - 1, CHUNK):
        instants = np.arange(first, min(first + CHUNK + 1, count)) * period_ns
        low, high = (end.sample_axis(index, instants) for end in ends)
        yield low, high


class _AxisStarts:
    """One axis for a while. motions: from the lower and from the upper end of its travel."""

    def __init__(self, name: str, axis: AxisConfig, motions: tuple[_Motion, _Motion], period: float) -> None:
        self._name, self._axis, self._period = name, axis, period
        low, high = np.array(motions[0]), np.array(motions[1])  # (3, instants)
        # What begins elsewhere moves alike where the two plans have met; there one place says it all.
        apart = (low != high).any(axis=0)
        self._together, self._fixed = ~apart, low
        self._apart = _changing(low, high, apart)

    def within(self, low: float, high: float) -> Range:
        """The part of a range from which every limit is kept, or NOWHERE."""
        if not self._kept_together():
            return NOWHERE
        if not self._apart[0].size or (self._accepts(low) and self._accepts(high)):
            return low, high
        best = self._best(low, high)
        if not self._accepts(best):
            return NOWHERE
        return self._border(low, best), self._border(high, best)

    def _kept_together(self) -> bool:
        for measure in measures(self._name, self._axis, tuple(self._fixed), self._period):
            chosen = self._together[: len(measure.values)]
            if len(measure.values) < len(self._together):  # a change: both its instants
                chosen = chosen & self._together[1:]
            if not (measure.values[chosen] <= measure.limit).all():
                return False
        return True

    def _excess(self, places: Array) -> Array:
        """By how much the motion from each place exceeds its limits at worst, as a fraction of them."""
        low, high = self._apart
        begin, end = self._axis.limits.position
        motion = low[:, :, None] + (high - low)[:, :, None] * ((places - begin) / (end - begin))
        worst = np.full(len(places), -np.inf)
        for measure in measures(self._name, self._axis, tuple(motion), self._period):
            if len(measure.values):
                beyond = measure.values.max(axis=0) - measure.limit
                worst = np.maximum(worst, beyond / max(abs(measure.limit), SMALLEST))
        return worst

    def _accepts(self, place: float) -> bool:
        return bool(self._excess(np.array([place]))[0] <= ROUNDING)

    def _best(self, low: float, high: float) -> float:
        """The place of the least excess."""
        best = low
        for _ in range(NARROWINGS):
            places = np.linspace(low, high, CANDIDATES)
            at = int(np.argmin(self._excess(places)))
            best = float(places[at])
            low, high = float(places[max(at - 1, 0)]), float(places[min(at + 1, CANDIDATES - 1)])
        return best

    def _border(self, end: float, accepted: float) -> float:
        """The accepted place next to `end`."""
        if self._accepts(end):
            return end
        for _ in range(BISECTIONS):
            middle = 0.5 * (end + accepted)
            if self._accepts(middle):
                accepted = middle
            else:
                end = middle
        return accepted


def _changing(low: Array, high: Array, apart: Array) -> tuple[Array, Array]:
    """The instants at which the motions are apart, with those on either side, as changes take two; of those at rest
    only the first and the last.
    """
    chosen = np.convolve(apart, np.ones(3), mode="same") > 0.0
    low, high = low[:, chosen], high[:, chosen]
    steps = ((low[:, 1:] != low[:, :-1]) | (high[:, 1:] != high[:, :-1])).any(axis=0)
    keep = np.ones(low.shape[1], dtype=bool)
    keep[1:-1] = steps[:-1] | steps[1:]
    return low[:, keep], high[:, keep]
