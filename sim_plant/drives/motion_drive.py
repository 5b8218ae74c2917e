"""A CiA 402 drive with a motor of its own and ideal loops: a test double for masters, in the modes its EDS offers.

Units are the drive's defaults: counts, counts/s, counts/s^2. What 6502h offers of PP, PV, TQ, HM, CSP, CSV and CST is
emulated; any other mode is refused by an SDO abort. Homing ends where the motor stands, whatever its method. A halt or
a quick stop stands still at once, and so does disabling: there is no ramp.
"""

from math import inf
from pathlib import Path

from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.cia301 import Abort, DriveState
from sim_plant.drives.canopen_drive import Cia402Drive
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
_TARGETS = {CSP: _TARGET_POSITION, CSV: _TARGET_VELOCITY}
# Bits of the controlword and the statusword that mean something else in each mode (CiA 402-2).
_START, _RELATIVE = 1 << 4, 1 << 6
_REACHED, _BIT_12 = 1 << 10, 1 << 12
_NEAR = 0.5  # counts, counts/s


class MotionDrive(Cia402Drive):
    """mode: 6060h as it acts. motor: what it turns. Raises ValueError for an EDS that cannot be read."""

    def __init__(self, node_id: int, servo: ServoDrive, motor: Motor, *, eds: Path, quirks: Quirks = NO_QUIRKS) -> None:
        self.motor = motor
        self.mode = 0
        self._target: float | None = None  # of a profile, counts
        self._acknowledged = False
        self._homed = False
        self._until_ns = 0
        self._sync_ns = motor.time_ns

        def position() -> float:
            return motor.position * servo.resolution

        super().__init__(node_id, servo, position, motor.time_ns, eds=eds, quirks=quirks)
        getters = {
            key_of(cia301.MODE_DISPLAY): lambda: self.mode,
            key_of(0x606C): lambda: round(motor.velocity),
            key_of(0x60F4): lambda: 0,
        }
        self.dictionary.getters |= {key: get for key, get in getters.items() if key in self.dictionary.entries}
        self.dictionary.setters |= dict.fromkeys(_TARGETS.values(), self._take_target)
        self._restore()

    def emulates(self, mode: int) -> bool:
        """The EDS offers the mode, and it is emulated; a drive without 6502h is taken to offer CST."""
        offered = self.dictionary.number(_MODES, cia301.TORQUE_MODE_BIT)
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

    def _apply(self) -> None:
        """SYNC: synchronous targets take effect; CSP reaches its own when the next SYNC is due."""
        super()._apply()
        period_ns, self._sync_ns = self.now_ns - self._sync_ns, self.now_ns
        self._until_ns = self.now_ns + period_ns
        if self.mode in _TARGETS and self._moves():
            self._target = float(self.dictionary.number(_TARGETS[self.mode]))

    def _take_mode(self, value: int) -> None:
        if value and not self.emulates(value):
            raise SdoAbort(Abort.VALUE_RANGE)
        self._move()
        if value != self.mode:
            self.mode, self._target, self._acknowledged, self._homed = value, None, False, False
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
            self._target = None

    def _close(self) -> None:
        super()._close()
        self._target = None

    def _restore(self) -> None:
        super()._restore()
        stored = self.dictionary.number(key_of(cia301.MODE))
        self.mode = stored if self.emulates(stored) else 0

    def _mode_bits(self) -> int:
        """Bits 10, 12 and 13 of the statusword."""
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
        return self.state is DriveState.OPERATION_ENABLED and not self._controlword & cia301.HALT

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
        """Follow the motor to now."""
        motor, now_ns, number = self.motor, self.now_ns, self.dictionary.number
        acceleration = number(_PROFILE_ACCELERATION) or inf
        if self.mode == TQ and self._fresh_target:
            super()._apply()
        if self.mode in (0, TQ, CST) or self.state is not DriveState.OPERATION_ENABLED:
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
