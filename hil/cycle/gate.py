"""The torque gate: the only way force leaves this process, and the only code that builds a command frame.

Rules:
- It knows nothing of laws and trajectories and trusts neither. What is applied lies within the axis' force limit,
  changes by no more than the rate limit allows, and never pushes an axis further beyond its travel.
- Anything not finite, or not permitted by the state, becomes zero at once: the rate limit never delays zero.
- It never raises on a request; it raises on a programming error alone (a wrong number of axes).

Theory of operation, in this order: finite? does the state permit it? rate limit, then clamp by force limit and
position, then encode. The clamp comes last and wins: at a travel limit the outward force is zero in the same tick,
however small the rate limit. `force` holds what was applied last, which is where the next tick's rate limit starts
from.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from drivers.frame import Frame
from drivers.protocols.base import Command, HostProtocol


class ForceLimits(NamedTuple):
    """Bounds of one axis: N, m, m, and N per tick."""

    force: float
    position_low: float
    position_high: float
    step: float


def limit_force(request: float, previous: float, position: float, limits: ForceLimits) -> float:
    """Bound `request` (N) by rate of change, magnitude and position (m); all finite.

    Beyond a travel limit only force that points back inside is let through. The rate limit gives way to the bounds: at
    a travel limit the outward force is zero in the same tick.
    """
    force, low, high, step = limits
    least, most = previous - step, previous + step
    limited = least if request < least else most if request > most else request
    least, most = -force if position > low else 0.0, force if position < high else 0.0
    return most if limited > most else least if limited < least else limited


class TorqueGate:
    """Holds the force applied last, per axis (N), and counts what it had to change.

    drives: bit i for axis i; those enabled where torque is permitted, by default all.
    """

    def __init__(self, protocol: HostProtocol, limits: Sequence[ForceLimits], drives: int | None = None) -> None:
        self._encode = protocol.encode
        self._limits = list(limits)
        self._given = list(limits)
        n = protocol.n_axes
        self._zero = [0.0] * n
        self.force = self._zero  # applied in the latest tick
        self._drives = (1 << n) - 1 if drives is None else drives
        self.saturations = [0] * n

    def bound(self, axis: int, force: float) -> None:
        """Give the axis at most `force` (N) from here on, never more than its limit."""
        self._limits[axis] = self._limits[axis]._replace(force=min(force, self._given[axis].force))

    def enclose(self, axis: int, low: float, high: float) -> None:
        """Between these places, m, the axis is inside its travel from here on."""
        self._given[axis] = self._given[axis]._replace(position_low=low, position_high=high)
        self._limits[axis] = self._limits[axis]._replace(position_low=low, position_high=high)

    def block(self, axis: int, *, low: bool, high: bool) -> None:
        """What the axis' limit switches say: no force towards an end whose switch is closed, whatever the position."""
        given = self._given[axis]
        self._limits[axis] = ForceLimits(
            self._limits[axis].force,
            math.inf if low else given.position_low,
            -math.inf if high else given.position_high,
            given.step,
        )

    def release(
        self,
        request: list[float],
        position: list[float],
        *,
        permitted: bool,
        sequence: int,
        reset: bool = False,
    ) -> list[Frame]:
        """Command frames of one tick.

        request: force asked for, N per axis. position: newest trusted positions, m. permitted: the state allows torque;
        if not, or if anything is not finite, the force is zero and every drive is disabled. Raises ValueError where
        `request` or `position` has not one value an axis.
        """
        if not permitted or not self.finite(request) or not self.finite(position):
            return self.zero(sequence, reset)
        if not len(request) == len(position) == len(self._limits):
            raise ValueError(f"{len(request)} forces and {len(position)} positions for {len(self._limits)} axes")
        force = []
        for axis, limits in enumerate(self._limits):
            wanted = request[axis]
            applied = limit_force(wanted, self.force[axis], position[axis], limits)
            force.append(applied)
            if applied != wanted:
                self.saturations[axis] += 1
        self.force = force
        return self._encode(Command(sequence, force, self._drives, False))

    def zero(self, sequence: int, reset: bool = False) -> list[Frame]:
        """Command frames with zero force and every drive disabled."""
        self.cut()
        return self._encode(Command(sequence, self._zero, 0, reset))

    def cut(self) -> None:
        """No force, and nothing said of it: the bus is to stay silent."""
        self.force = self._zero

    @staticmethod
    def finite(values: list[float]) -> bool:
        """True where no value is NaN or infinite."""
        for value in values:  # noqa: SIM110  # a third of what all() of a generator costs
            if value - value != 0.0:
                return False
        return True
