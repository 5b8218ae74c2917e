"""An emulated ODrive that homes by itself (axis state 11), by loops of its own on the stage that it moves.

By its maker's manual, page "Endstops/Homing", and the published firmware 0.5: the drive needs its min_endstop enabled.
In velocity control it moves in its negative direction at homing_speed, with ramps of vel_ramp_rate, until the endstop
closes. Then it goes to its zero, which is min_endstop.config.offset away, within the limits of its trapezoidal
trajectory. It counts from there, is in the mode of before, and idle. Any error, and any other state that is requested,
end it: the controller mode then stays that of homing. Its endstop is the limit switch at the least position.

Its velocity loop is a PI controller with the gains of its installer for the torque that the motor is rated for. What it
asks for is held within torque_soft_min and torque_soft_max.
"""

import math
from collections.abc import Callable
from enum import Enum, auto
from struct import Struct
from typing import Any

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.odrive import IDLE, SUCCESS, Odrive
from sim_plant.drives.servo import Counter, ServoDrive

HOMING = 11  # axis state
VELOCITY_CONTROL, POSITION_CONTROL, VEL_RAMP, TRAP_TRAJ = 2, 3, 2, 5
BUSY, CANCELLED, HOMING_WITHOUT_ENDSTOP = 1, 2, 12  # Procedure_Result
STEP_NS = 200_000  # between two steps of its loop
DAMPING, STIFFNESS = 5.0, 500.0  # of the rated torque a m/s, and a m, at the axis
POSITION_GAIN = 20.0  # m/s a m
ARRIVED = 5e-5  # m
_STATE = Struct("<I")
_PRESSED = int(DriveStatus.LIMIT_LOW)


class Phase(Enum):
    """Where its homing is."""

    NONE = auto()
    TO_ENDSTOP = auto()
    TO_ZERO = auto()


class HomingOdrive(Odrive):
    """phase: of its homing."""

    phase = Phase.NONE
    _velocity = _integral = _before = _zero = _loop_torque = 0.0  # m/s, N m, m, m, N m
    _seen_ns = 0

    def __init__(
        self, node_id: int, servo: ServoDrive, turns: Callable[[], float], start_ns: int, *, turn: float,
        inputs: Callable[[], int], **more: Any,
    ) -> None:  # fmt: skip
        """turn: m of the axis a turn, above 0. inputs: DriveStatus with its limit switches."""
        self._turn, self._inputs = turn, inputs
        self._stored = (0, 0)  # modes of before
        installed = {"min_endstop.config.enabled": bool(servo.switches.there & _PRESSED)}
        super().__init__(node_id, servo, turns, start_ns, configured=installed, **more)

    # hooks of the drive -----------------------------------------------------------------------------------------------

    def advance(self, now_ns: int) -> list[Frame]:
        """As any node; its loop wants to be called while it homes."""
        frames = super().advance(now_ns)
        due_ns = min(due_ns for due_ns, _ in self._periodic)
        self.next_ns = due_ns if self.phase is Phase.NONE else min(due_ns, self._seen_ns + STEP_NS)
        return frames

    def live(self) -> None:
        """A step of its loop, where one is due."""
        super().live()
        if self.phase is not Phase.NONE and self.now_ns - self._seen_ns >= STEP_NS:
            self._follow()

    def _on_state(self, data: bytes) -> None:
        homes, self.phase = self.phase is not Phase.NONE, Phase.NONE
        super()._on_state(data)
        if homes and self._state == IDLE:
            self._result = CANCELLED
        if len(data) >= _STATE.size and _STATE.unpack_from(data)[0] == HOMING and not self._errors():
            self._begin()

    def _settle(self) -> None:
        super()._settle()
        if self._state == IDLE:
            self.phase = Phase.NONE

    def _demanded(self) -> float:
        return self._loop_torque if self.phase is not Phase.NONE else super()._demanded()

    def _held(self) -> dict[str, float]:
        return super()._held() | {"min_endstop.state": self._pressed()}

    # homing -----------------------------------------------------------------------------------------------------------

    def _pressed(self) -> bool:
        return bool(self._inputs() & _PRESSED)

    def _position(self) -> float:
        """Of the axis as its counter has it, m."""
        return self._turns() * self._turn

    def _begin(self) -> None:
        if not self._value("min_endstop.config.enabled"):
            self._result = HOMING_WITHOUT_ENDSTOP
            return
        self._state, self._result, self.phase = HOMING, BUSY, Phase.TO_ENDSTOP
        self._stored, self._modes = self._modes, (VELOCITY_CONTROL, VEL_RAMP)
        self._before, self._seen_ns = self._position(), self.now_ns
        self._velocity = self._integral = self._loop_torque = 0.0
        self._apply()

    def _follow(self) -> None:
        """A step of its loop. It feeds no watchdog."""
        seconds, self._seen_ns = (self.now_ns - self._seen_ns) * 1e-9, self.now_ns
        position = self._position()
        speed, self._before = (position - self._before) / seconds, position
        self._look(position)
        if self.phase is Phase.NONE:
            return
        step = self._rise() * self._turn * seconds
        self._velocity += max(-step, min(step, self._wanted(position) - self._velocity))
        rated, late = self.servo.rated_force, self._velocity - speed
        self._integral = self._within(self._integral + rated * STIFFNESS * late * seconds)
        self._loop_torque = self._integral + rated * DAMPING * late
        deadline_ns = self.servo.deadline_ns
        self._apply()
        self.servo.deadline_ns = deadline_ns

    def _rise(self) -> float:
        """Turns/s^2."""
        name = "controller.config.vel_ramp_rate" if self.phase is Phase.TO_ENDSTOP else "trap_traj.config.accel_limit"
        return self._value(name)

    def _wanted(self, position: float) -> float:
        """Velocity, m/s."""
        if self.phase is Phase.TO_ENDSTOP:
            return -self._value("controller.config.homing_speed") * self._turn
        way = self._zero - position
        braking = math.sqrt(2.0 * self._value("trap_traj.config.decel_limit") * self._turn * abs(way))
        most = min(self._value("trap_traj.config.vel_limit") * self._turn, POSITION_GAIN * abs(way), braking)
        return math.copysign(most, way)

    def _look(self, position: float) -> None:
        """For the endstop, or whether it has arrived."""
        if self.phase is Phase.TO_ENDSTOP and self._pressed():
            self.phase, self._modes = Phase.TO_ZERO, (POSITION_CONTROL, TRAP_TRAJ)
            self._velocity = 0.0  # its trajectory begins at rest
            self._zero = position - self._value("min_endstop.config.offset") * self._turn
        elif self.phase is Phase.TO_ZERO and abs(position - self._zero) < ARRIVED:
            self._count_from_zero()

    def _count_from_zero(self) -> None:
        """It is home."""
        counter = self.servo.counter
        if counter is None:
            counter = self.servo.counter = Counter(0.0, None)
        counter.zero += self._zero
        self.phase, self._state, self._result = Phase.NONE, IDLE, SUCCESS
        self._modes = self._stored
        self._apply()
