"""An emulated CANopen servo drive (CiA 402) in cyclic synchronous torque mode, by any EDS.

The node (canopen_node.py) is the protocol in front of a `ServoDrive`: here are the power state machine and the drive's
objects. Force, latches and the watchdog on commands stay in the servo, the same as under the other layouts. Without an
EDS it is the project's own drive, cia402.eds. In any other mode than cyclic synchronous torque it applies no torque:
loops of the drive's own are not emulated, nor are ramps (605Ah to 605Eh): torque ends at once.
"""

from collections.abc import Callable
from pathlib import Path

from drivers.protocols.base import DriveStatus
from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.cia301 import Abort, DriveState, Emergency, NmtState
from sim_plant.drives.canopen_node import COMMUNICATION, GENERIC, CanopenNode
from sim_plant.drives.object_dictionary import SdoAbort, key_of
from sim_plant.drives.power_states import TRANSITIONS, power_command
from sim_plant.drives.quirks import NO_QUIRKS, Quirks
from sim_plant.drives.servo import NEVER_NS, ServoDrive

# As plain integers: arithmetic on an enumeration costs a microsecond.
_WATCHDOG, _ENCODER_FAULT = int(DriveStatus.WATCHDOG), int(DriveStatus.ENCODER_FAULT)
_DEFECTS = int(DriveStatus.FAULT) | _WATCHDOG | _ENCODER_FAULT
_LIMITED, _HOMED, _BRAKE = int(DriveStatus.TORQUE_LIMITED), int(DriveStatus.HOMED), int(DriveStatus.BRAKE)

_TORQUE = key_of(cia301.TORQUE)
_TORQUE_MAX = key_of(cia301.TORQUE_MAX)
_TORQUE_RATED = key_of(cia301.TORQUE_RATED)
_MODE = key_of(cia301.MODE)
_ERROR_REGISTER = key_of(0x1001)
_ERROR_CODE = key_of(0x603F)
_QUICK_STOP_OPTION = key_of(0x605A)
_CONNECTION_OPTION = key_of(0x6007)  # what to do without the host: nothing, fault, disable voltage, quick stop
_POLARITY = key_of(0x607E)
_SERVO_DRIVE = 0x00020192  # 1000h: type 2 of profile 402
_MODES_OF_TARGETS = {_TORQUE: 0x208, key_of(0x607A): 0x081, key_of(0x60FF): 0x104}  # 6502h: TQ, CST; PP, CSP; PV, CSV
_POSITION_TURNED, _TORQUE_TURNED = 0x80, 0x20  # 607Eh; torque's bit is the makers'
_LAST_TRANSIT_OPTION = 4  # 605Ah: up to it the drive leaves QUICK STOP ACTIVE by itself


class Cia402Drive(CanopenNode):
    """One node.

    node_id: 1 to 127. servo: the drive behind it. position: gives the axis' true position now, m.
    eds: its EDS or DCF file. quirks: in what it differs from it. nmt, state: where the two state machines are.
    sampled_ns: last SYNC that was answered. Frames are to be given to every node on the bus in the order of reception,
    each stamped with the reception time, ns.
    """

    def __init__(
        self,
        node_id: int,
        servo: ServoDrive,
        position: Callable[[], float],
        start_ns: int = 0,
        *,
        eds: Path = cia301.EDS,
        quirks: Quirks = NO_QUIRKS,
    ) -> None:
        super().__init__(node_id, start_ns, eds, quirks)
        self.servo = servo
        self._position = position
        self.state = DriveState.SWITCH_ON_DISABLED
        self._controlword = 0
        self._limited = False
        self._fresh_target = False
        self._enabling_ns = NEVER_NS  # when the power stage will be on
        self._own = eds == cia301.EDS
        self._describe()
        self._install()
        self._bind_dictionary()
        self._boot()

    def _describe(self) -> None:
        """What many files leave to the drive: that it is a servo drive, and in which modes its targets make sense."""
        self.dictionary.fill_in(key_of(0x1000), _SERVO_DRIVE)
        modes = sum(bits for target, bits in _MODES_OF_TARGETS.items() if target in self.dictionary.entries)
        self.dictionary.fill_in(key_of(0x6502), modes)

    def _install(self) -> None:
        """A bought drive has been told its motor's rated torque by whoever installed it."""
        if not self._own and _TORQUE_RATED in self.dictionary.entries:
            self.dictionary.values[_TORQUE_RATED] = round(self.servo.rated_force * 1000)

    def switch_off(self) -> None:
        """Out of operation without a fault, as when the input that enables the power stage opens for a moment."""
        if self.state is not DriveState.FAULT:
            self.state = DriveState.SWITCH_ON_DISABLED
            self._command_servo(0.0)

    # hooks of the node ------------------------------------------------------------------------------------------------

    def _live(self) -> None:
        if self.now_ns >= self._enabling_ns:
            self._enabling_ns = NEVER_NS
            self.state = DriveState.OPERATION_ENABLED
            self._command_servo(0.0)
        if self.state is not DriveState.FAULT and self._defects():
            self._fail(self._diagnosis())

    def _apply(self) -> None:
        if self._fresh_target:
            self._fresh_target = False
            self._command_servo(self._target_force(), feed=True)

    def _close(self) -> None:
        """The host ends cyclic operation (6007h = 2: disable voltage); that it sends nothing any more is no fault."""
        if self.state is not DriveState.FAULT:
            self.state = DriveState.SWITCH_ON_DISABLED
        self._command_servo(0.0)
        self.servo.deadline_ns = NEVER_NS
        self._fresh_target = False
        self._enabling_ns = NEVER_NS
        self.dictionary.values[_TORQUE] = 0

    def _on_master_lost(self) -> None:
        """By 6007h. The project's own drive goes to FAULT, whose reason its host can read."""
        option = 1 if self._own else self.dictionary.number(_CONNECTION_OPTION, 1)
        if option == 1 or self.state is DriveState.FAULT:
            self._fail(Emergency.HEARTBEAT)
            return
        self._emergency.raise_error(Emergency.HEARTBEAT, GENERIC | COMMUNICATION)
        if option == 2:
            self.switch_off()
        elif option == 3 and self.state is DriveState.OPERATION_ENABLED:
            self._take_controlword(cia301.QUICK_STOP)

    def _restore(self) -> None:
        self.dictionary.restore(0x2000, 0xFFFF)
        self._install()
        self._controlword = 0

    # the drive --------------------------------------------------------------------------------------------------------

    def _defects(self) -> int:
        """Status bits of the servo that put the drive into FAULT."""
        return (self.servo.status | self.servo.extra_status) & _DEFECTS

    def _diagnosis(self) -> Emergency:
        defects = self._defects()
        if defects & _WATCHDOG:
            return Emergency.RPDO_TIMEOUT
        return Emergency.SENSOR if defects & _ENCODER_FAULT else Emergency.INTERNAL

    def _bind_dictionary(self) -> None:
        dictionary = self.dictionary
        dictionary.getters |= {
            key_of(0x2010): lambda: min(self.servo.watchdog_ns // 1000, 0xFFFFFFFF),
            key_of(cia301.POSITION): self._count,
            key_of(cia301.STATUSWORD): self._statusword,
            key_of(cia301.MODE_DISPLAY): lambda: dictionary.number(_MODE),
            key_of(cia301.TORQUE_ACTUAL): self._torque_actual,
        }
        dictionary.setters |= {
            key_of(cia301.CONTROLWORD): self._take_controlword,
            _MODE: self._take_mode,
            _TORQUE: self._take_torque,
            _TORQUE_RATED: self._take_rated,
        }

    def _count(self) -> int:
        count = self.servo.sample(self._position(), self.now_ns).position
        if self.dictionary.number(_POLARITY) & _POSITION_TURNED:
            count = -count
        return (count + (1 << 31)) % (1 << 32) - (1 << 31)

    def _statusword(self) -> int:
        status = self.servo.status | self.servo.extra_status
        word: int = self.state.value[1] | cia301.REMOTE
        if self.state in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED):
            word |= cia301.VOLTAGE_ENABLED
        word |= self._mode_bits()
        if self._limited or status & _LIMITED:
            word |= cia301.LIMIT_ACTIVE
        if self._own:
            word |= cia301.HOMED if status & _HOMED else 0
            word |= cia301.BRAKE if status & _BRAKE else 0
        return word | self._quirks.status_bits

    def _mode_bits(self) -> int:
        """Bits of the statusword whose meaning goes with the mode."""
        return cia301.FOLLOWS_COMMAND if self.state is DriveState.OPERATION_ENABLED else 0

    def _demands_torque(self) -> bool:
        """In the present mode 6071h is what it follows."""
        return self.dictionary.number(_MODE) == cia301.TORQUE_MODE

    def _torque_actual(self) -> int:
        raw = round(self.servo.force * 1e6 / self._rated_torque())
        return max(-32768, min(32767, raw))

    def _rated_torque(self) -> int:
        """6076h, mN m (mN); a drive without the object has the servo's."""
        return self.dictionary.number(_TORQUE_RATED, round(self.servo.rated_force * 1000)) or 1

    def _target_force(self) -> float:
        """6071h in N, held within 6072h; zero in any mode that demands no torque, and while halted."""
        number = self.dictionary.number
        raw, limit = number(_TORQUE), number(_TORQUE_MAX, 0xFFFF)
        self._limited = abs(raw) > limit
        if not self._demands_torque() or self._controlword & cia301.HALT:
            return 0.0
        sign = -1 if number(_POLARITY) & _TORQUE_TURNED else 1
        return float(sign * max(-limit, min(limit, raw)) * self._rated_torque()) * 1e-6

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
        register = GENERIC | (COMMUNICATION if code >> 12 == 8 else 0)
        self._enabling_ns = NEVER_NS
        self.dictionary.values[_ERROR_REGISTER] = register
        self.dictionary.values[_ERROR_CODE] = int(code)
        self._command_servo(0.0)
        self._emergency.raise_error(code, register)

    def _take_controlword(self, value: int) -> None:
        rising, self._controlword = value & ~self._controlword, value
        if rising & cia301.HALT:
            self._command_servo(0.0)
        if self.state is DriveState.FAULT:
            if rising & cia301.FAULT_RESET:
                self._reset_fault()
            return
        following = TRANSITIONS.get((self.state, power_command(value)))
        if following is None:
            return
        if following is DriveState.QUICK_STOP and 0 <= self._quick_stop_option() <= _LAST_TRANSIT_OPTION:
            following = DriveState.SWITCH_ON_DISABLED
        if following is DriveState.OPERATION_ENABLED and self._quirks.enable_delay_ns:
            self._enabling_ns = min(self._enabling_ns, self.now_ns + self._quirks.enable_delay_ns)
            following = DriveState.SWITCHED_ON
        else:
            self._enabling_ns = NEVER_NS
        leaving = self.state is DriveState.OPERATION_ENABLED
        self.state = following
        if leaving or following is DriveState.OPERATION_ENABLED:
            self._command_servo(0.0)

    def _quick_stop_option(self) -> int:
        """605Ah; the project's own drive has none and stays in QUICK STOP ACTIVE."""
        return self.dictionary.number(_QUICK_STOP_OPTION, _LAST_TRANSIT_OPTION + 2)

    def _reset_fault(self) -> None:
        self._command_servo(0.0)  # the servo wants to see its reset bit clear first
        self._command_servo(0.0, reset=True)
        if self._defects():
            return
        self.state = DriveState.SWITCH_ON_DISABLED
        self.dictionary.values[_ERROR_REGISTER] = 0
        self.dictionary.values[_ERROR_CODE] = 0
        self._emergency.raise_error(Emergency.NONE, 0)

    def _take_mode(self, value: int) -> None:
        if value not in (0, cia301.TORQUE_MODE):
            raise SdoAbort(Abort.VALUE_RANGE)
        self.dictionary.values[_MODE] = value
        if value != cia301.TORQUE_MODE:
            self._command_servo(0.0)

    def _take_torque(self, value: int) -> None:
        """By RPDO or SDO: applied at the next SYNC, as all targets of a synchronous mode."""
        if self.nmt is not NmtState.OPERATIONAL:
            raise SdoAbort(Abort.DEVICE_STATE)
        self._fresh_target = True

    def _take_rated(self, value: int) -> None:
        if self.state is DriveState.OPERATION_ENABLED:
            raise SdoAbort(Abort.DEVICE_STATE)
