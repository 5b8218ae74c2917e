"""Emulated output nodes that are not ours: by a DBC file, which cantools reads, and by a CANopen device's EDS."""

from collections.abc import Mapping
from pathlib import Path

import cantools
from cantools.database.can import Database

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Emergency, NmtState
from drivers.frame import FD, Frame
from drivers.outputs.config import OutputConfig
from sim_plant.drives.canopen_node import COMMUNICATION, CanopenNode
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.pdo import Pdo
from sim_plant.drives.quirks import NO_QUIRKS
from sim_plant.nodes.output import NEVER_NS, OutputNode

_WRITE, _ERROR_MODE, _ERROR_VALUE = 0x6200, 0x6206, 0x6207  # CiA 401: outputs, eight a sub-index
_EVENT_TIMER = key_of(0x1400, 5)


class SignalOutputNode(OutputNode):
    """kind = "dbc". Of a message with a counter, a frame whose count is that of the one before is ignored."""

    def __init__(self, outputs: Mapping[str, OutputConfig], base_dir: Path) -> None:
        config = next(iter(outputs.values()))
        super().__init__(config.can_id)
        database = cantools.database.load_file(base_dir / config.file, database_format="dbc", encoding="cp1252")
        assert isinstance(database, Database)
        self._message = database.get_message_by_frame_id(config.can_id)
        self._places = [(output.signal, output.bit) for output in outputs.values()]
        self._count: object
        self._counter, self._fd, self._count = config.counter, config.fd, None

    def hear(self, frame: Frame, now_ns: int) -> None:
        """See OutputNode."""
        if len(frame.data) < self._message.length or bool(frame.flags & FD) != self._fd:
            self.ignored += 1
            return
        values = self._message.decode(frame.data[: self._message.length], decode_choices=False)
        assert isinstance(values, dict)
        count = values[self._counter] if self._counter else None
        if self._counter and count == self._count:
            self.ignored += 1
            return
        self._count = count
        self._take(sum(1 << bit for signal, bit in self._places if values[signal] == 1), now_ns)


class _Device(CanopenNode):
    """An I/O device. lines: what it switches, by sub-index of 6200h; fallen: its host is silent, or it does not run."""

    def __init__(self, node: int, eds: Path, used: set[int]) -> None:
        self.lines = dict.fromkeys(used, 0)
        self.fallen = True
        self.deadline_ns = NEVER_NS
        super().__init__(node, 0, eds, NO_QUIRKS)
        self._boot()

    def _use_rpdo(self, pdo: Pdo, data: bytes) -> None:
        super()._use_rpdo(pdo, data)
        if self.fallen:
            self._emergency.raise_error(Emergency.NONE, 0)
        self.fallen = False
        milliseconds = self.dictionary.number(_EVENT_TIMER)
        self.deadline_ns = self.now_ns + milliseconds * 1_000_000 if milliseconds else NEVER_NS

    def _live(self) -> None:
        if self.now_ns >= self.deadline_ns:
            self._emergency.raise_error(Emergency.RPDO_TIMEOUT, COMMUNICATION)
            self._fall()

    def _on_master_lost(self) -> None:
        self._emergency.raise_error(Emergency.HEARTBEAT, COMMUNICATION)
        self._fall()

    def _close(self) -> None:
        self._fall()

    def _fall(self) -> None:
        self.fallen, self.deadline_ns = True, NEVER_NS

    def switch(self) -> None:
        """Bring the lines to what they are to be by now."""
        number = self.dictionary.number
        fallen = self.fallen or self.nmt is not NmtState.OPERATIONAL
        for block, before in self.lines.items():
            if not fallen:
                self.lines[block] = number(key_of(_WRITE, block))
                continue
            mode, value = number(key_of(_ERROR_MODE, block), 0xFF), number(key_of(_ERROR_VALUE, block))
            self.lines[block] = before & ~mode | value & mode


class CanopenOutputNode(OutputNode):
    """kind = "cia401" or "cia404": started by its host, and answers at once."""

    def __init__(self, outputs: Mapping[str, OutputConfig], base_dir: Path) -> None:
        config = next(iter(outputs.values()))
        super().__init__(config.can_id)
        self._places = [(*divmod(output.channel - 1, 8), output.bit) for output in outputs.values()]
        self.device = device = _Device(config.node, base_dir / config.file, {1 + at for at, _, _ in self._places})
        emergency = device.dictionary.number(key_of(0x1014)) & cia301.STANDARD_IDS
        self.can_ids = (cia301.SDO_RESPONSE_ID + config.node, cia301.HEARTBEAT_ID + config.node)
        self.can_ids += (emergency,) if emergency else ()
        self._unsaid: list[Frame] = []

    def hear(self, frame: Frame, now_ns: int) -> None:
        """See OutputNode."""
        self.taken += 1
        self._unsaid = self.heed(frame, now_ns)

    def heed(self, frame: Frame, now_ns: int) -> list[Frame]:
        """See OutputNode: what it says by itself goes out with its next answer."""
        said = self._unsaid + self.device.on_frame(frame._replace(timestamp_ns=now_ns))
        self._unsaid = []
        self._switch()
        return said

    def expire(self, now_ns: int) -> None:
        """See OutputNode."""
        if self.device.deadline_ns <= now_ns:
            self._unsaid += self.device.advance(now_ns)
            self._switch()

    def _switch(self) -> None:
        self.device.switch()
        lines = self.device.lines
        self.bits = sum((lines[1 + at] >> line & 1) << bit for at, line, bit in self._places)
        self.deadline_ns = self.device.deadline_ns
