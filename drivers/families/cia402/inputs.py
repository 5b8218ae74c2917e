"""60FDh, the digital inputs of a drive, as its TPDO 2 tells them at every SYNC.

Bits by CiA 402-2: 0 negative limit switch, 1 positive limit switch, 2 home switch; the ends are the drive's own.
"""

from typing import Final

from drivers.protocols.base import DriveStatus

DIGITAL_INPUTS: Final = 0x60FD
TPDO2_ID: Final = 0x280
LENGTH: Final = 4  # bytes
UNTOLD_TICKS: Final = 5  # after which inputs that were told are no longer believed
_BITS: Final = (int(DriveStatus.LIMIT_LOW), int(DriveStatus.LIMIT_HIGH), int(DriveStatus.HOME))  # from bit 0 on
TELLS: Final = sum(_BITS)
_MASK: Final = (1 << len(_BITS)) - 1
_STATUS: Final = tuple(sum(bit for place, bit in enumerate(_BITS) if word >> place & 1) for word in range(_MASK + 1))
_FAULT: Final = int(DriveStatus.FAULT)


class InputWatch:
    """The inputs of one drive. Time is counted in ticks."""

    def __init__(self) -> None:
        self._status, self._tick = 0, -UNTOLD_TICKS - 1

    def hear(self, data: bytes, tick: int) -> None:
        """A TPDO 2 of LENGTH bytes."""
        self._status, self._tick = _STATUS[data[0] & _MASK], tick

    def status(self, tick: int) -> int:
        """DriveStatus bits: FAULT besides, where the drive has not told them for UNTOLD_TICKS."""
        return self._status if tick - self._tick <= UNTOLD_TICKS else self._status | _FAULT
