"""Which of two CAN frames goes first: the arbitration field (ISO 11898-1:2015, 10.4.2) as a number."""

from functools import lru_cache

from drivers.frame import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK


@lru_cache(maxsize=4096)
def arbitration_key(can_id: int) -> int:
    """The arbitration field as an integer: of two frames that begin together the one with the lower key wins.

    can_id: with Linux's flags. 11-bit identifiers: id, RTR, IDE = 0. 29-bit ones: base id, SRR = 1, IDE = 1, extension,
    RTR. So a base frame beats an extended frame with the same first 11 bits, and data beats remote.
    """
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        return (identifier >> 18) << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return (can_id & STANDARD_MASK) << 21 | remote << 20
