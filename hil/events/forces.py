"""What a window's forces say of an axis: more friction, or a force that nobody asked for. From the records of ticks.

In motion, the force along it, less what mass, gravity and viscous friction take, is the drag. More of it than before is
friction, a drive that gives less force than it is asked for, or a push against the motion: one direction alone cannot
tell them apart. Less than none, or an axis that runs backwards while it
is told to go on, is neither: something pushes (bias).

At rest the force that holds the axis hardly changes from window to window. A step of it is a bias, or, where the same
force is now asked for several times over, a weak drive.
"""

from collections import defaultdict
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from hil.events.axis_model import AxisModel, Floats

FRICTION: Final = 0.5  # of the model's dry friction, beyond what the windows before showed
UNKNOWN: Final = 0.05  # of the model's gravity
KNOWN: Final = 4  # windows before what they showed is a reference
_HELD: Final = 0.5  # of the dry friction: a step of the force at rest
_WEAK: Final = (1.2, 5.0)  # times the force before: a drive that gives 20 to 80 % of it
_BACK: Final = 10.0  # counts backwards, at least


class Force(NamedTuple):
    """What is not as it was. signature, measured: as in hil.events.accuracy.Loss. value, limit: N (N m)."""

    signature: str
    measured: str
    value: float
    limit: float
    cause: str
    action: str
    plain: bool = False  # far enough beyond to need no second window


def drag_of(model: AxisModel, period_s: float, axis: Mapping[str, Floats]) -> tuple[float, float] | None:
    """(direction, drag in N) of the ticks of a window in which the axis moves well; None where it hardly does."""
    velocity = axis["setpoint_velocity"]
    speed, sign = np.abs(velocity), np.sign(velocity)
    moving = speed > 0.3 * speed.max()
    if abs(sign[moving].sum()) < 0.75 * len(velocity):
        return None
    way = float(sign[moving][0])
    acceleration = np.gradient(velocity, period_s)
    force = axis["force"] + model.gravity - model.mass * acceleration - model.wet * velocity
    return way, way * float(np.median(force[moving]))


class ForceJudge:
    """One axis. `judge` is given every window in which it follows a task, in order."""

    def __init__(self, axis: AxisModel, period_s: float) -> None:
        self._axis, self._period_s = axis, period_s
        self._most: dict[float, float] = defaultdict(float)  # by direction: the largest drag of the good windows
        self._seen: dict[float, int] = defaultdict(int)
        self._slack = FRICTION * axis.dry + UNKNOWN * abs(axis.gravity)
        self._holds: float | None = None  # the force that holds the axis in the present rest
        self._pushed_back = False  # in a window of the present motion

    def judge(self, axis: Mapping[str, Floats], *, resting: bool, settled: bool) -> Force | None:
        """A whole window of the axis' fields. settled: it has been resting for a while."""
        if self._axis.dry <= 0.0:
            return None
        if resting:
            self._pushed_back = False
            return self._resting(axis) if settled else None
        self._holds = None
        return self._moving(axis)

    def know(self, way: float, drag: float) -> None:
        """The largest drag of sound runs in that direction."""
        self._most[way], self._seen[way] = drag, KNOWN

    def forget(self) -> None:
        """What holds the axis is not known any more: its encoder stepped."""
        self._holds = None

    def _resting(self, axis: Mapping[str, Floats]) -> Force | None:
        force = float(np.median(axis["force"]))
        if self._holds is None:
            self._holds = force
            return None
        step, bound = force - self._holds, _HELD * self._axis.dry + UNKNOWN * abs(self._axis.gravity)
        if abs(step) <= bound:
            self._holds += 0.5 * step
            return None
        ratio = force / self._holds if self._holds else np.inf
        weak = _WEAK[0] <= ratio <= _WEAK[1]
        return _bias("step of the force that holds the axis", abs(step), bound, -np.sign(step), weak=weak)

    def _moving(self, axis: Mapping[str, Floats]) -> Force | None:
        model = self._axis
        if (found := drag_of(model, self._period_s, axis)) is None:
            return None
        way, drag = found
        most = self._largest_sound(way) + self._slack
        self._pushed_back |= self._went_back(axis, way)
        if drag < -self._slack:
            return _bias("force along the motion that nothing asks for", -drag, self._slack, way)
        if drag <= most:
            self._pushed_back = False
            self._most[way] = max(self._most[way], drag)
            self._seen[way] += 1
            return None
        if self._pushed_back:
            return _bias("force against the motion beyond what the model says", drag, most, -way)
        return Force(
            "friction up", "force along the motion beyond what the model says", drag, most,
            "the guide is dirty or tight, or something drags on the axis, pushes or pulls it back, or its drive gives "
            "less force than asked for",
            "move the axis by hand; clean and grease the guide, look at the cables",
            plain=drag > most + self._slack,
        )  # fmt: skip

    def _largest_sound(self, way: float) -> float:
        """Drag that a sound axis may have in that direction, N. Before a window has shown any it may be a dry friction
        more than the model's; the more of KNOWN have, the less is added to theirs.
        """
        dry, unseen = self._axis.dry, 1.0 - min(self._seen[way], KNOWN) / KNOWN
        shown = max(self._most[way], dry)
        return min(shown + unseen * dry, 2.0 * dry) if unseen else shown

    def _went_back(self, axis: Mapping[str, Floats], way: float) -> bool:
        """Friction stops an axis; it never drives it backwards, further than the set-point's own motion and its law's
        overshoot would.
        """
        position = way * axis["position"]
        back = float(np.max(np.maximum.accumulate(position) - position))
        return back > _BACK * self._axis.resolution + 0.25 * float(np.ptp(axis["setpoint_position"]))


def _bias(measured: str, value: float, limit: float, way: float, *, weak: bool = False) -> Force:
    sense = "upwards" if way > 0.0 else "downwards"
    pushes = f"something pushes or pulls the axis {sense}: a hand, a cable, a hose"
    both = f"{pushes}; or its drive gives less force than asked for"
    return Force(
        "bias", measured, value, limit, both if weak else pushes,
        "look for what touches the axis; then home it, and compare the drive's current with the force asked for",
    )  # fmt: skip
