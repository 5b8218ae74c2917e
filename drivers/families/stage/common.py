"""What stage_fd and stage_classic share: identifiers, what their answers carry, the pattern of their traffic."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from drivers.config import BusConfig, Wiring
from drivers.families.stage.config import stage_keys
from drivers.protocols.base import LayoutError, Message
from drivers.protocols.common import INT32, MAX_AXES


def check_ids(bus: BusConfig, n_axes: int, rated_force: Sequence[float]) -> None:
    """Raise LayoutError where the rig's identifiers or rated forces cannot be used by a stage layout."""
    if not 1 <= n_axes <= MAX_AXES:
        raise LayoutError(f"{n_axes} axes: the stage layouts carry 1 to {MAX_AXES}")
    if len(rated_force) != n_axes:
        raise LayoutError(f"{len(rated_force)} rated forces for {n_axes} axes")
    if not all(math.isfinite(force) and force > 0 for force in rated_force):
        raise LayoutError(f"rated forces {list(rated_force)}: each must be finite and above zero")
    keys = stage_keys(bus)
    if keys.feedback_id <= keys.host_id < keys.feedback_id + n_axes:
        raise LayoutError(
            f"bus.host_id = {keys.host_id:#x} is one of the feedback identifiers "
            f"{keys.feedback_id:#x} to {keys.feedback_id + n_axes - 1:#x}"
        )


class StageLayout:
    """Both ends of a stage layout. A layout says the rest: name, fd, tells, sequence_modulus, _wrap_ns. Raises
    LayoutError for a rig that it cannot carry.
    """

    checksum = True
    states = True
    causes = True
    resets = True
    problems: Sequence[str] = ()
    _wrap_ns: int  # of the time stamp

    def __init__(self, wiring: Wiring) -> None:
        bus, n_axes = wiring.bus, wiring.n_axes
        check_ids(bus, n_axes, wiring.rated_force)
        keys = stage_keys(bus)
        self.n_axes = n_axes
        self.positions: Sequence[tuple[float, float]] = [INT32] * n_axes
        self.echo_id: int | None = None
        self.acts_ns: Sequence[int] = ()
        self.stamp_wraps_ns: Sequence[int] = [self._wrap_ns] * n_axes
        self.state_ns = 0
        self._command_id = keys.host_id
        self._feedback_id = keys.feedback_id


def cut(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """What another segment has otherwise: the identifiers of the answers on it."""
    first = stage_keys(bus).feedback_id
    return lambda axes: {"feedback_id": first + axes[0]}


def cyclic_messages(
    command: tuple[int, int], feedback: tuple[int, int], n_axes: int, fd: bool, period_ns: int
) -> list[Message]:
    """Traffic of a stage layout, all of it due within the period; command and feedback: (identifier, payload bytes)."""
    host = Message("command", command[0], command[1], fd, period_ns, period_ns, 0, "host")
    return [host] + [
        Message(
            f"feedback {axis}", feedback[0] + axis, feedback[1], fd, period_ns, period_ns, 0, f"axis {axis}", "command"
        )
        for axis in range(n_axes)
    ]
