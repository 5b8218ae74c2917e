"""The frame of `kind = "hil"` as the host reads it, and as a node of ours sends it.

| bytes | content |
|---|---|
| 0 to 3 | int32, little-endian: the reading in counts of `scale` |
| 4 to 5 | uint16: instant of the sample on the sensor's own clock, us, modulo 65.536 ms |
| 6 | uint8: sequence, one more with every sample |
| 7 | uint8: status; 0: the reading is valid |
| 8 to 11 | FD frames alone: CRC-32 of the identifier (as its start value) and bytes 0 to 7 |
"""

from collections.abc import Callable
from struct import Struct
from typing import Final
from zlib import crc32

from drivers.frame import BRS, FD, Frame
from drivers.protocols.base import Reject
from drivers.sensors.base import Measured

CLASSIC_LENGTH: Final = 8
FD_LENGTH: Final = 12
_CLASSIC: Final = Struct("<iHBB")
_CHECKED: Final = Struct("<iHBBI")
_LEAST: Final = -(2**31)
_MOST: Final = 2**31 - 1
_RESIDUE: Final = 0x2144DF1C  # CRC-32 of anything with its own CRC-32 behind it, least significant byte first
WRAP_NS: Final = 65_536_000  # after which stamps repeat
_HALF_NS: Final = WRAP_NS // 2


class HilSensorFrame:
    """One sensor's frames. can_id: its identifier. fd: CAN FD with a checksum. scale: reading per count."""

    def __init__(self, can_id: int, *, fd: bool, scale: float) -> None:
        self.can_id = can_id
        self.can_ids = (can_id,)
        self.problem = ""
        self.length = FD_LENGTH if fd else CLASSIC_LENGTH
        self.fd = fd
        self._scale = scale
        self._unpack: Callable[[bytes], tuple[int, ...]] = _CHECKED.unpack if fd else _CLASSIC.unpack

    def decode(self, frame: Frame) -> Measured | Reject:
        """The measurement in a frame of this identifier. Never raises, whatever the bytes."""
        data = frame.data
        if bool(frame.flags & FD) != self.fd:
            return Reject.WRONG_FORMAT
        if len(data) != self.length:
            return Reject.WRONG_LENGTH
        if self.fd and crc32(data, self.can_id) != _RESIDUE:
            return Reject.BAD_CHECKSUM
        fields = self._unpack(data)
        earliest = frame.timestamp_ns - _HALF_NS
        stamp_ns = earliest + (fields[1] * 1000 - earliest) % WRAP_NS
        return Measured(fields[0] * self._scale, fields[2], stamp_ns, fields[3] == 0)

    def service(self) -> Frame | None:
        """It needs nothing."""
        return None

    def encode(self, value: float | None, sequence: int, stamp_ns: int) -> Frame:
        """A frame that a node sends. value: in the sensor's unit, brought within what a frame carries; None: not valid.
        sequence: modulo 256. stamp_ns: of the node's own clock.
        """
        counts = 0 if value is None else max(_LEAST, min(_MOST, round(value / self._scale)))
        data = _CLASSIC.pack(counts, stamp_ns // 1000 % 65_536, sequence % 256, 1 if value is None else 0)
        if self.fd:
            return Frame(self.can_id, data + crc32(data, self.can_id).to_bytes(4, "little"), FD | BRS)
        return Frame(self.can_id, data)
