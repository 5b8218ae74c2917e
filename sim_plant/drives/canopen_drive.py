"""An emulated CANopen servo drive (CiA 301, CiA 402) in cyclic synchronous torque mode. Contract: cia402.eds.

The node is the protocol in front of a `ServoDrive`: network management, object dictionary, PDOs and the power state
machine. Force, latches and the watchdog on commands stay in the servo, the same as under the other layouts. No I/O and
no clock: time comes in with frames and through `advance`.
"""

from collections.abc import Callable
from functools import partial

from drivers.frame import FD, Frame
from drivers.protocols.base import DriveStatus
from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.cia301 import Abort, DriveState, Emergency, NmtCommand, NmtState
from sim_plant.drives.object_dictionary import ObjectDictionary, SdoAbort, key_of
from sim_plant.drives.pdo import Pdo
from sim_plant.drives.power_states import TRANSITIONS, power_command
from sim_plant.drives.sdo_server import SdoServer
from sim_plant.drives.servo import NEVER_NS, ServoDrive

# As plain integers: arithmetic on an enumeration costs a microsecond.
_WATCHDOG, _ENCODER_FAULT = int(DriveStatus.WATCHDOG), int(DriveStatus.ENCODER_FAULT)
_DEFECTS = int(DriveStatus.FAULT) | _WATCHDOG | _ENCODER_FAULT
_LIMITED, _HOMED, _BRAKE = int(DriveStatus.TORQUE_LIMITED), int(DriveStatus.HOMED), int(DriveStatus.BRAKE)
_GENERIC, _COMMUNICATION = 0x01, 0x10  # bits of the error register, 1001h
_HISTORY = 4  # entries of 1003h

_TORQUE = key_of(cia301.TORQUE)
_TORQUE_MAX = key_of(cia301.TORQUE_MAX)
_TORQUE_RATED = key_of(cia301.TORQUE_RATED)
_MODE = key_of(cia301.MODE)
_SYNC_OVERFLOW = key_of(0x1019)
_CYCLE_PERIOD = key_of(0x1006)
_SYNC_COB = key_of(0x1005)
_EMCY_COB = key_of(0x1014)
_ERROR_REGISTER = key_of(0x1001)
_ERROR_CODE = key_of(0x603F)
_CONSUMER_HEARTBEAT = key_of(0x1016, 1)
_PRODUCER_HEARTBEAT = key_of(0x1017)


class Cia402Drive:
    """One node.

    node_id: 1 to 127. servo: the drive behind it. position: gives the axis' true position now, m.
    nmt, state: where the two state machines are. sampled_ns: last SYNC that was answered.
    Frames are to be given to every node on the bus in the order of reception, each stamped with the reception time, ns.
    """

    def __init__(self, node_id: int, servo: ServoDrive, position: Callable[[], float], start_ns: int = 0) -> None:
        self.node_id = node_id
        self.servo = servo
        self._position = position
        self.now_ns = start_ns
        self.nmt = NmtState.BOOT_UP
        self.state = DriveState.SWITCH_ON_DISABLED
        self._controlword = 0
        self._limited = False
        self._fresh_torque = False
        self._sync_counter = 0
        self._sync_count = 0
        self.sampled_ns = -NEVER_NS
        self._heartbeat_ns = NEVER_NS
        self._master_deadline_ns = NEVER_NS
        self._out: list[Frame] = []
        self._received: dict[Pdo, bytes] = {}
        self.dictionary = ObjectDictionary(node_id)
        self._sdo = SdoServer(self.dictionary)
        self._bind_dictionary()
        dictionary, changed = self.dictionary, self._find_handlers
        self._handlers: dict[int, Callable[[bytes], None]] = {}
        self._rpdos: list[Pdo] = []
        self._tpdos: list[Pdo] = []
        self._rpdos = [Pdo(dictionary, 0x1400 + i, 0x1600 + i, changed) for i in range(3)]
        self._tpdos = [Pdo(dictionary, 0x1800 + i, 0x1A00 + i, changed) for i in range(2)]
        self._boot()

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
        """Let time pass to now_ns: heartbeats, and the emergencies of a servo that found a fault by itself."""
        self._pass_time(now_ns)
        return self._take()

    def switch_off(self) -> None:
        """Out of operation without a fault, as when the input that enables the power stage opens for a moment."""
        if self.state is not DriveState.FAULT:
            self.state = DriveState.SWITCH_ON_DISABLED
            self._command_servo(0.0)

    def _take(self) -> list[Frame]:
        out, self._out = self._out, []
        return out

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
            self._fail(Emergency.HEARTBEAT)
        if self.state is not DriveState.FAULT and self._defects():
            self._fail(self._diagnosis())

    def _defects(self) -> int:
        """Status bits of the servo that put the drive into FAULT."""
        return (self.servo.status | self.servo.extra_status) & _DEFECTS

    def _diagnosis(self) -> Emergency:
        defects = self._defects()
        if defects & _WATCHDOG:
            return Emergency.RPDO_TIMEOUT
        return Emergency.SENSOR if defects & _ENCODER_FAULT else Emergency.INTERNAL

    # network management -----------------------------------------------------------------------------------------------

    def _boot(self) -> None:
        """As after power-up: communication objects at their defaults; the boot-up message goes out at the next step."""
        self._close()
        self.dictionary.restore(0x1000, 0x1FFF)
        for pdo in self._rpdos + self._tpdos:
            pdo.restore()
        self._sdo.reset()
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
                    self.dictionary.restore(0x2000, 0xFFFF)
                    self._controlword = 0
                self._enter_pre_operational()
            case _:
                return
        self._received.clear()

    def _close(self) -> None:
        """The host ends cyclic operation (6007h = 2: disable voltage); that it sends nothing any more is no fault."""
        if self.state is not DriveState.FAULT:
            self.state = DriveState.SWITCH_ON_DISABLED
        self._command_servo(0.0)
        self.servo.deadline_ns = NEVER_NS
        self._fresh_torque = False
        self.dictionary.values[_TORQUE] = 0

    def _is_cyclic(self) -> bool:
        """Whether SYNCs come in time. Then a heartbeat waits for the next and goes behind its TPDOs, as the priorities
        of a real controller's mailboxes would have it; here frames leave in the order in which they are queued."""
        return self.now_ns - self.sampled_ns < 2000 * int(self.dictionary.values[_CYCLE_PERIOD])

    def _send_heartbeat(self) -> None:
        self._send(cia301.HEARTBEAT_ID + self.node_id, bytes((self.nmt,)))
        self._schedule_heartbeat(self.dictionary.values[_PRODUCER_HEARTBEAT])

    def _schedule_heartbeat(self, milliseconds: int) -> None:
        self._heartbeat_ns = self.now_ns + milliseconds * 1_000_000 if milliseconds else NEVER_NS

    def _on_master_heartbeat(self, data: bytes) -> None:
        milliseconds = self.dictionary.values[_CONSUMER_HEARTBEAT] & 0xFFFF
        if len(data) == 1 and milliseconds:
            self._master_deadline_ns = self.now_ns + milliseconds * 1_000_000

    # services ---------------------------------------------------------------------------------------------------------

    def _find_handlers(self) -> None:
        """Rebuild the table of identifiers this node listens to; what waits in an RPDO that ends is gone."""
        self._received = {pdo: data for pdo, data in self._received.items() if pdo.can_id >= 0}
        values, node = self.dictionary.values, self.node_id
        handlers: dict[int, Callable[[bytes], None]] = {}
        for pdo in reversed(self._rpdos):
            handlers[pdo.can_id] = partial(self._on_rpdo, pdo)
        consumer = values[_CONSUMER_HEARTBEAT]
        if consumer & 0xFFFF:
            handlers[cia301.HEARTBEAT_ID + (consumer >> 16 & 0x7F)] = self._on_master_heartbeat
        handlers[cia301.SDO_REQUEST_ID + node] = self._on_sdo
        handlers[values[_SYNC_COB] & 0x7FF] = self._on_sync
        handlers[cia301.NMT_ID] = self._on_nmt
        handlers.pop(-1, None)
        self._handlers = handlers

    def _on_sdo(self, data: bytes) -> None:
        if len(data) != 8 or self.nmt is NmtState.STOPPED:
            return
        answer = self._sdo.on_request(data)
        if answer is not None:
            self._send(cia301.SDO_RESPONSE_ID + self.node_id, answer)

    def _on_rpdo(self, pdo: Pdo, data: bytes) -> None:
        if self.nmt is not NmtState.OPERATIONAL:
            return
        if len(data) < pdo.layout.size:
            self._send_emergency(Emergency.PDO_TOO_SHORT, _COMMUNICATION)
        elif pdo.synchronous:
            self._received[pdo] = data
        else:
            self._use_rpdo(pdo, data)

    def _use_rpdo(self, pdo: Pdo, data: bytes) -> None:
        for key, value in zip(pdo.keys, pdo.layout.unpack_from(data), strict=True):
            if key == _TORQUE:
                self.dictionary.values[_TORQUE] = value
                self._fresh_torque = True
            elif key >= 0:
                try:
                    self.dictionary.store(key, value)
                except SdoAbort:
                    self._send_emergency(Emergency.INTERNAL, _GENERIC)

    def _on_sync(self, data: bytes) -> None:
        if self.nmt is not NmtState.OPERATIONAL:
            return
        overflow = self.dictionary.values[_SYNC_OVERFLOW]
        if len(data) != (1 if overflow else 0):
            self._send_emergency(Emergency.SYNC_LENGTH, _COMMUNICATION)
            return
        if overflow:
            if data[0] == self._sync_counter:
                return  # the same SYNC once more, as after a retransmission whose first copy was received
            self._sync_counter = data[0]
        for pdo, received in self._received.items():
            self._use_rpdo(pdo, received)
        self._received.clear()
        if self._fresh_torque:
            self._fresh_torque = False
            self._command_servo(self._target_force(), feed=True)
        self._sync_count += 1
        for pdo in self._tpdos:
            if pdo.can_id >= 0 and pdo.synchronous and self._sync_count % (pdo.period or 1) == 0:
                self._send(pdo.can_id, pdo.layout.pack(*map(self.dictionary.get, pdo.keys)))
        self.sampled_ns = self.now_ns
        if self.now_ns >= self._heartbeat_ns:
            self._send_heartbeat()

    def _send_emergency(self, code: Emergency, register: int) -> None:
        values = self.dictionary.values
        if code is not Emergency.NONE:
            for subindex in range(_HISTORY, 1, -1):
                values[key_of(0x1003, subindex)] = values[key_of(0x1003, subindex - 1)]
            values[key_of(0x1003, 1)] = int(code)
            values[key_of(0x1003, 0)] = min(values[key_of(0x1003, 0)] + 1, _HISTORY)
        if self.nmt is not NmtState.STOPPED:
            self._send(values[_EMCY_COB] & 0x7FF, cia301.EMCY.pack(code, register, bytes(5)))

    # the drive --------------------------------------------------------------------------------------------------------

    def _bind_dictionary(self) -> None:
        dictionary = self.dictionary
        dictionary.getters |= {
            key_of(0x2010): lambda: self.servo.watchdog_ns // 1000,
            key_of(cia301.POSITION): self._count,
            key_of(cia301.STATUSWORD): self._statusword,
            key_of(cia301.MODE_DISPLAY): lambda: int(dictionary.values[_MODE]),
            key_of(cia301.TORQUE_ACTUAL): self._torque_actual,
        }
        dictionary.setters |= {
            key_of(cia301.CONTROLWORD): self._take_controlword,
            _MODE: self._take_mode,
            _TORQUE_RATED: self._take_rated,
            _PRODUCER_HEARTBEAT: self._schedule_heartbeat,
            _CONSUMER_HEARTBEAT: self._take_consumer,
            _SYNC_COB: self._take_sync,
            _SYNC_OVERFLOW: self._take_overflow,
            key_of(0x1003): self._clear_history,
        }

    def _count(self) -> int:
        count = self.servo.sample(self._position(), self.now_ns).position
        return (count + (1 << 31)) % (1 << 32) - (1 << 31)

    def _statusword(self) -> int:
        status = self.servo.status | self.servo.extra_status
        word: int = self.state.value[1] | cia301.REMOTE
        if self.state in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED):
            word |= cia301.VOLTAGE_ENABLED
        if self.state is DriveState.OPERATION_ENABLED:
            word |= cia301.FOLLOWS_COMMAND
        if self._limited or status & _LIMITED:
            word |= cia301.LIMIT_ACTIVE
        word |= cia301.HOMED if status & _HOMED else 0
        word |= cia301.BRAKE if status & _BRAKE else 0
        return word

    def _torque_actual(self) -> int:
        raw = round(self.servo.force * 1e6 / int(self.dictionary.values[_TORQUE_RATED]))
        return max(-32768, min(32767, raw))

    def _target_force(self) -> float:
        """6071h in N, held within 6072h; zero in any mode but cyclic synchronous torque."""
        values = self.dictionary.values
        raw: int = values[_TORQUE]
        limit: int = values[_TORQUE_MAX]
        self._limited = abs(raw) > limit
        if values[_MODE] != cia301.TORQUE_MODE:
            return 0.0
        return float(max(-limit, min(limit, raw)) * values[_TORQUE_RATED]) * 1e-6

    def _command_servo(self, force: float, *, feed: bool = False, reset: bool = False) -> None:
        """Hand a force to the servo. Only SYNC with a new target torque feeds its watchdog."""
        deadline_ns = self.servo.deadline_ns
        enabled = self.state is DriveState.OPERATION_ENABLED
        self.servo.on_command(force if enabled else 0.0, enabled, reset, 0, self.now_ns)
        if not feed:
            self.servo.deadline_ns = deadline_ns
        if self.state is not DriveState.FAULT and self._defects():
            self._fail(self._diagnosis())

    def _fail(self, code: Emergency) -> None:
        """Fault reaction: zero torque at once; FAULT REACTION ACTIVE takes no time."""
        self.state = DriveState.FAULT
        register = _GENERIC | (_COMMUNICATION if code >> 12 == 8 else 0)
        self.dictionary.values[_ERROR_REGISTER] = register
        self.dictionary.values[_ERROR_CODE] = int(code)
        self._command_servo(0.0)
        self._send_emergency(code, register)

    def _take_controlword(self, value: int) -> None:
        rising, self._controlword = value & ~self._controlword, value
        if self.state is DriveState.FAULT:
            if rising & cia301.FAULT_RESET:
                self._reset_fault()
            return
        following = TRANSITIONS.get((self.state, power_command(value)))
        if following is None:
            return
        leaving = self.state is DriveState.OPERATION_ENABLED
        self.state = following
        if leaving or following is DriveState.OPERATION_ENABLED:
            self._command_servo(0.0)

    def _reset_fault(self) -> None:
        self._command_servo(0.0)  # the servo wants to see its reset bit clear first
        self._command_servo(0.0, reset=True)
        if self._defects():
            return
        self.state = DriveState.SWITCH_ON_DISABLED
        self.dictionary.values[_ERROR_REGISTER] = 0
        self.dictionary.values[_ERROR_CODE] = 0
        self._send_emergency(Emergency.NONE, 0)

    def _take_mode(self, value: int) -> None:
        if value not in (0, cia301.TORQUE_MODE):
            raise SdoAbort(Abort.VALUE_RANGE)

    def _take_rated(self, value: int) -> None:
        if self.state is DriveState.OPERATION_ENABLED:
            raise SdoAbort(Abort.DEVICE_STATE)

    def _take_sync(self, value: int) -> None:
        self.dictionary.values[_SYNC_COB] = value
        self._find_handlers()

    def _take_overflow(self, value: int) -> None:
        if self.dictionary.values[_CYCLE_PERIOD]:
            raise SdoAbort(Abort.DEVICE_STATE)  # CiA 301, 7.5.2.22
        self._sync_counter = 0

    def _take_consumer(self, value: int) -> None:
        self.dictionary.values[_CONSUMER_HEARTBEAT] = value
        self._master_deadline_ns = NEVER_NS  # armed by the first heartbeat (CiA 301, 7.2.8.3.2.3)
        self._find_handlers()

    def _clear_history(self, value: int) -> None:
        for subindex in range(1, _HISTORY + 1):
            self.dictionary.values[key_of(0x1003, subindex)] = 0
