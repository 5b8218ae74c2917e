"""A trajectory of ROS 2 as a stream of goals, a few at a time, so that the program that follows it can do something
else too.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

from hil.runs.mover import Move, Mover

ROW_S: Final = 0.02  # between the goals of a stream
LEAD_S: Final = 0.06  # that each is sent before it is due
MOST_S: Final = 3600.0


class Trajectory:
    """One that is followed from now on. Raises ValueError for joints, times and points that cannot be followed from
    where the axes stand, MotionError where the rig is gone. canceled: it was ended before its end.
    """

    def __init__(self, mover: Mover, message: Mapping[str, Any]) -> None:
        """message: trajectory_msgs/msg/JointTrajectory."""
        self._mover = mover
        self._names = list(message["joint_names"])
        unknown = [name for name in self._names if name not in mover.axes]
        if unknown or not self._names or len(set(self._names)) < len(self._names):
            raise ValueError(
                f"joints {', '.join(self._names) or 'none'}: the rig has {', '.join(mover.axes)}, each once"
            )
        self._points = self._checked(message["points"])
        self._origin_ns = mover.now_ns()
        self._next = 1  # row
        self._rows = max(1, math.ceil(self._points[-1][0] / ROW_S))
        self._last: Move | None = None
        self.canceled = False

    def _checked(self, points: list[Mapping[str, Any]]) -> list[tuple[float, list[float], list[float]]]:
        """Time, positions and velocities of each point, the first one where the axes stand."""
        if not points:
            raise ValueError("no points")
        places = [self._mover.axes.index(name) for name in self._names]
        setpoint = self._mover.status().setpoint
        n, found = len(places), [(0.0, [setpoint[place] for place in places], [0.0] * len(places))]
        for number, point in enumerate(points):
            at = point["time_from_start"]["sec"] + point["time_from_start"]["nanosec"] * 1e-9
            position, velocity = list(point["positions"]), list(point["velocities"])
            if len(position) != n or len(velocity) not in (0, n):
                raise ValueError(f"point {number}: {len(position)} positions, {len(velocity)} velocities of {n} joints")
            if not all(map(math.isfinite, (*position, *velocity))):
                raise ValueError(f"point {number}: a number is not finite")
            if number == 0 and at <= 0.0:
                self._begins_here(found[0][1], position)
                continue
            if not found[-1][0] < at <= MOST_S:
                raise ValueError(
                    f"point {number}: {at:g} s, after {found[-1][0]:g} s and at most {MOST_S:g} s expected"
                )
            found.append((at, position, velocity))
        if len(found) < 2:
            raise ValueError("no point after the start")
        for number, name in enumerate(self._names):
            low, high = self._mover.range_of(name)
            for _, position, _ in found:
                if not low <= position[number] <= high:
                    raise ValueError(f"{name} = {position[number]:g}: from {low:.6g} to {high:.6g}")
        return _with_velocities(found)

    def _begins_here(self, stands: list[float], begins: list[float]) -> None:
        for name, at, wanted in zip(self._names, stands, begins, strict=True):
            if abs(at - wanted) > self._mover.window_of(name):
                raise ValueError(f"{name} stands at {at:.9g}, the trajectory begins at {wanted:.9g}")

    def advance(self) -> bool:
        """Send what is due soon; the axes are in position at its end. Raises MotionError where it was cut short."""
        while self._last is None:
            now_s = (self._mover.now_ns() - self._origin_ns) * 1e-9
            due_s = min(self._next * ROW_S, self._points[-1][0])
            if due_s - now_s > LEAD_S:
                return False
            if self._next > self._rows:
                if now_s < self._points[-1][0]:
                    return False
                end = dict(zip(self._names, self._points[-1][1], strict=True))
                self._last = self._mover.move_to(speed=1.0, line=False, **end)
            elif due_s > now_s:
                position, velocity = self._at(due_s)
                self._mover.send(position, velocity, due=due_s - now_s)
            self._next += 1
        return self._last.done

    def _at(self, time_s: float) -> tuple[dict[str, float], dict[str, float]]:
        """Of the cubic between the points beside it."""
        after = next(place for place, (at, _, _) in enumerate(self._points) if time_s <= at and place)
        (t0, p0, v0), (t1, p1, v1) = self._points[after - 1 : after + 1]
        h = t1 - t0
        u = min((time_s - t0) / h, 1.0)
        position, velocity = {}, {}
        for name, a, b, va, vb in zip(self._names, p0, p1, v0, v1, strict=True):
            d, sa, sb = b - a, va * h, vb * h
            c2, c3 = 3.0 * d - 2.0 * sa - sb, sa + sb - 2.0 * d
            position[name] = a + u * (sa + u * (c2 + u * c3))
            velocity[name] = (sa + u * (2.0 * c2 + u * 3.0 * c3)) / h
        return position, velocity

    def cancel(self) -> None:
        """Come to rest here."""
        self.canceled = True
        self._last = self._mover.halt()


def _with_velocities(
    points: list[tuple[float, list[float], list[float]]],
) -> list[tuple[float, list[float], list[float]]]:
    """The same; a point without velocities has those of the slope between its neighbours, the last one none."""
    found = [points[0]]
    for place in range(1, len(points)):
        at, position, velocity = points[place]
        if not velocity and place + 1 < len(points):
            (t0, p0, _), (t1, p1, _) = points[place - 1], points[place + 1]
            velocity = [(b - a) / (t1 - t0) for a, b in zip(p0, p1, strict=True)]
        found.append((at, position, velocity or [0.0] * len(position)))
    return found
