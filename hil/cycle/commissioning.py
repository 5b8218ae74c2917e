"""The commissioning push: that force and position of an axis have the sign and scale the rig states, before a task.

Rules. With all drives enabled, one axis after the other is pushed by a small force, which the gate limits like any
other, until it has moved a short distance; then it is braked. It has to move the way of the force, and as far as the
nominal model says within `tolerance` (a ratio of accelerations). Sign and scale of force and position, units and gear
are all in that product. Where two mistakes cancel in it they cancel in the loop too: a whole axis that is mirrored
(axes.NAME.direction) can only be seen by somebody who looks. What is pushed against is the nominal model: on an axis it
does not fit, the push fails, as the task would.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from hil.control.laws.base import Model
from hil.cycle.damped_stop import DampedStop
from hil.rig.tables import AxisConfig, PushConfig

LEAST_TICKS = 8  # of a push: latency and the encoder's steps are small beside it
_LATENCY_TICKS = 2  # from the first force asked for to the first sample that can show it
_WRONG_WAY = 0.25  # of the distance


def push_problems(name: str, axis: AxisConfig, period_s: float) -> list[str]:
    """What is wrong with an axis' [axes.NAME.push], for people."""
    push = axis.push
    if push is None:
        return []
    key = f"axes.{name}.push"
    if push.force > axis.limits.force - abs(axis.model.gravity):
        return [f"{key}.force = {push.force:g}: with gravity beyond axes.{name}.limits.force = {axis.limits.force:g}"]
    if push.force <= axis.model.coulomb:
        return [f"{key}.force = {push.force:g} does not move an axis with coulomb = {axis.model.coulomb:g}"]
    duration = math.sqrt(2.0 * push.distance / _acceleration(push, axis.model.coulomb, axis.model.mass))
    if duration < LEAST_TICKS * period_s:
        return [f"{key}: over within {duration / period_s:.1f} ticks; at least {LEAST_TICKS}: less force, or further"]
    if push.distance > axis.limits.following_error / 4:
        return [f"{key}.distance = {push.distance:g}: at most a quarter of axes.{name}.limits.following_error"]
    return []


def _acceleration(push: PushConfig, coulomb: float, mass: float) -> float:
    return (push.force - coulomb) / mass


class AxisPush(NamedTuple):
    """One axis to push. force: N, without what holds it against gravity. expected: acceleration, m/s^2."""

    axis: int
    name: str
    force: float
    distance: float
    tolerance: float
    expected: float
    gravity: float
    middle: float  # of the travel, towards which it is pushed


class Commissioning:
    """All pushes of a rig, once in the life of a control cycle.

    running: the axes are being pushed. done: all were as stated. problem: what was not, for people.
    """

    def __init__(
        self, axes: dict[str, AxisConfig], models: Sequence[Model], period_s: float, stop: DampedStop, stop_s: float
    ) -> None:
        problems = [line for name, axis in axes.items() for line in push_problems(name, axis, period_s)]
        if problems:
            raise ValueError("; ".join(problems))
        self._pushes = [
            AxisPush(
                number,
                name,
                axis.push.force,
                axis.push.distance,
                axis.push.tolerance,
                _acceleration(axis.push, models[number].coulomb, models[number].mass),
                models[number].gravity,
                sum(axis.limits.position) / 2,
            )
            for number, (name, axis) in enumerate(axes.items())
            if axis.push is not None
        ]
        self._period_s = period_s
        self._stop, self._stop_ticks = stop, math.ceil(stop_s / period_s)
        self.done = not self._pushes
        self.running = False
        self.problem = ""
        self.axis, self.moved, self.expected = 0, 0.0, 0.0  # of the push that was refused, m
        self._next = 0
        self._ticks = 0
        self._braking = False
        self._from = self._sign = 0.0

    def start(self, position: Sequence[float]) -> None:
        """From the first axis, with the axes at rest at `position`, m."""
        self.running = True
        self.problem = ""
        self._begin(0, position)

    def cancel(self) -> None:
        """The axes are no longer ours to push; what was not proven is to be proven from the start."""
        self.running = False

    def _begin(self, number: int, position: Sequence[float]) -> None:
        self._next, self._ticks, self._braking = number, 0, False
        push = self._pushes[number]
        self._from = position[push.axis]
        self._sign = 1.0 if self._from <= push.middle else -1.0

    def advance(self, position: Sequence[float], velocity: Sequence[float]) -> None:
        """One tick, with measured positions, m, and estimated velocities, m/s."""
        self._ticks += 1
        if self._braking:
            if self._stop.over(velocity, self._ticks * self._period_s) or self._ticks >= self._stop_ticks:
                self._finish(position)
            return
        push = self._pushes[self._next]
        moved = (position[push.axis] - self._from) * self._sign
        seconds = max(0, self._ticks - _LATENCY_TICKS) * self._period_s
        expected = 0.5 * push.expected * seconds * seconds
        if moved <= -_WRONG_WAY * push.distance:
            self._refuse(push, moved, expected, "the wrong way: direction, or the sign of force or position")
        elif moved >= push.distance:
            later = 0.5 * push.expected * (self._ticks * self._period_s) ** 2  # without latency
            if moved > push.tolerance * later:
                self._refuse(push, moved, later, "too far: the scale of force or position, or the mass")
            else:
                self._braking, self._ticks = True, 0
        elif expected > push.tolerance * push.distance:
            self._refuse(push, moved, expected, "too little: enable, mode, the scale of force or position, or friction")

    def _finish(self, position: Sequence[float]) -> None:
        if self._next + 1 < len(self._pushes):
            self._begin(self._next + 1, position)
        else:
            self.running, self.done = False, True

    def _refuse(self, push: AxisPush, moved: float, expected: float, what: str) -> None:
        self.running = False
        self.axis, self.moved, self.expected = push.axis, self._sign * moved, self._sign * expected
        milliseconds = self._ticks * self._period_s * 1e3
        self.problem = (
            f"axis {push.name}: pushed by {self._sign * push.force:+g} for {milliseconds:.0f} ms it moved "
            f"{self._sign * moved:+.3g}, not {self._sign * expected:+.3g}: {what}"
        )

    def force(self, velocity: Sequence[float]) -> list[float]:
        """Force asked for, N per axis: of the axis being pushed; the others are held by the damped stop."""
        force = self._stop.force(velocity)
        if not self._braking:
            push = self._pushes[self._next]
            force[push.axis] = push.gravity + self._sign * push.force
        return force
