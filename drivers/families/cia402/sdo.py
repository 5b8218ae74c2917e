"""SDO transfers, the client's side (CiA 301, 7.2.4): one access to one number of a drive's object dictionary.

Every legal answer of a server is understood: expedited with its size told or not, and segmented, which a server may
choose for any size. A server that refuses to upload an object so is asked for it by blocks (7.2.4.3.13), which it may
not choose by itself. A block has one segment, as the schedule counts on one answer to a request. Answers that belong to
somebody else's access (another SDO client on the same channel) are told apart by object and command.
"""

from binascii import crc_hqx
from enum import Enum, auto
from typing import NamedTuple

from drivers.eds.reader import object_name
from drivers.families.cia402.cia301 import SDO, Abort

_UPLOAD, _DOWNLOAD, _UPLOAD_SEGMENT, _ABORT = 0x40, 0x23, 0x60, 0x80
_COMMAND = 0xE0  # bits of a command byte that tell the kind of answer
_SEGMENT_ANSWER, _UPLOAD_ANSWER, _DOWNLOAD_ANSWER = 0x00, 0x40, 0x60
_EXPEDITED, _SIZE_TOLD = 0x02, 0x01
_TOGGLE, _LAST = 0x10, 0x01
_BLOCK_UPLOAD, _BLOCK_START, _BLOCK_ACKNOWLEDGE, _BLOCK_END = 0xA0, 0xA3, 0xA2, 0xA1
_BLOCK_ANSWER, _BLOCK_END_ANSWER, _CRC, _BLOCK_SIZE_TOLD = 0xC0, 0xC1, 0x04, 0x02
_LAST_SEGMENT = 0x80
_INSISTS = (Abort.COMMAND, Abort.UNSUPPORTED)  # how a server says that it uploads an object by blocks alone
_LONGEST = 8  # bytes of the longest number
LONGEST_STRING = 256  # bytes


class Step(NamedTuple):
    """One access to make. size: bytes of `value` to write; or 0: read, and check that the answer & mask is `value`.

    required: the drive is refused where it fails. width: bytes of the object, for answers that do not tell. proof: it
    reads back what an earlier step wrote, or 6061h what 6060h was told. The drive is refused where it fails; it is not
    made where the write was left out.
    """

    object_index: int
    subindex: int
    value: int
    size: int = 0
    mask: int = 0
    required: bool = True
    width: int = 4
    proof: bool = False


class Progress(Enum):
    """What an answer means for the transfer."""

    FOREIGN = auto()  # not for it
    CONTINUE = auto()  # the next request is due
    DONE = auto()
    ABORTED = auto()


class Transfer:
    """One step under way. value: what was read, once it is done; data: its bytes. code: why it was aborted. closing:
    eight bytes still to be sent once it is over, which are not answered; empty where there are none.

    longest: bytes that are read at most; more aborts the transfer.
    """

    def __init__(self, step: Step, longest: int = _LONGEST) -> None:
        self.step = step
        self.value = 0
        self.data = b""
        self.code = 0
        self.closing = b""
        self._block: BlockUpload | None = None
        self._longest = longest
        self._segmented = False
        self._toggle = 0

    def request(self) -> bytes:
        """The eight bytes to send next."""
        step = self.step
        if self._block is not None:
            return self._block.request()
        if self._segmented:
            return bytes((_UPLOAD_SEGMENT | self._toggle, 0, 0, 0, 0, 0, 0, 0))
        if not step.size:
            return SDO.pack(_UPLOAD, step.object_index, step.subindex, bytes(4))
        command = _DOWNLOAD | (4 - step.size) << 2
        return SDO.pack(command, step.object_index, step.subindex, step.value.to_bytes(4, "little"))

    def abort(self, code: Abort) -> bytes:
        """The eight bytes that end the transfer."""
        return SDO.pack(_ABORT, self.step.object_index, self.step.subindex, code.to_bytes(4, "little"))

    def answer(self, data: bytes) -> Progress:
        """Follow an answer of eight bytes."""
        command, index, subindex, payload = SDO.unpack(data)
        if self._block is not None and self._block.answers(command):
            return self._follow_block(self._block, data)
        if self._segmented and command & _COMMAND == _SEGMENT_ANSWER:
            return self._segment(command, data[1:])
        named = (index, subindex)
        if command == _ABORT and named == (0, 0):  # some servers name no object in it
            named = (self.step.object_index, self.step.subindex)
        if named != (self.step.object_index, self.step.subindex):
            return Progress.FOREIGN
        if command == _ABORT:
            return self._aborted(int.from_bytes(payload, "little"))
        if self.step.size:
            return Progress.DONE if command & _COMMAND == _DOWNLOAD_ANSWER else Progress.FOREIGN
        if command & _COMMAND != _UPLOAD_ANSWER or self._segmented:
            return Progress.FOREIGN
        if not command & _EXPEDITED:
            self._segmented = True
            return Progress.CONTINUE
        length = 4 - (command >> 2 & 3) if command & _SIZE_TOLD else min(self.step.width, 4)
        self.data = payload[:length]
        self.value = int.from_bytes(self.data, "little")
        return Progress.DONE

    def _aborted(self, code: int) -> Progress:
        """The server ends it; where it has not been asked for blocks, it may mean that it wants to."""
        if code in _INSISTS and not self.step.size and self._block is None:
            self.code, self._segmented, self.data = code, False, b""
            self._block = BlockUpload(self.step, self._longest)
            return Progress.CONTINUE
        if self._block is None or self._block.begun:
            self.code = code  # else what it said first says more
        return Progress.ABORTED

    def _follow_block(self, block: "BlockUpload", data: bytes) -> Progress:
        progress = block.answer(data)
        if progress is Progress.ABORTED:
            self.code, self.closing = block.code, self.abort(block.code)
        elif progress is Progress.DONE:
            self.code, self.closing = 0, _plain(_BLOCK_END)
            self.data, self.value = block.data, int.from_bytes(block.data, "little")
        return progress

    def _segment(self, command: int, payload: bytes) -> Progress:
        if command & _TOGGLE != self._toggle:
            return Progress.FOREIGN
        self.data += payload[: 7 - (command >> 1 & 7)]
        self._toggle ^= _TOGGLE
        if len(self.data) > self._longest:
            self.code, self.closing = Abort.TOO_LONG, self.abort(Abort.TOO_LONG)
            return Progress.ABORTED
        if not command & _LAST:
            return Progress.CONTINUE
        self.value = int.from_bytes(self.data, "little")
        return Progress.DONE


def _plain(command: int, first: int = 0, second: int = 0) -> bytes:
    """Eight bytes without an object."""
    return bytes((command, first, second, 0, 0, 0, 0, 0))


class BlockUpload:
    """A block upload, the client's side. data: what has come. begun: the server agreed. code: why this side ends it."""

    def __init__(self, step: Step, longest: int) -> None:
        self.data = b""
        self.code = Abort.COMMAND
        self._step = step
        self._longest = longest
        self._with_crc = False
        self.begun = False
        self._ended = False  # the last segment has come
        self._next = SDO.pack(_BLOCK_UPLOAD | _CRC, step.object_index, step.subindex, bytes((1, 0, 0, 0)))

    def request(self) -> bytes:
        """The eight bytes to send next."""
        return self._next

    def answers(self, command: int) -> bool:
        """Whether a command byte is one that the server may answer with now."""
        if not self.begun:
            return command & _COMMAND == _BLOCK_ANSWER
        return command & (_COMMAND | 3) == _BLOCK_END_ANSWER if self._ended else command & ~_LAST_SEGMENT == 1

    def answer(self, data: bytes) -> Progress:
        """Follow such an answer."""
        if not self.begun:
            return self._begin(*SDO.unpack(data))
        if self._ended:
            return self._end(data)
        self._ended = bool(data[0] & _LAST_SEGMENT)
        self.data += data[1:]
        self._next = _plain(_BLOCK_ACKNOWLEDGE, 1, 1)
        return self._abort(Abort.TOO_LONG) if len(self.data) > self._longest + 6 else Progress.CONTINUE

    def _begin(self, command: int, index: int, subindex: int, size: bytes) -> Progress:
        if (index, subindex) != (self._step.object_index, self._step.subindex):
            return Progress.FOREIGN
        self.begun, self._with_crc, self._next = True, bool(command & _CRC), _plain(_BLOCK_START)
        told = int.from_bytes(size, "little") if command & _BLOCK_SIZE_TOLD else 0
        return self._abort(Abort.TOO_LONG) if told > self._longest else Progress.CONTINUE

    def _end(self, data: bytes) -> Progress:
        unused = data[0] >> 2 & 7
        self.data = self.data[: len(self.data) - unused]
        if self._with_crc and crc_hqx(self.data, 0) != data[1] | data[2] << 8:
            return self._abort(Abort.CRC)
        return self._abort(Abort.TOO_LONG) if len(self.data) > self._longest else Progress.DONE

    def _abort(self, code: Abort) -> Progress:
        self.code = code
        return Progress.ABORTED


def _expedited(command: int, payload: bytes) -> int:
    """The value that a message itself carries."""
    length = 4 - (command >> 2 & 3) if command & _SIZE_TOLD else 4
    return int.from_bytes(payload[:length], "little")


def request_words(data: bytes) -> str:
    """An SDO request of eight bytes, for people."""
    command, index, subindex, payload = SDO.unpack(data)
    name = object_name(index, subindex)
    match command >> 5:
        case 1:
            return f"SDO write {name}{f' = {_expedited(command, payload):#x}' if command & _EXPEDITED else ''}"
        case 2:
            return f"SDO read {name}"
        case 4:
            return f"SDO abort {name} with {describe_abort(int.from_bytes(payload, 'little'))}"
        case 5 if not command & 3:
            return f"SDO read {name} by blocks"
        case 6 if not command & 1:
            return f"SDO write {name} by blocks"
    return "SDO segment"


def response_words(data: bytes) -> str:
    """An SDO answer of eight bytes, for people."""
    command, index, subindex, payload = SDO.unpack(data)
    name = object_name(index, subindex)
    match command >> 5:
        case 2:
            return f"SDO {name}{f' is {_expedited(command, payload):#x}' if command & _EXPEDITED else ': segmented'}"
        case 3:
            return f"SDO {name} written"
        case 4:
            return f"SDO {name} aborted with {describe_abort(int.from_bytes(payload, 'little'))}"
        case 5 | 6 if not command & (3 if command >> 5 == 5 else 1):
            return f"SDO {name}: by blocks"
    return "SDO segment"


def describe_abort(code: int) -> str:
    """An SDO abort code in figures and, where it is one of CiA 301's, in words."""
    words = next((abort.name.lower().replace("_", " ") for abort in Abort if abort == code), "")
    return f"{code:#010x}" + (f" ({words})" if words else "")
