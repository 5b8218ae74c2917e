"""Packets of VESCs over CAN: a question of one frame, and an answer of many.

Source: the firmware (github.com/vedderb/bldc, comm/comm_can.c, comm/commands.c). Rules:
- An identifier has 29 bits: command * 256 + the VESC ID of the receiver.
- A packet of up to six bytes is one frame PROCESS_SHORT_BUFFER: the sender's VESC ID, a mode, the packet. Mode 0 asks
  for an answer to that ID; answers have mode 1.
- A longer one comes in pieces: FILL_RX_BUFFER has an offset of one byte and seven bytes of the packet, from offset 259
  on FILL_RX_BUFFER_LONG has an offset of two bytes and six of the packet. PROCESS_RX_BUFFER ends it: the sender's VESC
  ID, mode, length and CRC-16 (polynomial 1021h, from 0), big-endian.
- Pieces name their receiver and not their sender. Each drive is therefore asked in the name of an ID of its own.
"""

from binascii import crc_hqx
from struct import Struct
from typing import Final, NamedTuple

from drivers.frame import EXTENDED, FD, Frame
from drivers.protocols.base import Reject

FILL_RX_BUFFER, FILL_RX_BUFFER_LONG, PROCESS_RX_BUFFER, PROCESS_SHORT_BUFFER = 5, 6, 7, 8
ANSWERED: Final = 0, 1  # modes: an answer is wanted, this is one
LONGEST: Final = 512  # bytes of a packet; the firmware's buffers hold no more
MOST_FRAMES: Final = {FILL_RX_BUFFER: 37, FILL_RX_BUFFER_LONG: 43, PROCESS_RX_BUFFER: 1}  # of such a packet

_END = Struct(">BBHH")


class Packet(NamedTuple):
    """An answer that came whole: the number of the question, and what follows it."""

    command: int
    data: bytes


def identifier(command: int, vesc_id: int) -> int:
    """Identifier of a frame to a VESC."""
    return EXTENDED | command << 8 | vesc_id


def question(command: int, vesc_id: int, asker: int) -> Frame:
    """The frame that asks a VESC in the name of `asker`, a VESC ID, too."""
    return Frame(identifier(PROCESS_SHORT_BUFFER, vesc_id), bytes((asker, ANSWERED[0], command)))


class Assembly:
    """The packets that one VESC sends to one asker, from their pieces. A lost piece spoils a packet; the next one
    begins anew.
    """

    def __init__(self, vesc_id: int) -> None:
        self._vesc_id = vesc_id
        self._data = bytearray()
        self._whole = False

    def take(self, command: int, frame: Frame) -> Packet | Reject | None:
        """A frame to this asker: the packet that it ends; why it is of no use; None for all else."""
        if frame.flags & FD:
            return Reject.WRONG_FORMAT
        head = {FILL_RX_BUFFER: 1, FILL_RX_BUFFER_LONG: 2}.get(command)
        if head is None:
            return self._end(frame.data)
        if len(frame.data) <= head:
            return Reject.WRONG_LENGTH
        offset, piece = int.from_bytes(frame.data[:head], "big"), frame.data[head:]
        if offset == 0:
            self._data.clear()
            self._whole = True
        elif offset == len(self._data) - len(piece) and self._data.endswith(piece):
            return None  # CAN may repeat a frame
        self._whole = self._whole and offset == len(self._data) <= LONGEST - len(piece)
        self._data += piece if self._whole else b""
        return None

    def _end(self, data: bytes) -> Packet | Reject | None:
        if len(data) != _END.size:
            return Reject.WRONG_LENGTH
        sender, mode, length, crc = _END.unpack(data)
        if sender != self._vesc_id or mode != ANSWERED[1]:
            return Reject.SERVICE
        came, self._whole = self._whole and length == len(self._data) > 0, False
        if not came:
            return None
        return Packet(self._data[0], bytes(self._data[1:])) if crc_hqx(self._data, 0) == crc else Reject.BAD_CHECKSUM
