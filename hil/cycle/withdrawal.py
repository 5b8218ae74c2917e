"""WITHDRAW: before the rig stops, the tip goes back to its safe height.

Rules:
- It takes the place of STOP where a motion has declared a way out (hil.Retreat), the drives apply torque, every axis
  answers, and the tip is beyond the safe height. A fault that names the way out's own axis, a lost encoder and ticks
  missed in a row are for the damped stop at once, also while the tip is on its way. The law is not to be trusted then.
- References are the rig's own: a plan within [axes.NAME.motion], from the references in force. No reading is looked at,
  and the motion is asked no more.
- The other axes come to rest and are held by the law. One that a fault names gets the force of the damped stop.
- ZERO, SILENT and the emergency stop do not wait for it. The tip then stays where it is, and `left` says so.
"""

from collections.abc import Sequence
from typing import Final

from hil.control.motion.contract import Retreat
from hil.control.plans.axis_plan import MotionLimits
from hil.control.plans.moves import move
from hil.cycle.damped_stop import TIME_CONSTANT_S
from hil.cycle.fault_monitor import REACTIONS, FaultMonitor
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.goal import LEAD_OUT
from hil.cycle.limits import axis_limits
from hil.rig.schema import RigConfig

WITHIN_S: Final = 0.2  # that it takes, where the axis' limits allow: half of what is left after a late detection
STANDS_OFF: Final = 0.25  # of limits.following_error: an axis that has stopped may be so far from where it was to be
LATE_S: Final = 0.1  # that the axis may be behind its plan; then the damped stop comes all the same
_BLIND: Final = 1 << Fault.ENCODER_LOST | 1 << Fault.OVERRUN_BURST  # the law has no samples, or half its rate


class Withdrawal:
    """The way out of one rig. axis: index of the axis that goes. safe: m, its safe height. longest_s: that the way
    takes from anywhere inside the fence, s. released: axes that a fault names.
    """

    def __init__(self, retreat: Retreat, rig: RigConfig, limits: Sequence[MotionLimits]) -> None:
        self.axis = rig.axis_names.index(retreat.axis)
        self.safe, self._inwards = retreat.position, float(retreat.direction)
        self._name, self._rig_name = retreat.axis, rig.name
        stated = axis_limits(rig)[self.axis]
        self._margin = max(stated.rest_window, STANDS_OFF * stated.following_error)
        li = limits[self.axis]
        deepest = li.low if retreat.direction < 0 else li.high
        self.longest_s = max(move(deepest, 0.0, 0.0, self.safe, li).ends, WITHIN_S) + LATE_S
        self.released = [False] * len(rig.axes)
        self._due_ns = 0

    def beyond(self, place: float) -> bool:
        """Whether the tip is beyond its safe height. place: of the axis, m."""
        return (place - self.safe) * self._inwards > self._margin

    def needed(self, place: float, velocity: float) -> bool:
        """Whether it is, or would be after a damped stop. velocity: m/s."""
        return self.beyond(place) or self.beyond(place + velocity * TIME_CONSTANT_S)

    def left(self, *, seen: bool) -> str:
        """For people, where the tip stays beyond its safe height: what that means, and commands that lead it out. seen:
        the axis answers.
        """
        rig, height = self._rig_name, f"its safe height of {self.safe:g}"
        where = f"is beyond {height}" if seen else f"was last seen beyond {height}, or on its way there"
        return (
            f"the tip may be in a cell: {self._name} {where}{LEAD_OUT}hil command {rig} reset, then "
            f"hil command {rig} activate-hold, then hil move {rig} {self._name}={self.safe:g}"
        )

    def begin(self) -> None:
        """No axis is released yet."""
        self.released = [False] * len(self.released)

    def due(self, now_ns: int, seconds: float) -> None:
        """The plan that has just begun takes so long."""
        self._due_ns = now_ns + round(seconds * 1e9)

    def sound(self, monitor: FaultMonitor) -> bool:
        """Whether the faults of this tick leave the way out in control; axes that they name are released."""
        if monitor.active & _BLIND:
            return False
        for found in monitor.evidence:
            armed = monitor.active >> found.fault & 1
            if not armed or REACTIONS[found.fault] < Reaction.STOP or ROWS[Fault(found.fault)].of_sensor:
                continue
            if found.axis == self.axis:
                return False
            if found.axis >= 0:
                self.released[found.axis] = True
        return True

    def over(self, place: float, now_ns: int) -> bool:
        """Whether the plan has ended and the tip with it, or has been waited for long enough."""
        if now_ns < self._due_ns:
            return False
        return not self.beyond(place) or now_ns >= self._due_ns + round(LATE_S * 1e9)


def shared(held: Sequence[float], damped: Sequence[float], released: Sequence[bool]) -> list[float]:
    """The force asked for, N by axis: of the law, and of the damped stop where an axis is released."""
    return [b if free else a for a, b, free in zip(held, damped, released, strict=True)]
