"""A CiA 402 drive with a motor of its own and ideal loops: a test double for masters, in the modes its EDS offers.

Units are the drive's defaults: counts, counts/s, counts/s^2. What 6502h offers of PP, PV, TQ, HM, CSP, CSV and CST is
emulated; any other mode is refused by an SDO abort. Homing ends where the motor stands, whatever its method. In the
modes of position and speed it comes to rest with the decelerations of stopping.py; TQ follows its target by 6087h.
"""

from math import inf
from pathlib import Path

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, DriveState, Emergency
from sim_plant.drives import stopping
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.following import Demand, FollowingError
from sim_plant.drives.motor import Motor
from sim_plant.drives.object_dictionary import SdoAbort, key_of
from sim_plant.drives.quirks import NO_QUIRKS, Quirks
from sim_plant.drives.servo import ServoDrive

PP, PV, TQ, HM, CSP, CSV, CST = 1, 3, 4, 6, 8, 9, cia301.TORQUE_MODE  # 6060h
EMULATED = {PP: "PP", PV: "PV", TQ: "TQ", HM: "HM", CSP: "CSP", CSV: "CSV", CST: "CST"}

_MODES = key_of(0x6502)
_TARGET_POSITION, _TARGET_VELOCITY = key_of(0x607A), key_of(0x60FF)
_PROFILE_SPEED, _PROFILE_ACCELERATION = key_of(0x6081), key_of(0x6083)
_HOME_OFFSET = key_of(0x607C)
_UNDER_TORQUE = (0, TQ, CST)
_TARGETS = {CSP: _TARGET_POSITION, CSV: _TARGET_VELOCITY}
_LOWEST, _HIGHEST = key_of(0x607D, 1), key_of(0x607D, 2)  # no limits where they are equal
NEGATIVE_LIMIT, POSITIVE_LIMIT, HOME_SWITCH, INTERLOCK = (1 << bit for bit in range(4))  # of 60FDh; 16 to 31: maker's
# Bits of the controlword and the statusword that mean something else in each mode (CiA 402-2).
_START, _RELATIVE = 1 << 4, 1 << 6
_REACHED, _BIT_12, _FOLLOWING_ERROR = 1 << 10, 1 << 12, 1 << 13
_POWERED = (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP)
_NEAR = 0.5  # counts, counts/s


class MotionDrive(Cia402Drive):
    """mode: 6060h as it acts. motor: what it turns. inputs: 60FDh; a limit switch that is on lets it move away alone,
    the interlock keeps it without power. blocked: something holds the shaft.

    Raises ValueError for an EDS that cannot be read.
    """

    def __init__(self, node_id: int, servo: ServoDrive, motor: Motor, *, eds: Path, quirks: Quirks = NO_QUIRKS) -> None:
        self.motor = motor
        self.mode = 0
        self.inputs = 0
        self.blocked = False
        self._at_limit = False
        self._target: float | None = None  # of a profile, counts
        self._acknowledged = False
        self._homed = False
        self._until_ns = 0
        self._demand: Demand | None = None  # in CSP
        self._sync_ns = motor.time_ns

        def position() -> float:
            return motor.position * servo.resolution

        super().__init__(node_id, servo, position, motor.time_ns, eds=eds, quirks=quirks)
        self._following = FollowingError(self.dictionary)
        getters = {
            key_of(cia301.MODE_DISPLAY): lambda: self.mode,
            key_of(0x606C): lambda: round(motor.velocity),
            key_of(0x6062): lambda: self._count() + self._following.error,
            key_of(0x60F4): lambda: self._following.error,
            key_of(0x60FD): lambda: self.inputs,
        }
        self.dictionary.getters |= {key: get for key, get in getters.items() if key in self.dictionary.entries}
        self.dictionary.setters |= dict.fromkeys(_TARGETS.values(), self._take_target)
        self._restore()

    def emulates(self, mode: int) -> bool:
        """The EDS offers the mode, and it is emulated; a drive with 6071h and without 6502h is taken to offer CST."""
        has_target = key_of(cia301.TORQUE) in self.dictionary.entries
        offered = self.dictionary.number(_MODES, cia301.TORQUE_MODE_BIT if has_target else 0)
        return mode in EMULATED and bool(offered >> (mode - 1) & 1)

    def reboot(self) -> None:
        """Its supply fails for a moment."""
        self.servo.broken = False
        if self.state is DriveState.FAULT:
            self._reset_fault()
        self._boot()
        self._restore()

    # hooks of the drive -----------------------------------------------------------------------------------------------

    def _live(self) -> None:
        self._move()
        super()._live()
        if self.inputs & INTERLOCK and (self._stop is not None or self.state in _POWERED):
            self.switch_off()

    def _apply(self) -> None:
        """SYNC: synchronous targets take effect; CSP reaches its own when the next SYNC is due."""
        super()._apply()
        period_ns, self._sync_ns = self.now_ns - self._sync_ns, self.now_ns
        self._until_ns = self.now_ns + period_ns
        if self.mode in _TARGETS and self._moves():
            self._target = float(self.dictionary.number(_TARGETS[self.mode]))
            if self.mode == CSP:
                start = self._demand.at(self.now_ns) if self._demand else self.motor.position
                self._demand = Demand(start, self._target, self.now_ns, self._until_ns)

    def _aim(self, force: float) -> None:
        """TQ goes to its target by 6087h."""
        if self.mode != TQ:
            super()._aim(force)
            return
        self._ramp.head_for(force, stopping.torque_slope(self.dictionary, self._rated_torque() * 1e-3), self.now_ns)

    def _take_mode(self, value: int) -> None:
        if value and not self.emulates(value):
            raise SdoAbort(Abort.VALUE_RANGE)
        self._move()
        if value != self.mode:
            self.mode, self._target, self._acknowledged, self._homed = value, None, False, False
            self._demand = None
            self._command_servo(0.0)

    def _take_torque(self, value: int) -> None:
        """In TQ at once, as all that is not synchronous."""
        if self.mode == TQ:
            self._fresh_target = True
            return
        super()._take_torque(value)

    def _take_target(self, _value: int) -> None:
        self._fresh_target = True

    def _take_controlword(self, value: int) -> None:
        rising = value & ~self._controlword
        self._move()
        super()._take_controlword(value)
        if self.mode == PP:
            if rising & _START and self._moves():
                self._take_set_point(relative=bool(value & _RELATIVE))
            self._acknowledged = bool(value & _START) and self._acknowledged
        elif self.mode == HM and rising & _START and self._moves():
            self.motor.position = float(self.dictionary.number(_HOME_OFFSET))
            self._homed = True
        if not self._moves():
            self._target = self._demand = None

    def _may_enable(self) -> bool:
        return super()._may_enable() and not self.inputs & INTERLOCK

    def _stands(self) -> bool:
        if self.mode in _UNDER_TORQUE:
            return super()._stands()
        self._turn()  # what is at once needs no time
        return self.motor.velocity == 0.0

    def _close(self) -> None:
        super()._close()
        self._target = self._demand = None

    def _restore(self) -> None:
        super()._restore()
        stored = self.dictionary.number(key_of(cia301.MODE))
        self.mode = stored if self.emulates(stored) else 0

    def _mode_bits(self) -> int:
        """Bits 10 to 13 of the statusword."""
        late = _FOLLOWING_ERROR if self._following.exceeded else 0
        return self._bits_of_mode() | late | (cia301.LIMIT_ACTIVE if self._at_limit else 0)

    def _bits_of_mode(self) -> int:
        enabled = self.state is DriveState.OPERATION_ENABLED
        if self.mode in (CSP, CSV, CST):
            return _BIT_12 if enabled else 0
        if self.mode == HM:
            return _REACHED | _BIT_12 if self._homed else _REACHED
        bits = _REACHED if self._has_reached() else 0
        if self.mode == PP:
            bits |= _BIT_12 if self._acknowledged else 0
        elif self.mode == PV:
            bits |= _BIT_12 if abs(self.motor.velocity) < _NEAR else 0
        return bits

    def _demands_torque(self) -> bool:
        return self.mode in (CST, TQ)

    # motion -----------------------------------------------------------------------------------------------------------

    def _moves(self) -> bool:
        halted = self._controlword & cia301.HALT
        return self.state is DriveState.OPERATION_ENABLED and self._stop is None and not halted

    def _take_set_point(self, *, relative: bool) -> None:
        start = self.motor.position if relative and self._target is None else self._target or 0.0
        asked = self.dictionary.number(_TARGET_POSITION)
        self._target = start + asked if relative else float(asked)
        self._acknowledged = True

    def _has_reached(self) -> bool:
        if self.mode == TQ:
            return True
        if self._controlword & cia301.HALT:
            return abs(self.motor.velocity) < _NEAR
        if self.mode == PV:
            return abs(self.motor.velocity - self.dictionary.number(_TARGET_VELOCITY)) < _NEAR
        return self._target is None or abs(self.motor.position - self._target) < _NEAR

    def _move(self) -> None:
        """Follow the motor to now, within limit switches and 607Dh."""
        motor, number = self.motor, self.dictionary.number
        before = motor.position
        self._turn()
        low, high = float(number(_LOWEST)), float(number(_HIGHEST))
        if low >= high:
            low, high = -inf, inf
        low = before if self.inputs & NEGATIVE_LIMIT else min(low, before)
        high = before if self.inputs & POSITIVE_LIMIT else max(high, before)
        self._at_limit = not low <= motor.position <= high or (self._at_limit and motor.position == before)
        if not low <= motor.position <= high:
            motor.position, motor.velocity = max(low, min(high, motor.position)), 0.0
        if self.blocked:
            motor.position, motor.velocity = before, 0.0
        self._compare(low, high)

    def _compare(self, low: float, high: float) -> None:
        """Position demanded, within limits, against position reached."""
        if self._demand is None or not self._moves():
            if not self._failed():
                self._following.clear()
            return
        demand = max(low, min(high, self._demand.at(self.now_ns)))
        if self._following.look(demand, self.motor.position, self.now_ns):
            self._fail(Emergency.FOLLOWING)

    def _turn(self) -> None:
        motor, now_ns, number = self.motor, self.now_ns, self.dictionary.number
        acceleration = number(_PROFILE_ACCELERATION) or inf
        if self.mode == TQ and self._fresh_target:
            super()._apply()
        if self.mode in _UNDER_TORQUE:
            motor.push(self.servo.force, now_ns)
        elif self._stop is not None:
            motor.run(0.0, stopping.deceleration(self.dictionary, self._stop.ramp), now_ns)
        elif self.state is DriveState.QUICK_STOP:
            motor.hold(now_ns)
        elif self.state is not DriveState.OPERATION_ENABLED:
            motor.push(self.servo.force, now_ns)
        elif not self._moves():
            motor.hold(now_ns)
        elif self.mode == PV:
            motor.run(number(_TARGET_VELOCITY), acceleration, now_ns)
        elif self._target is None:
            motor.hold(now_ns)
        elif self.mode == CSV:
            motor.run(self._target, inf, now_ns)
        elif self.mode == CSP:
            motor.reach(self._target, self._until_ns, now_ns)
        else:
            motor.go(self._target, number(_PROFILE_SPEED), acceleration, now_ns)
