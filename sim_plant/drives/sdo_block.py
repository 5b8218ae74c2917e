"""Block transfers of an SDO server (CiA 301, 7.2.4.3.9 to 7.2.4.3.17): many segments between two acknowledgements.

Rules. A block has up to 127 segments of seven bytes, numbered from 1; the receiver acknowledges the last one that came
in order, and the sender goes on behind it. The CRC over all data is CiA 301's (polynomial 1021h, start value 0), where
the client says that it has one. Some clients check it wherever the server says so, hence it says so to no other.
"""

from binascii import crc_hqx

from drivers.eds.data_types import LARGEST_DATA
from drivers.families.cia402.cia301 import SDO, Abort
from sim_plant.drives.object_dictionary import SdoAbort

SEGMENTS = 127  # of one block, at most
_BYTES = 7  # of one segment
_CRC, _SIZE, _LAST = 0x04, 0x02, 0x80
_INITIATE_DOWNLOAD, _INITIATE_UPLOAD = 0xC0, 0xA0  # the client's; the server answers with the other one's number
_ACKNOWLEDGE, _END, _END_ANSWER = 0xA2, 0xC1, 0xA1
_START_UPLOAD = 0xA3


def answer(command: int, first: int = 0, second: int = 0) -> bytes:
    """Eight bytes without an object."""
    return bytes((command, first, second, 0, 0, 0, 0, 0))


class BlockDownload:
    """The client writes. data: what came; done: all of it has, and it is as the client says."""

    def __init__(self, command: int, index: int, subindex: int, size: int) -> None:
        """An initiating request. Raises SdoAbort."""
        self._announced = size if command & _SIZE else None
        if (self._announced or 0) > LARGEST_DATA:
            raise SdoAbort(Abort.OUT_OF_MEMORY)
        self._with_crc = bool(command & _CRC)
        self._sequence = 0
        self._ended = False
        self.data = bytearray()
        self.done = False
        self.first = SDO.pack(_INITIATE_UPLOAD | command & _CRC, index, subindex, bytes((SEGMENTS, 0, 0, 0)))

    def takes(self, request: bytes) -> bool:
        """Whether a request can be what comes next: the segment behind the last one, or the end."""
        return self._ended or request[0] & 0x7F == self._sequence + 1

    def on_request(self, request: bytes) -> list[bytes]:
        """What is answered to a segment, or to the end. Raises SdoAbort."""
        if self._ended:
            self._end(request)
            return [answer(_END_ANSWER)]
        sequence, last = request[0] & 0x7F, request[0] & _LAST
        if sequence == self._sequence + 1:
            self._sequence = sequence
            self.data += request[1:]
            self._ended = bool(last)
        if len(self.data) > LARGEST_DATA + _BYTES:
            raise SdoAbort(Abort.OUT_OF_MEMORY)
        if not last and sequence < SEGMENTS:
            return []
        told, self._sequence = self._sequence, 0
        return [answer(_ACKNOWLEDGE, told, SEGMENTS)]

    def _end(self, request: bytes) -> None:
        if request[0] & 0xE3 != _END:
            raise SdoAbort(Abort.COMMAND)
        unused = request[0] >> 2 & 7
        del self.data[len(self.data) - unused :]
        if self._announced not in (None, len(self.data)):
            raise SdoAbort(Abort.LENGTH)
        if self._with_crc and int.from_bytes(request[1:3], "little") != crc_hqx(self.data, 0):
            raise SdoAbort(Abort.CRC)
        self.done = True


class BlockUpload:
    """The client reads. done: it has all."""

    def __init__(self, command: int, index: int, subindex: int, data: bytes, segments: int) -> None:
        """An initiating request for so many segments in a block. Raises SdoAbort."""
        self._with_crc = bool(command & _CRC)
        self._data = data
        self._sent = 0  # bytes acknowledged
        self._started = False
        self.done = False
        self._take_segments(segments)
        self.first = SDO.pack(
            _INITIATE_DOWNLOAD | _SIZE | command & _CRC, index, subindex, len(data).to_bytes(4, "little")
        )

    def _take_segments(self, segments: int) -> None:
        if not 1 <= segments <= SEGMENTS:
            raise SdoAbort(Abort.BLOCK_SIZE)
        self._segments = segments

    def on_request(self, request: bytes) -> list[bytes]:
        """The next block, or the end. Raises SdoAbort."""
        if request[0] == _END_ANSWER and self._started:
            self.done = True
            return []
        if request[0] == _START_UPLOAD and not self._started:
            self._started = True
            return self._block()
        if request[0] != _ACKNOWLEDGE or not self._started:
            raise SdoAbort(Abort.COMMAND)
        if request[1] > self._segments:
            raise SdoAbort(Abort.SEQUENCE)
        self._sent += request[1] * _BYTES
        self._take_segments(request[2])
        if self._sent < len(self._data) or (not self._data and not request[1]):
            return self._block()
        unused = -len(self._data) % _BYTES if self._data else _BYTES
        crc = crc_hqx(self._data, 0) if self._with_crc else 0
        return [answer(_END | unused << 2, crc & 0xFF, crc >> 8)]

    def _block(self) -> list[bytes]:
        segments = []
        for number in range(1, self._segments + 1):
            start = self._sent + (number - 1) * _BYTES
            segment = self._data[start : start + _BYTES]
            last = _LAST if start + _BYTES >= len(self._data) else 0
            segments.append(bytes((last | number,)) + segment.ljust(_BYTES, b"\0"))
            if last:
                break
        return segments
