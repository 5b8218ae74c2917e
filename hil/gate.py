"""The torque gate: the only way force leaves this process, and the only code that builds a command frame.

In this order: finite? does the state permit it? position-dependent limits, clamp, rate limit, encode. It knows nothing
of laws and trajectories and trusts neither. Anything not finite, or not permitted, becomes zero at once: the rate limit
never delays zero.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frame import Frame
from drivers.protocols.base import Command, HostProtocol

Array = NDArray[np.float64]


def limit_force(
    request: Array, previous: Array, position: Array, limits: "ForceLimits", out: Array, scratch: Array
) -> None:
    """Bound `request` by position, magnitude and rate of change; arrays (..., n_axes), N. Exact element-wise
    operations.

    Beyond a travel limit only force that points back inside is let through. The rate limit gives way to the bounds: at
    a travel limit the outward force is zero in the same tick. Neither input array is changed.
    """
    np.subtract(previous, limits.step, out=scratch)
    np.maximum(request, scratch, out=out)
    np.add(previous, limits.step, out=scratch)
    np.minimum(out, scratch, out=out)
    np.less(position, limits.position_high, out=limits.mask)
    np.multiply(limits.force, limits.mask, out=scratch)
    np.minimum(out, scratch, out=out)
    np.greater(position, limits.position_low, out=limits.mask)
    np.multiply(limits.minus_force, limits.mask, out=scratch)
    np.maximum(out, scratch, out=out)


class ForceLimits:
    """Bounds of every axis; arrays (n_axes,): N, m, m, and N per tick."""

    def __init__(self, force: Any, position_low: Any, position_high: Any, step: Any, shape: tuple[int, ...]) -> None:
        self.force: Array = np.asarray(force, dtype=np.float64)
        self.minus_force: Array = -self.force
        self.position_low: Array = np.asarray(position_low, dtype=np.float64)
        self.position_high: Array = np.asarray(position_high, dtype=np.float64)
        self.step: Array = np.asarray(step, dtype=np.float64)
        self.mask = np.zeros(shape, dtype=np.bool_)


class TorqueGate:
    """Holds the last force let out, per axis, and counts what it had to change."""

    def __init__(self, protocol: HostProtocol, limits: ForceLimits) -> None:
        self._protocol = protocol
        self._limits = limits
        n = protocol.n_axes
        self.force: Array = np.zeros(n)  # let out in the latest tick
        self._limited: Array = np.zeros(n)
        self._scratch: Array = np.zeros(n)
        self._zero = [0.0] * n
        self._all_axes = (1 << n) - 1
        self.saturations = [0] * n

    def release(
        self, request: Array, position: Array, *, permitted: bool, sequence: int, reset: bool = False
    ) -> list[Frame]:
        """Command frames of one tick.

        request: force asked for (n_axes,), N. position: newest trusted position (n_axes,), m. permitted: the state
        allows torque; if not, or if anything is not finite, the force is zero and every drive is disabled.
        """
        if not permitted or not self.finite(request) or not self.finite(position):
            return self.zero(sequence, reset)
        limited = self._limited
        limit_force(request, self.force, position, self._limits, limited, self._scratch)
        force: Sequence[float] = limited.tolist()
        asked: Sequence[float] = request.tolist()
        if force != asked:
            for axis, (let_out, wanted) in enumerate(zip(force, asked, strict=True)):
                self.saturations[axis] += let_out != wanted
        self.force[:] = limited
        return self._protocol.encode(Command(sequence, force, self._all_axes, False))

    def zero(self, sequence: int, reset: bool = False) -> list[Frame]:
        """Command frames with zero force and every drive disabled."""
        self.force[:] = 0.0
        return self._protocol.encode(Command(sequence, self._zero, 0, reset))

    @staticmethod
    def finite(values: Array) -> bool:
        """True where no value is NaN or infinite: a finite number less itself is zero, any other is NaN."""
        total = 0.0
        for value in values.tolist():
            total += value - value
        return total == 0.0
