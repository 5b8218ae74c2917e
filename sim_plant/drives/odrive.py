"""An emulated ODrive on CANSimple, from its maker's documentation and not from any binding of ours.

Source: ODrive's manual, page "CAN Protocol" (docs.odriverobotics.com/v/latest/manual/can-protocol.html), its error and
state numbers. The published firmware 0.5 is followed where the page is silent (any frame to an axis feeds its watchdog;
requested states and controller modes act at once). Rules:
- An identifier is node * 32 + command, 11 bits; numbers are little-endian, floats IEEE 754.
- It sends Heartbeat (01h) and Get_Encoder_Estimates (09h) in its own time, and answers remote frames for these two and
  for Get_Error (03h).
- Set_Axis_State (07h): 8 enters closed loop control unless an error is latched; 1, and any procedure but homing
  (odrive_homing.py), leads to idle. It starts in position control, so that torque needs Set_Controller_Mode (0Bh) with
  1, 1.
- Set_Input_Torque (0Eh) is in N m and is clipped to what the motor has, and to its torque limits. In the modes of its
  own position and velocity loops, which only homing has, it does nothing.
- RxSdo (04h) reads (opcode 0) and writes (1) an endpoint by its number, which differs from firmware to firmware: a file
  flat_endpoints.json of each release says them. ENDPOINTS has this drive's. TxSdo (05h) answers a read with the number
  and the value, as many bytes as its type has; numbers that it has not are not answered. What is written is there until
  it restarts, and not answered.
- Errors are latched and end closed loop control: watchdog, Estop (02h), defects. Clear_Errors (18h), whatever its
  payload, ends them; Reboot (16h) too.
"""

import math
from collections.abc import Callable, Mapping
from struct import Struct

from drivers.frame import FD, REMOTE, Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.cyclic import CyclicNode
from sim_plant.drives.servo import ServoDrive

HEARTBEAT, ESTOP, GET_ERROR, RX_SDO, TX_SDO, SET_AXIS_STATE, GET_ENCODER_ESTIMATES = 1, 2, 3, 4, 5, 7, 9
SET_CONTROLLER_MODE, SET_INPUT_TORQUE, REBOOT, CLEAR_ERRORS = 0x0B, 0x0E, 0x16, 0x18
IDLE, CLOSED_LOOP_CONTROL = 1, 8
TORQUE_CONTROL, POSITION_CONTROL, PASSTHROUGH = 1, 3, 1
SUCCESS, DISARMED = 0, 3  # Procedure_Result
MISSING_ESTIMATE, DRIVE_FAULT, WATCHDOG_TIMER_EXPIRED, ESTOP_REQUESTED = 1 << 3, 1 << 5, 1 << 24, 1 << 25

READ, WRITE = 0, 1  # opcode
ENDPOINTS = {  # number: path below axis0, and the type of its value
    300: ("controller.config.control_mode", "I"),
    301: ("controller.config.input_mode", "I"),
    302: ("config.enable_watchdog", "?"),
    303: ("config.watchdog_timeout", "f"),
    304: ("config.torque_soft_max", "f"),
    305: ("config.torque_soft_min", "f"),
    306: ("controller.config.homing_speed", "f"),
    307: ("controller.config.vel_ramp_rate", "f"),
    308: ("trap_traj.config.vel_limit", "f"),
    309: ("trap_traj.config.accel_limit", "f"),
    310: ("trap_traj.config.decel_limit", "f"),
    311: ("min_endstop.config.enabled", "?"),
    312: ("min_endstop.config.offset", "f"),
    313: ("min_endstop.state", "?"),
}
CONFIGURED = {  # as delivered, turns and s; what a host may write
    "controller.config.homing_speed": 0.25,
    "controller.config.vel_ramp_rate": 1.0,
    "trap_traj.config.vel_limit": 2.0,
    "trap_traj.config.accel_limit": 0.5,
    "trap_traj.config.decel_limit": 0.5,
    "min_endstop.config.enabled": False,
    "min_endstop.config.offset": 0.0,
}
_ESTIMATES, _HEARTBEAT, _MODES = Struct("<ff"), Struct("<IBBBx"), Struct("<II")
_SDO = Struct("<BHx")
_STATE, _TORQUE, _ERRORS = Struct("<I"), Struct("<f"), Struct("<II")
_DEFECTS = (
    (int(DriveStatus.FAULT), DRIVE_FAULT),
    (int(DriveStatus.WATCHDOG), WATCHDOG_TIMER_EXPIRED),
    (int(DriveStatus.ENCODER_FAULT), MISSING_ESTIMATE),
)
_ENABLED = int(DriveStatus.ENABLED)


class Odrive(CyclicNode):
    """One axis. node_id: 0 to 63. turns: its encoder's position now, in turns of the motor.

    feedback_ns, heartbeat_ns: encoder_msg_rate_ms and heartbeat_msg_rate_ms. enable_delay_ns: from the request to
    closed loop control. instead: values that it acknowledges and has otherwise, by path. configured: values that were
    saved in it, in the place of CONFIGURED's.
    """

    def __init__(
        self,
        node_id: int,
        servo: ServoDrive,
        turns: Callable[[], float],
        start_ns: int,
        *,
        feedback_ns: int,
        heartbeat_ns: int,
        enable_delay_ns: int = 0,
        instead: Mapping[str, float] | None = None,
        configured: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(node_id, servo, start_ns, (feedback_ns, self._estimates), (heartbeat_ns, self._heartbeat))
        self._turns = turns
        self._base = node_id << 5
        self._enable_delay_ns = enable_delay_ns
        self._instead = dict(instead or {})
        self._configured = dict(configured or {})
        self._estop = False
        self._last = (start_ns, math.nan)
        self._restart()
        self._handlers: dict[int, Callable[[bytes], None]] = {
            ESTOP: self._on_estop,
            SET_AXIS_STATE: self._on_state,
            SET_CONTROLLER_MODE: self._on_mode,
            SET_INPUT_TORQUE: self._on_torque,
            REBOOT: lambda data: self._restart(),
            CLEAR_ERRORS: lambda data: self._clear_errors(),
        }
        self._queries = {HEARTBEAT: self._heartbeat, GET_ENCODER_ESTIMATES: self._estimates, GET_ERROR: self._error}

    def _restart(self) -> None:
        """As configured: position control, idle."""
        self._state, self._result = IDLE, SUCCESS
        rated = self.servo.rated_force
        limits = {"config.torque_soft_max": rated, "config.torque_soft_min": -rated}
        self._written: dict[str, float] = CONFIGURED | limits | self._configured
        self._modes = POSITION_CONTROL, PASSTHROUGH
        self._torque = 0.0
        self._enabling_ns = -1
        self._clear_errors()

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey or answer a frame to this axis."""
        can_id = frame.can_id & ~REMOTE
        if frame.flags & FD or can_id & ~0x1F != self._base:
            return []
        self.feed()
        self._settle()
        if frame.can_id & REMOTE:
            query = self._queries.get(can_id & 0x1F)
            return [query()] if query else []
        if can_id & 0x1F == RX_SDO:
            return self._on_sdo(frame.data)
        handler = self._handlers.get(can_id & 0x1F)
        if handler:
            handler(frame.data)
        return []

    def live(self) -> None:
        """Enter closed loop control when it is time; leave it where the servo has found a fault."""
        if 0 <= self._enabling_ns <= self.now_ns:
            self._enabling_ns = -1
            self._state = CLOSED_LOOP_CONTROL
            self._apply()
        self._settle()

    # commands ---------------------------------------------------------------------------------------------------------

    def _on_estop(self, data: bytes) -> None:
        self._estop = True
        self.servo.fail()
        self._settle()

    def _on_state(self, data: bytes) -> None:
        if len(data) < _STATE.size:
            return
        (requested,) = _STATE.unpack_from(data)
        self._enabling_ns = -1
        self._state = IDLE
        self._result = SUCCESS if requested == IDLE else DISARMED
        if requested == CLOSED_LOOP_CONTROL and not self._errors():
            self._result = SUCCESS
            if self._enable_delay_ns:
                self._enabling_ns = self.now_ns + self._enable_delay_ns
            else:
                self._state = CLOSED_LOOP_CONTROL
        self._apply()

    def _on_mode(self, data: bytes) -> None:
        if len(data) >= _MODES.size:
            control, passed = _MODES.unpack_from(data)
            self._modes = (
                int(self._instead.get("controller.config.control_mode", control)),
                int(self._instead.get("controller.config.input_mode", passed)),
            )
            self._apply()

    def _on_sdo(self, data: bytes) -> list[Frame]:
        """A read of an endpoint, or a write to one that may be written."""
        if len(data) < _SDO.size:
            return []
        opcode, number = _SDO.unpack_from(data)
        if number not in ENDPOINTS:
            return []
        path, kind = ENDPOINTS[number]
        code = Struct("<" + kind)
        if opcode == READ:
            value = self._value(path)
            return [self._send(TX_SDO, _SDO.pack(0, number) + code.pack(value if kind == "f" else int(value)))]
        if opcode == WRITE and path in self._written and len(data) >= _SDO.size + code.size:
            self._written[path] = code.unpack_from(data, _SDO.size)[0]
            self._apply()
        return []

    def _value(self, path: str) -> float:
        """Of an endpoint."""
        for values in (self._instead, self._written):
            if path in values:
                return values[path]
        return self._held()[path]

    def _held(self) -> dict[str, float]:
        """Endpoints that a host cannot write."""
        return {
            "controller.config.control_mode": self._modes[0],
            "controller.config.input_mode": self._modes[1],
            "config.enable_watchdog": True,
            "config.watchdog_timeout": self.servo.watchdog_ns * 1e-9,
            "min_endstop.state": False,
        }

    def _on_torque(self, data: bytes) -> None:
        if len(data) >= _TORQUE.size:
            (torque,) = _TORQUE.unpack_from(data)
            self._torque = torque if math.isfinite(torque) else 0.0
            self._apply()

    def _apply(self) -> None:
        """Torque by state and mode."""
        enabled = self._state != IDLE
        torque = self._within(self._demanded()) if enabled else 0.0
        self.servo.on_command(torque, enabled, False, 0, self.now_ns)
        self._settle()

    def _demanded(self) -> float:
        """Of the motor, N m."""
        return self._torque if self._modes == (TORQUE_CONTROL, PASSTHROUGH) else 0.0

    def _within(self, torque: float) -> float:
        """What the motor and the limits leave of it, N m."""
        rated = self.servo.rated_force
        high = min(rated, self._value("config.torque_soft_max"))
        return max(-rated, self._value("config.torque_soft_min"), min(high, torque))

    def _clear_errors(self) -> None:
        self._estop = False
        self.unlatch()

    def _settle(self) -> None:
        """An error ends closed loop control, and a procedure."""
        if self._state != IDLE and self._errors():
            self._state, self._result = IDLE, DISARMED

    def _errors(self) -> int:
        status = self.servo.status | self.servo.extra_status
        errors = sum(error for bit, error in _DEFECTS if status & bit)
        return (errors & ~DRIVE_FAULT) | ESTOP_REQUESTED if self._estop else errors

    # what it sends ----------------------------------------------------------------------------------------------------

    def _send(self, command: int, data: bytes) -> Frame:
        return Frame(self._base | command, data)

    def _estimates(self) -> Frame:
        position = self._turns()
        (then, before), self._last = self._last, (self.now_ns, position)
        elapsed = (self.now_ns - then) * 1e-9
        velocity = (position - before) / elapsed if elapsed > 0 and math.isfinite(before) else 0.0
        return self._send(GET_ENCODER_ESTIMATES, _ESTIMATES.pack(position, velocity))

    def _heartbeat(self) -> Frame:
        sample = self.shown()
        state = self._state
        if bool(sample.status & _ENABLED) != (state != IDLE):  # it is made to say so (fault injection)
            state = CLOSED_LOOP_CONTROL if sample.status & _ENABLED else IDLE
        return self._send(HEARTBEAT, _HEARTBEAT.pack(self._errors(), state, self._result, 0))

    def _error(self) -> Frame:
        errors = self._errors()
        return self._send(GET_ERROR, _ERRORS.pack(errors, errors))
