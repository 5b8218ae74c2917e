"""SDO server of CiA 301, 7.2.4: expedited, segmented and block transfers both ways, with abort codes."""

from drivers.eds.data_types import LARGEST_DATA
from drivers.families.cia402.cia301 import SDO, Abort
from sim_plant.drives.object_dictionary import ObjectDictionary, SdoAbort
from sim_plant.drives.quirks import NO_QUIRKS, Quirks
from sim_plant.drives.sdo_block import BlockDownload, BlockUpload
from sim_plant.drives.servo import NEVER_NS

_EMPTY = bytes(4)
_ABORT = 0x80
_PATIENCE_NS = 1_000_000_000  # with the client of a block transfer


class SdoServer:
    """Answers one client, one transfer at a time; a new initiate request ends an unfinished transfer.

    deadline_ns: when a block transfer is given up because its client fell silent. In a block download the server
    answers no single segment: a client that begins something else there is recognised where its request cannot be the
    next segment and names an object, else after that time.
    """

    def __init__(self, dictionary: ObjectDictionary, quirks: Quirks = NO_QUIRKS) -> None:
        self._dictionary = dictionary
        self._answers = quirks.answers
        self._index = 0
        self._subindex = 0
        self.reset()

    def reset(self) -> None:
        """Forget an unfinished transfer."""
        self._download: bytearray | None = None
        self._announced: int | None = None
        self._upload: bytes | None = None
        self._block: BlockDownload | BlockUpload | None = None
        self.deadline_ns = NEVER_NS
        self._sent = 0
        self._toggle = 0

    def on_request(self, request: bytes, now_ns: int = 0) -> list[bytes]:
        """The 8-byte answers to an 8-byte request. Never raises."""
        try:
            if self._block is not None and request[0] != _ABORT and not self._begins_anew(request):
                answers = self._continue_block(request)
            else:
                answers = self._start_or_continue(request)
        except SdoAbort as refusal:
            answers = [self._refusal(refusal.code)]
        self.deadline_ns = now_ns + _PATIENCE_NS if self._block is not None else NEVER_NS
        return answers

    def give_up(self) -> list[bytes]:
        """The client of a block transfer fell silent."""
        return [self._refusal(Abort.TIMEOUT)]

    def _refusal(self, code: int) -> bytes:
        self.reset()
        return SDO.pack(_ABORT, self._index, self._subindex, int(code).to_bytes(4, "little"))

    def _begins_anew(self, request: bytes) -> bool:
        """In the midst of a block transfer: a request that begins another one, and cannot belong to this one."""
        block = self._block
        command, index, subindex, data = SDO.unpack(request)
        if isinstance(block, BlockUpload):  # its client sends nothing but a start, acknowledgements and an end
            return command >> 5 in (1, 2, 6) or (command >> 5 == 5 and not command & 0x03)
        if block is None or block.takes(request):
            return False
        reads = command == 0x40 and data == _EMPTY
        initiates = reads or command >> 5 == 1 or command & ~0x04 == 0xA0 or command & ~0x06 == 0xC0
        return initiates and self._dictionary.has(index, subindex)

    def _start_or_continue(self, request: bytes) -> list[bytes]:
        command, index, subindex, data = SDO.unpack(request)
        match command >> 5:
            case 0:
                return [self._continue_download(command, request[1:])]
            case 1:
                return [self._start_download(command, index, subindex, data)]
            case 2:
                return [self._start_upload(index, subindex)]
            case 3:
                return [self._continue_upload(command)]
            case 4:
                self.reset()
                return []
            case 5 if not command & 0x03:
                return [self._start_block_upload(command, index, subindex, data)]
            case 6 if not command & 0x01:
                return [self._start_block_download(command, index, subindex, data)]
        self._index, self._subindex = index, subindex
        raise SdoAbort(Abort.COMMAND)

    def _continue_block(self, request: bytes) -> list[bytes]:
        block = self._block
        assert block is not None
        answers = block.on_request(request)
        if block.done:
            if isinstance(block, BlockDownload):
                self._dictionary.write(self._index, self._subindex, bytes(block.data))
            self.reset()
        return answers

    def _start_block_upload(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        """Where the client bears it (its threshold, byte 5), short values go the plain way."""
        self._open(index, subindex)
        value = self._dictionary.read(index, subindex)
        if len(value) <= data[1] and self._answers != "block":
            return self._start_upload(index, subindex)
        self._block = BlockUpload(command, index, subindex, value, data[0])
        return self._block.first

    def _start_block_download(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        self._open(index, subindex)
        if not self._dictionary.entry(index, subindex).writable:
            raise SdoAbort(Abort.READ_ONLY)
        self._block = BlockDownload(command, index, subindex, int.from_bytes(data, "little"))
        return self._block.first

    def _open(self, index: int, subindex: int) -> None:
        self.reset()
        self._index, self._subindex = index, subindex

    def _start_download(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        self._open(index, subindex)
        entry = self._dictionary.entry(index, subindex)
        sized = command & 0x01
        if command & 0x02:  # expedited
            unused = command >> 2 & 3 if sized else 4 - (min(entry.size, 4) or 4)
            self._dictionary.write(index, subindex, data[: 4 - unused])
        else:
            if not entry.writable:
                raise SdoAbort(Abort.READ_ONLY)
            self._announced = int.from_bytes(data, "little") if sized else None
            if (self._announced or 0) > LARGEST_DATA:
                raise SdoAbort(Abort.OUT_OF_MEMORY)
            self._download = bytearray()
        return SDO.pack(0x60, index, subindex, _EMPTY)

    def _continue_download(self, command: int, data: bytes) -> bytes:
        if self._download is None:
            raise SdoAbort(Abort.COMMAND)
        self._check_toggle(command)
        self._download += data[: 7 - (command >> 1 & 7)]
        if len(self._download) > LARGEST_DATA:
            raise SdoAbort(Abort.OUT_OF_MEMORY)
        if command & 0x01:  # last segment
            if self._announced not in (None, len(self._download)):
                raise SdoAbort(Abort.LENGTH)
            self._dictionary.write(self._index, self._subindex, bytes(self._download))
            self.reset()
        return bytes((0x20 | command & 0x10, 0, 0, 0, 0, 0, 0, 0))

    def _start_upload(self, index: int, subindex: int) -> bytes:
        self._open(index, subindex)
        data = self._dictionary.read(index, subindex)
        if self._answers == "block" and len(data) > 4:
            raise SdoAbort(Abort.COMMAND)
        if 1 <= len(data) <= 4 and self._answers != "segmented":
            command = 0x42 if self._answers == "unsized" else 0x43 | (4 - len(data)) << 2
            return SDO.pack(command, index, subindex, data)
        self._upload = data
        return SDO.pack(0x41, index, subindex, len(data).to_bytes(4, "little"))

    def _continue_upload(self, command: int) -> bytes:
        if self._upload is None:
            raise SdoAbort(Abort.COMMAND)
        self._check_toggle(command)
        segment = self._upload[self._sent : self._sent + 7]
        self._sent += 7
        last = 0x01 if self._sent >= len(self._upload) else 0
        head = command & 0x10 | (7 - len(segment)) << 1 | last
        if last:
            self.reset()
        return bytes((head,)) + segment.ljust(7, b"\0")

    def _check_toggle(self, command: int) -> None:
        if command >> 4 & 1 != self._toggle:
            raise SdoAbort(Abort.TOGGLE)
        self._toggle ^= 1
