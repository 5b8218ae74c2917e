"""An emulated CANopen node (CiA 301), whatever it does: network management, services, PDOs, SYNC, by any EDS.

What the node has and takes is what its EDS says, every object as the file types it. A kind of device fills in the
hooks at the end. No I/O and no clock: time comes in with frames and `advance`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, Emergency, NmtCommand, NmtState, is_restricted
from drivers.frame import FD, Frame
from sim_plant.drives.emergency import EmergencyProducer
from sim_plant.drives.object_dictionary import ObjectDictionary, SdoAbort, key_of
from sim_plant.drives.pdo import MOST_PDOS, Pdo
from sim_plant.drives.quirks import Quirks
from sim_plant.drives.sdo_server import SdoServer
from sim_plant.drives.servo import NEVER_NS

GENERIC, COMMUNICATION = 0x01, 0x10  # bits of the error register, 1001h

_SYNC_OVERFLOW = key_of(0x1019)
_CYCLE_PERIOD = key_of(0x1006)
_SYNC_COB = key_of(0x1005)
_EMERGENCY_COB = key_of(0x1014)
_ERROR_BEHAVIOUR = key_of(0x1029, 1)
_CONSUMER_HEARTBEAT = key_of(0x1016, 1)
_PRODUCER_HEARTBEAT = key_of(0x1017)
_TO_PRE_OPERATIONAL, _TO_STOPPED = 0, 2  # 1029h; 1: no change
_MOST_DELAYED = 4096  # answers that wait
_HEARTBEAT_WAIT_NS = 100_000_000  # at most, for a SYNC whose period is said to be longer
_CONTINUOUS = {key_of(cia301.POSITION), key_of(cia301.TORQUE_ACTUAL), key_of(0x606C)}  # change all the time


class CanopenNode:
    """One node.

    node_id: 1 to 127. eds: its EDS or DCF file. quirks: in what it differs from it. nmt: its network state.
    sampled_ns: last SYNC that was answered. next_ns: never, as what it sends by itself may wait for the next SYNC.
    Frames are to be given to every node on the bus in the order of reception, each stamped with the reception time, ns.
    Raises ValueError for an EDS that cannot be read.
    """

    def __init__(self, node_id: int, start_ns: int, eds: Path, quirks: Quirks) -> None:
        self.node_id = node_id
        self.now_ns = start_ns
        self.nmt = NmtState.BOOT_UP
        self._sync_counter = 0
        self._sync_count = 0
        self.sampled_ns = -NEVER_NS
        self.next_ns = NEVER_NS
        self._heartbeat_ns = NEVER_NS
        self._master_deadline_ns = NEVER_NS
        self._out: list[Frame] = []
        self._delayed: list[tuple[int, Frame]] = []
        self._received: dict[Pdo, bytes] = {}
        self._quirks = quirks
        self.dictionary = dictionary = ObjectDictionary(node_id, eds, quirks)
        self._sdo = SdoServer(dictionary, quirks)
        self._emergency = EmergencyProducer(dictionary)
        dictionary.setters |= {
            _PRODUCER_HEARTBEAT: self._schedule_heartbeat,
            _CONSUMER_HEARTBEAT: self._take_consumer,
            _SYNC_COB: self._take_sync,
            _SYNC_OVERFLOW: self._take_overflow,
            _EMERGENCY_COB: self._take_emergency,
            key_of(0x1003): self._take_history,
        }
        changed = self._find_handlers
        self._handlers: dict[int, Callable[[bytes], None]] = {}
        self._rpdos: list[Pdo] = []
        self._tpdos: list[Pdo] = []
        self._rpdos = [Pdo(dictionary, at, at + 0x200, changed) for at in self._pdo_records(0x1400)]
        self._tpdos = [Pdo(dictionary, at, at + 0x200, changed) for at in self._pdo_records(0x1800)]
        self._told: dict[Pdo, tuple[int | float | bytes, ...]] = {}  # what event-driven TPDOs said last

    def _pdo_records(self, first: int) -> list[int]:
        entries = self.dictionary.entries
        records = range(first, first + MOST_PDOS)
        return [at for at in records if key_of(at, 1) in entries and key_of(at + 0x200) in entries]

    # in and out -------------------------------------------------------------------------------------------------------

    def on_frame(self, frame: Frame) -> list[Frame]:
        """What the node sends at the reception of a frame; whatever fell due before comes first. Never raises."""
        can_id, data, flags, now_ns = frame
        self._pass_time(now_ns)
        handler = self._handlers.get(can_id)
        if handler is not None and not flags & FD:
            handler(data)
        return self._take()

    def advance(self, now_ns: int) -> list[Frame]:
        """Let time pass to now_ns: heartbeats, and what the device found by itself."""
        self._pass_time(now_ns)
        return self._take()

    def _take(self) -> list[Frame]:
        if self.nmt is not NmtState.STOPPED:
            self._out += self._emergency.due(self.now_ns)
        if self.nmt is NmtState.OPERATIONAL:
            self._tell_events()
        out, self._out = self._out, []
        return out

    def _tell_events(self) -> None:
        """Event-driven TPDOs: sent when what they carry of the drive's state changes, not with every count."""
        for pdo in self._tpdos:
            if pdo.can_id >= 0 and pdo.event_driven:
                state = tuple(self.dictionary.get(key) for key in pdo.keys if key not in _CONTINUOUS)
                if self._told.get(pdo) != state:
                    self._told[pdo] = state
                    self._send_pdo(pdo)

    def _send_pdo(self, pdo: Pdo) -> None:
        self._send(pdo.can_id, pdo.pack())

    def _send(self, can_id: int, data: bytes) -> None:
        self._out.append(Frame(can_id, data))

    def _pass_time(self, now_ns: int) -> None:
        self.now_ns = max(now_ns, self.now_ns)
        if self.nmt is NmtState.BOOT_UP:
            self._enter_pre_operational()
        if self.now_ns >= self._heartbeat_ns and not self._is_cyclic():
            self._send_heartbeat()
        if self.now_ns >= self._master_deadline_ns:
            self._master_deadline_ns = NEVER_NS
            self._on_master_lost()
            self._leave_operational()
        if self.now_ns >= self._sdo.deadline_ns:
            self._answer(self._sdo.give_up())
        while self._delayed and self._delayed[0][0] <= self.now_ns:
            self._out.append(self._delayed.pop(0)[1])
        self._live()

    # network management -----------------------------------------------------------------------------------------------

    def _boot(self) -> None:
        """As after power-up: communication objects at their defaults; the boot-up message goes out at the next step."""
        self._close()
        self.dictionary.restore(0x1000, 0x1FFF)
        for pdo in self._rpdos + self._tpdos:
            pdo.restore()
        self._sdo.reset()
        self._emergency.reset()
        self._delayed.clear()
        self._told.clear()
        self._heartbeat_ns = self._master_deadline_ns = NEVER_NS
        self.nmt = NmtState.BOOT_UP
        self._find_handlers()

    def _enter_pre_operational(self) -> None:
        self.nmt = NmtState.PRE_OPERATIONAL
        self._send(cia301.HEARTBEAT_ID + self.node_id, b"\0")

    def _on_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        match data[0]:
            case NmtCommand.START:
                self.nmt = NmtState.OPERATIONAL
            case NmtCommand.STOP:
                self._close()
                self.nmt = NmtState.STOPPED
            case NmtCommand.PRE_OPERATIONAL:
                self._close()
                self.nmt = NmtState.PRE_OPERATIONAL
            case NmtCommand.RESET_COMMUNICATION | NmtCommand.RESET_NODE:
                self._boot()
                if data[0] == NmtCommand.RESET_NODE:
                    self._restore()
                self._enter_pre_operational()
            case _:
                return
        self._received.clear()

    def _leave_operational(self) -> None:
        """1029h: what a communication error does to the NMT state; CiA 301 without the object: pre-operational."""
        behaviour = self.dictionary.number(_ERROR_BEHAVIOUR, _TO_PRE_OPERATIONAL)
        if behaviour == _TO_STOPPED:
            self.nmt = NmtState.STOPPED
        elif behaviour == _TO_PRE_OPERATIONAL and self.nmt is NmtState.OPERATIONAL:
            self.nmt = NmtState.PRE_OPERATIONAL

    def _is_cyclic(self) -> bool:
        """Whether SYNCs come in time. Then a heartbeat waits for the next and goes behind its TPDOs, as the priorities
        of a real controller's mailboxes would have it; here frames leave in the order in which they are queued."""
        patience_ns = min(2000 * self.dictionary.number(_CYCLE_PERIOD), _HEARTBEAT_WAIT_NS)
        return self.now_ns - self.sampled_ns < patience_ns

    def _send_heartbeat(self) -> None:
        self._send(cia301.HEARTBEAT_ID + self.node_id, bytes((self.nmt,)))
        self._schedule_heartbeat(self.dictionary.number(_PRODUCER_HEARTBEAT))

    def _schedule_heartbeat(self, milliseconds: int) -> None:
        self._heartbeat_ns = self.now_ns + milliseconds * 1_000_000 if milliseconds else NEVER_NS

    def _on_master_heartbeat(self, data: bytes) -> None:
        milliseconds = self.dictionary.number(_CONSUMER_HEARTBEAT) & 0xFFFF
        if len(data) == 1 and milliseconds:
            self._master_deadline_ns = self.now_ns + milliseconds * 1_000_000

    # services ---------------------------------------------------------------------------------------------------------

    def _find_handlers(self) -> None:
        """Rebuild the table of identifiers this node listens to; what waits in an RPDO that ends is gone."""
        self._received = {pdo: data for pdo, data in self._received.items() if pdo.can_id >= 0}
        number, node = self.dictionary.number, self.node_id
        handlers: dict[int, Callable[[bytes], None]] = {}
        for pdo in reversed(self._rpdos):
            handlers[pdo.can_id] = partial(self._on_rpdo, pdo)  # -1, of an invalid one, is no frame's
        master = number(_CONSUMER_HEARTBEAT) >> 16 & 0x7F
        handlers[cia301.HEARTBEAT_ID + master] = self._on_master_heartbeat
        handlers[number(_SYNC_COB, cia301.SYNC_ID) & cia301.STANDARD_IDS] = self._on_sync
        handlers[cia301.SDO_REQUEST_ID + node] = self._on_sdo
        handlers[cia301.NMT_ID] = self._on_nmt
        self._handlers = handlers

    def _on_sdo(self, data: bytes) -> None:
        if len(data) != 8 or self.nmt is NmtState.STOPPED:
            return
        self._answer(self._sdo.on_request(data, self.now_ns))

    def _answer(self, answers: Sequence[bytes]) -> None:
        """SDO answers, at once or later; a client that does not wait for them gets no more than there is room for."""
        frames = [Frame(cia301.SDO_RESPONSE_ID + self.node_id, answer) for answer in answers]
        if not self._quirks.answer_delay_ns:
            self._out += frames
        elif len(self._delayed) < _MOST_DELAYED:
            self._delayed += [(self.now_ns + self._quirks.answer_delay_ns, frame) for frame in frames]

    def _on_rpdo(self, pdo: Pdo, data: bytes) -> None:
        if self.nmt is not NmtState.OPERATIONAL:
            return
        if len(data) < pdo.layout.size:
            self._emergency.raise_error(Emergency.PDO_TOO_SHORT, COMMUNICATION)
        elif pdo.synchronous:
            self._received[pdo] = data
        else:
            self._use_rpdo(pdo, data)

    def _use_rpdo(self, pdo: Pdo, data: bytes) -> None:
        for key, value in zip(pdo.keys, pdo.unpack(data), strict=True):
            if key >= 0:
                try:
                    self.dictionary.store(key, value)
                except SdoAbort:
                    self._emergency.raise_error(Emergency.INTERNAL, GENERIC)

    def _on_sync(self, data: bytes) -> None:
        if self.nmt is not NmtState.OPERATIONAL:
            return
        overflow = self.dictionary.number(_SYNC_OVERFLOW)
        if len(data) != (1 if overflow else 0):
            self._emergency.raise_error(Emergency.SYNC_LENGTH, COMMUNICATION)
            return
        if overflow:
            if data[0] == self._sync_counter:
                return  # the same SYNC once more, as after a retransmission whose first copy was received
            self._sync_counter = data[0]
        for pdo, received in self._received.items():
            self._use_rpdo(pdo, received)
        self._received.clear()
        self._apply()
        self._sync_count += 1
        for pdo in self._tpdos:
            if pdo.can_id >= 0 and pdo.synchronous and self._sync_count % (pdo.period or 1) == 0:
                self._send_pdo(pdo)
        self.sampled_ns = self.now_ns
        if self.now_ns >= self._heartbeat_ns:
            self._send_heartbeat()

    def _take_sync(self, value: int) -> None:
        if value & ~cia301.STANDARD_IDS or is_restricted(value):  # it produces none, and none of 29 bits
            raise SdoAbort(Abort.VALUE_RANGE)
        self.dictionary.values[_SYNC_COB] = value
        self._find_handlers()

    def _take_emergency(self, value: int) -> None:
        """CiA 301, 7.5.2.17: an identifier of 11 bits that is nobody else's, or none."""
        if not value & cia301.PDO_INVALID and (value & ~cia301.STANDARD_IDS or is_restricted(value)):
            raise SdoAbort(Abort.VALUE_RANGE)

    def _take_history(self, value: int) -> None:
        """1003h:00 takes zero alone (CiA 301, 7.5.2.4)."""
        if value:
            raise SdoAbort(Abort.VALUE_RANGE)
        self._emergency.forget_history()

    def _take_overflow(self, value: int) -> None:
        if self.dictionary.number(_CYCLE_PERIOD):
            raise SdoAbort(Abort.DEVICE_STATE)  # CiA 301, 7.5.2.22
        self._sync_counter = 0

    def _take_consumer(self, value: int) -> None:
        self.dictionary.values[_CONSUMER_HEARTBEAT] = value
        self._master_deadline_ns = NEVER_NS  # armed by the first heartbeat (CiA 301, 7.2.8.3.2.3)
        self._find_handlers()

    # hooks of a kind of device ----------------------------------------------------------------------------------------

    def _live(self) -> None:
        """Time has passed to now_ns."""

    def _apply(self) -> None:
        """SYNC: what RPDOs brought takes effect."""

    def _close(self) -> None:
        """The host ends cyclic operation: the node leaves OPERATIONAL or boots."""

    def _on_master_lost(self) -> None:
        """The master's heartbeat stays away."""

    def _restore(self) -> None:
        """Application objects go back to what is stored in the device."""
