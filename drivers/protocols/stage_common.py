"""What stage_fd and stage_classic share: identifiers, the status bits, the pattern of their traffic."""

import math
from collections.abc import Container, Sequence
from typing import Final

from drivers.config import BusConfig
from drivers.frame import ERROR, EXTENDED, REMOTE, STANDARD_MASK
from drivers.protocols.base import DriveStatus, LayoutError, Message, Reject

MAX_AXES: Final = 4
STATUS_MASK: Final = 0x7F  # every bit DriveStatus knows
assert sum(DriveStatus) == STATUS_MASK
INT32 = (-(2.0**31), 2.0**31 - 1.0)  # counts of a position; no Final: mypyc takes such a tuple of floats for unset


def check_ids(bus: BusConfig, n_axes: int, rated_force: Sequence[float]) -> None:
    """Raise LayoutError where the rig's identifiers or rated forces cannot be used by a stage layout."""
    if not 1 <= n_axes <= MAX_AXES:
        raise LayoutError(f"{n_axes} axes: the stage layouts carry 1 to {MAX_AXES}")
    if len(rated_force) != n_axes:
        raise LayoutError(f"{len(rated_force)} rated forces for {n_axes} axes")
    if not all(math.isfinite(force) and force > 0 for force in rated_force):
        raise LayoutError(f"rated forces {list(rated_force)}: each must be finite and above zero")
    if bus.feedback_id <= bus.host_id < bus.feedback_id + n_axes:
        raise LayoutError(
            f"bus.host_id = {bus.host_id:#x} is one of the feedback identifiers "
            f"{bus.feedback_id:#x} to {bus.feedback_id + n_axes - 1:#x}"
        )


def check_force(force: Sequence[float], rated_force: Sequence[float]) -> None:
    """Raise ValueError for a force that no drive may be sent: not finite, or beyond its rated force."""
    for value, limit in zip(force, rated_force, strict=True):
        if not -limit <= value <= limit:  # also where it is not a number
            raise ValueError(f"force {value} is not within +-{limit}; the gate must not let it pass")


def reject_id(can_id: int, known: Container[int], own_id: int) -> Reject:
    """Why a frame whose identifier is not exactly one that is listened to carries nothing."""
    if can_id & ERROR:
        return Reject.ERROR_FRAME
    if can_id & (EXTENDED | REMOTE):
        return Reject.WRONG_FORMAT if can_id & STANDARD_MASK in known else Reject.UNKNOWN_ID
    return Reject.OWN_ECHO if can_id == own_id else Reject.UNKNOWN_ID


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
