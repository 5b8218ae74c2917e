"""What frame layouts have in common: bounds of forces and positions, foreign identifiers."""

from collections.abc import Container, Sequence
from typing import Final

from drivers.frame import ERROR, EXTENDED, REMOTE, STANDARD_MASK
from drivers.protocols.base import Reject

MAX_AXES: Final = 4
INT32 = (-(2.0**31), 2.0**31 - 1.0)  # counts of a position; no Final: mypyc takes such a tuple of floats for unset


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
