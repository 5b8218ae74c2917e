"""SDO transfers, the client's side (CiA 301, 7.2.4): one access to one number of a drive's object dictionary.

Every legal answer of a server is understood: expedited with its size told or not, and segmented, which a server may
choose for any size. Block transfers are never begun: a server may not answer with one unless it is asked to. Answers
that belong to somebody else's access (another SDO client on the same channel) are told apart by object and command.
"""

from enum import Enum, auto
from typing import NamedTuple

from drivers.protocols.canopen.cia301 import SDO, Abort
from drivers.protocols.canopen.eds import object_name

_UPLOAD, _DOWNLOAD, _UPLOAD_SEGMENT, _ABORT = 0x40, 0x23, 0x60, 0x80
_COMMAND = 0xE0  # bits of a command byte that tell the kind of answer
_SEGMENT_ANSWER, _UPLOAD_ANSWER, _DOWNLOAD_ANSWER = 0x00, 0x40, 0x60
_EXPEDITED, _SIZE_TOLD = 0x02, 0x01
_TOGGLE, _LAST = 0x10, 0x01
_LONGEST = 8  # bytes of the longest number
LONGEST_STRING = 256  # bytes


class Step(NamedTuple):
    """One access to make. size: bytes of `value` to write; or 0: read, and check that the answer & mask is `value`.

    required: the drive is refused where it fails. width: bytes of the object, for answers that do not tell.
    """

    object_index: int
    subindex: int
    value: int
    size: int = 0
    mask: int = 0
    required: bool = True
    width: int = 4


class Progress(Enum):
    """What an answer means for the transfer."""

    FOREIGN = auto()  # not for it
    CONTINUE = auto()  # the next request is due
    DONE = auto()
    ABORTED = auto()


class Transfer:
    """One step under way. value: what was read, once it is done; data: its bytes. code: why the server aborted it.

    longest: bytes that are read at most; more aborts the transfer.
    """

    def __init__(self, step: Step, longest: int = _LONGEST) -> None:
        self.step = step
        self.value = 0
        self.data = b""
        self.code = 0
        self._longest = longest
        self._segmented = False
        self._toggle = 0

    def request(self) -> bytes:
        """The eight bytes to send next."""
        step = self.step
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
        if self._segmented and command & _COMMAND == _SEGMENT_ANSWER:
            return self._segment(command, data[1:])
        if (index, subindex) != (self.step.object_index, self.step.subindex):
            return Progress.FOREIGN
        if command == _ABORT:
            self.code = int.from_bytes(payload, "little")
            return Progress.ABORTED
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

    def _segment(self, command: int, payload: bytes) -> Progress:
        if command & _TOGGLE != self._toggle:
            return Progress.FOREIGN
        self.data += payload[: 7 - (command >> 1 & 7)]
        self._toggle ^= _TOGGLE
        if len(self.data) > self._longest:
            self.code = Abort.TOO_LONG
            return Progress.ABORTED
        if not command & _LAST:
            return Progress.CONTINUE
        self.value = int.from_bytes(self.data, "little")
        return Progress.DONE


def request_words(data: bytes) -> str:
    """An SDO request of eight bytes, for people."""
    command, index, subindex, payload = SDO.unpack(data)
    name = object_name(index, subindex)
    match command >> 5:
        case 1:
            length = 4 - (command >> 2 & 3) if command & _SIZE_TOLD else 4
            value = f" = {int.from_bytes(payload[:length], 'little'):#x}" if command & _EXPEDITED else ""
            return f"SDO write {name}{value}"
        case 2:
            return f"SDO read {name}"
        case 4:
            return f"SDO abort {name} with {describe_abort(int.from_bytes(payload, 'little'))}"
    return "SDO segment"


def response_words(data: bytes) -> str:
    """An SDO answer of eight bytes, for people."""
    command, index, subindex, payload = SDO.unpack(data)
    name = object_name(index, subindex)
    match command >> 5:
        case 2:
            length = 4 - (command >> 2 & 3) if command & _SIZE_TOLD else 4
            value = f" is {int.from_bytes(payload[:length], 'little'):#x}" if command & _EXPEDITED else ": segmented"
            return f"SDO {name}{value}"
        case 3:
            return f"SDO {name} written"
        case 4:
            return f"SDO {name} aborted with {describe_abort(int.from_bytes(payload, 'little'))}"
    return "SDO segment"


def describe_abort(code: int) -> str:
    """An SDO abort code in figures and, where it is one of CiA 301's, in words."""
    words = next((abort.name.lower().replace("_", " ") for abort in Abort if abort == code), "")
    return f"{code:#010x}" + (f" ({words})" if words else "")
