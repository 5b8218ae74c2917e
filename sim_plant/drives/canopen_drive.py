"""An emulated CANopen servo drive (CiA 402) in cyclic synchronous torque mode, by any EDS.

The node (canopen_node.py) is the protocol in front of a `ServoDrive`: here are the power state machine and the
drive's objects. Force, latches and the watchdog on commands stay in the servo, the same as under the other layouts.
Without an EDS it is the project's own drive, cia402.eds. In any other mode than cyclic synchronous torque it applies
no torque: loops of the drive's own are not emulated. The module stopping.py says how it comes to rest. Faults that
the servo latches (its own, its encoder's, the watchdog's) end the torque at once whatever 605Eh says, for the power
stage is off.
"""

from collections.abc import Callable
from functools import partial
from math import inf
from pathlib import Path

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, DriveState, Emergency, NmtState
from drivers.protocols.base import DriveStatus
from sim_plant.drives import stopping
from sim_plant.drives.canopen_node import COMMUNICATION, GENERIC, CanopenNode
from sim_plant.drives.object_dictionary import SdoAbort, key_of
from sim_plant.drives.power_states import TRANSITIONS, PowerCommand, power_command
from sim_plant.drives.quirks import NO_QUIRKS, Quirks
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from sim_plant.drives.stopping import Ramp, Stop, TorqueRamp
from sim_plant.drives.touch_probe import TouchProbe

# As plain integers: arithmetic on an enumeration costs a microsecond.
_WATCHDOG, _ENCODER_FAULT = int(DriveStatus.WATCHDOG), int(DriveStatus.ENCODER_FAULT)
_DEFECTS = int(DriveStatus.FAULT) | _WATCHDOG | _ENCODER_FAULT
_INPUT_BITS = (
    (int(DriveStatus.LIMIT_LOW), 1),
    (int(DriveStatus.LIMIT_HIGH), 2),
    (int(DriveStatus.HOME), 4),
)  # of 60FDh
_LIMITED, _HOMED, _BRAKE = int(DriveStatus.TORQUE_LIMITED), int(DriveStatus.HOMED), int(DriveStatus.BRAKE)

_TORQUE = key_of(cia301.TORQUE)
_TORQUE_MAX = key_of(cia301.TORQUE_MAX)
_TORQUE_RATED = key_of(cia301.TORQUE_RATED)
_MODE = key_of(cia301.MODE)
_ERROR_REGISTER = key_of(0x1001)
_ERROR_CODE = key_of(0x603F)
_CONNECTION_OPTION = key_of(0x6007)  # what to do without the host: nothing, fault, disable voltage, quick stop
_POLARITY = key_of(0x607E)
_SERVO_DRIVE = 0x00020192  # 1000h: type 2 of profile 402
_MODES_OF_TARGETS = {_TORQUE: 0x208, key_of(0x607A): 0x081, key_of(0x60FF): 0x104}  # 6502h: TQ, CST; PP, CSP; PV, CSV
_POSITION_TURNED, _TORQUE_TURNED = 0x80, 0x20  # 607Eh; torque's bit is the makers'
_RESTS = {PowerCommand.SWITCH_ON: stopping.DISABLE, PowerCommand.SHUTDOWN: stopping.SHUTDOWN}
"""Out of OPERATION ENABLED: the option that says how."""
_COMMUNICATION_ERRORS = (0x81, 0x82)  # high bytes of emergency error codes


class Cia402Drive(CanopenNode):
    """One node.

    node_id: 1 to 127. servo: the drive behind it. position: gives the axis' true position now, m.
    eds: its EDS or DCF file. quirks: in what it differs from it. nmt, state: where the two state machines are.
    index: place of its encoder's index, m (rad), None where there is none. sampled_ns: last SYNC that was answered.
    Frames are to be given to every node on the bus in the order of reception, each stamped with the reception time, ns.
    """

    fd = False

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
        self._ramp = TorqueRamp()  # what is demanded of the servo, N
        self._stop: Stop | None = None  # under way
        self._own = self.dictionary.own
        self.index: float | None = None
        self._probe = self._find_probe()
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
            self.dictionary.set(_TORQUE_RATED, round(self.servo.rated_force * 1000))

    def _find_probe(self) -> TouchProbe | None:
        """Only the project's own drive counts anew at its encoder's index."""
        counter = self.servo.counter
        if self._own or counter is None:
            return None
        self.index = index = counter.give_up_index()
        zero = counter.zero
        if key_of(0x60B8) not in self.dictionary.entries:
            return None
        return TouchProbe(self.dictionary, None if index is None else (index - zero) / self.servo.resolution)

    def switch_off(self) -> None:
        """Out of operation without a fault, as when the input that enables the power stage opens for a moment."""
        self._stop = None
        self.state = DriveState.FAULT if self._failed() else DriveState.SWITCH_ON_DISABLED
        self._command_servo(0.0)

    # hooks of the node ------------------------------------------------------------------------------------------------

    def _live(self) -> None:
        if self._probe is not None and self.servo.counter is not None:
            self._probe.follow(self.servo.counter.take(self._position()) / self.servo.resolution)
        if self.now_ns >= self._enabling_ns:
            self._enabling_ns = NEVER_NS
            self.state = DriveState.OPERATION_ENABLED
            self._command_servo(0.0)
        if self._stop is not None or not self._ramp.arrived:
            self._hand_over()
            self._end_stop()
        if self._defects() and not self._failed():
            self._fail(self._diagnosis())

    def _apply(self) -> None:
        if self._fresh_target:
            self._fresh_target = False
            force = self._target_force()
            if self._stop is None:
                self._aim(force)
            self._hand_over(feed=True)

    def _aim(self, force: float) -> None:
        """Demand a force, N: synchronous targets are applied as they are."""
        self._ramp.jump(force)

    def _close(self) -> None:
        """The host ends cyclic operation (6007h = 2: disable voltage); that it sends nothing any more is no fault."""
        self.switch_off()
        self.servo.deadline_ns = NEVER_NS
        self._fresh_target = False
        self._enabling_ns = NEVER_NS
        self.dictionary.set(_TORQUE, 0)

    def _on_master_lost(self) -> None:
        """By 6007h. The project's own drive goes to FAULT, whose reason its host can read."""
        option = 1 if self._own else self.dictionary.number(_CONNECTION_OPTION, 1)
        if option == 1 or self._failed():
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
        if self._own:  # an object of its maker's
            dictionary.getters[key_of(0x2010)] = lambda: min(self.servo.watchdog_ns // 1000, 0xFFFFFFFF)
        dictionary.getters |= {
            key_of(cia301.POSITION): self._count,
            key_of(cia301.STATUSWORD): self._statusword,
            key_of(cia301.MODE_DISPLAY): lambda: dictionary.number(_MODE),
            key_of(cia301.TORQUE_ACTUAL): self._torque_actual,
        }
        if key_of(0x60FD) in dictionary.entries:
            dictionary.getters[key_of(0x60FD)] = self._digital_inputs
        dictionary.setters |= {
            key_of(cia301.CONTROLWORD): self._take_controlword,
            _MODE: self._take_mode,
            _TORQUE: self._take_torque,
            _TORQUE_RATED: self._take_rated,
            **{key: partial(self._take_option, key) for key in stopping.OPTIONS},
        }

    def _count(self) -> int:
        count = self.servo.sample(self._position(), self.now_ns).position
        if self.dictionary.number(_POLARITY) & _POSITION_TURNED:
            count = -count
        return (count + (1 << 31)) % (1 << 32) - (1 << 31)

    def _digital_inputs(self) -> int:
        """Limit switches and home switch in bits 0 to 2."""
        status = self.servo.sample(self._position(), self.now_ns).status
        return sum(bit for closed, bit in _INPUT_BITS if status & closed)

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
        follows = self.state is DriveState.OPERATION_ENABLED and self._stop is None
        return cia301.FOLLOWS_COMMAND if follows else 0

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

    def _command_servo(self, force: float, *, reset: bool = False) -> None:
        """Demand a force at once, N."""
        self._ramp.jump(force)
        self._hand_over(reset=reset)

    def _hand_over(self, *, feed: bool = False, reset: bool = False) -> None:
        """Give the servo what is demanded now. Only SYNC with a new target torque feeds its watchdog."""
        deadline_ns = self.servo.deadline_ns
        powered = self._powered()
        if not powered:
            self._ramp.jump(0.0)
        self.servo.on_command(self._ramp.follow(self.now_ns), powered, reset, 0, self.now_ns)
        if not feed:
            self.servo.deadline_ns = deadline_ns
        if self._defects() and not self._failed():
            self._fail(self._diagnosis())

    def _powered(self) -> bool:
        """The power stage is on: in operation, or on the way out of it."""
        return self.state is DriveState.OPERATION_ENABLED or self._stop is not None

    def _failed(self) -> bool:
        return self.state in (DriveState.FAULT, DriveState.FAULT_REACTION)

    def _fail(self, code: Emergency) -> None:
        """Fault reaction by 605Eh, then FAULT."""
        register = GENERIC | (COMMUNICATION if code >> 8 in _COMMUNICATION_ERRORS else 0)
        self._enabling_ns = NEVER_NS
        self.dictionary.set(_ERROR_REGISTER, register)
        self.dictionary.set(_ERROR_CODE, int(code))
        self._emergency.raise_error(code, register)
        if self._failed():
            return
        if self._defects():
            self._ramp.jump(0.0)
        ramp = stopping.option(self.dictionary, stopping.FAULT_REACTION).ramp if self._powered() else Ramp.LET_GO
        self._come_to_rest(Stop(ramp, DriveState.FAULT), DriveState.FAULT_REACTION)

    def _come_to_rest(self, stop: Stop, meanwhile: DriveState) -> None:
        """End the motion; the drive is in the state `meanwhile` until it stands."""
        if stop.ramp is Ramp.LET_GO:
            self._stop = None
            self.state = stop.following
            self._command_servo(0.0)
            return
        self._stop = stop
        self.state = meanwhile
        rated = self._rated_torque() * 1e-3
        slope = inf if stop.ramp is Ramp.AT_ONCE else stopping.torque_slope(self.dictionary, rated)
        self._ramp.head_for(0.0, slope, self.now_ns)
        self._hand_over()
        self._end_stop()

    def _stands(self) -> bool:
        """What was to come to rest has."""
        return self._ramp.arrived

    def _end_stop(self) -> None:
        if self._stop is not None and self._stands():
            self.state, self._stop = self._stop.following, None
            self._command_servo(0.0)

    def _go_on(self) -> None:
        """The host takes back what it stopped for; a torque stays as it is until a new target."""
        self._stop = None
        self._ramp.jump(self._ramp.value)

    def _take_controlword(self, value: int) -> None:
        rising, self._controlword = value & ~self._controlword, value
        if self._failed():
            if rising & cia301.FAULT_RESET and self.state is DriveState.FAULT:
                self._reset_fault()
            return
        command = power_command(value)
        following = TRANSITIONS.get((self.state, command))
        if following is not None:
            self._change_state(following, command)
        elif command is PowerCommand.ENABLE and self._stop and self._stop.following is not self.state:
            self._go_on()
        if self.state is DriveState.OPERATION_ENABLED:
            self._take_halt(bool(value & cia301.HALT))

    def _take_halt(self, halted: bool) -> None:
        """605Dh. A drive that is on its way out of operation goes on with that."""
        if halted and self._stop is None:
            ramp = stopping.option(self.dictionary, stopping.HALT).ramp
            self._come_to_rest(Stop(ramp, DriveState.OPERATION_ENABLED), DriveState.OPERATION_ENABLED)
        elif not halted and self._stop and self._stop.following is DriveState.OPERATION_ENABLED:
            self._go_on()

    def _change_state(self, following: DriveState, command: PowerCommand) -> None:
        """A transition that the host asks for."""
        if self.state is DriveState.OPERATION_ENABLED and command in _RESTS:
            ramp = stopping.option(self.dictionary, _RESTS[command]).ramp
            self._come_to_rest(Stop(ramp, following), self.state)
        elif following is DriveState.QUICK_STOP:
            option = stopping.option(self.dictionary, stopping.QUICK_STOP)
            end = following if option.stays else DriveState.SWITCH_ON_DISABLED
            self._come_to_rest(Stop(option.ramp, end), following)
        elif following is DriveState.OPERATION_ENABLED:
            if self._may_enable():
                self._enable()
        else:
            powered = self._powered()
            self.state, self._stop, self._enabling_ns = following, None, NEVER_NS
            if powered:
                self._command_servo(0.0)

    def _may_enable(self) -> bool:
        """Not out of a quick stop that leads to SWITCH ON DISABLED."""
        return self._stop is None or self._stop.following is DriveState.QUICK_STOP

    def _enable(self) -> None:
        self._stop = None
        if self._quirks.enable_delay_ns:
            self._enabling_ns = min(self._enabling_ns, self.now_ns + self._quirks.enable_delay_ns)
            self.state = DriveState.SWITCHED_ON
            return
        self.state = DriveState.OPERATION_ENABLED
        self._command_servo(0.0)

    def _take_option(self, key: int, value: int) -> None:
        if value not in stopping.OPTIONS[key]:
            raise SdoAbort(Abort.VALUE_RANGE)

    def _reset_fault(self) -> None:
        self._command_servo(0.0)  # the servo wants to see its reset bit clear first
        self._command_servo(0.0, reset=True)
        if self._defects():
            return
        self.state = DriveState.SWITCH_ON_DISABLED
        self.dictionary.set(_ERROR_REGISTER, 0)
        self.dictionary.set(_ERROR_CODE, 0)
        self._emergency.raise_error(Emergency.NONE, 0)

    def _take_mode(self, value: int) -> None:
        if value not in (0, cia301.TORQUE_MODE):
            raise SdoAbort(Abort.VALUE_RANGE)
        self.dictionary.set(_MODE, value)
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
