"""An emulated VESC on its own CAN protocol, from its maker's documentation and not from any binding of ours.

Source: the firmware's documentation of its CAN protocol (github.com/vedderb/bldc). Rules:
- An identifier has 29 bits: command * 256 + VESC ID. Numbers are big-endian, signed.
- CAN_PACKET_SET_CURRENT (1): mA of the motor, clipped to its limit, at once. There is no enable: a current other than
  zero switches the power stage on, zero and the application timeout release the motor (the least current counts as set
  to nothing). Nothing latches: the next command begins again.
- SET_CURRENT_BRAKE, SET_DUTY, SET_RPM and SET_POS are loops of its own, which are not emulated: no torque.
- It sends STATUS_4 (16: PID position, degrees times 50, of one turn) in its own time, and less often STATUS (9: ERPM,
  current, duty cycle) and STATUS_5 (27: tachometer, six to an electrical revolution).
- Its messages tell no fault and no state.
"""

import math
from collections.abc import Callable
from struct import Struct
from typing import NamedTuple

from drivers.frame import EXTENDED, FD, Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.cyclic import CyclicNode
from sim_plant.drives.servo import ServoDrive

SET_DUTY, SET_CURRENT, SET_CURRENT_BRAKE, SET_RPM, SET_POS = range(5)
STATUS, STATUS_4, STATUS_5 = 9, 16, 27

_CURRENT, _STATUS = Struct(">i"), Struct(">ihh")
_STATUS_4, _STATUS_5 = Struct(">hhhh"), Struct(">ihxx")
_PER_DEGREE, _PER_EREV, _PER_AMPERE = 50, 6, 10
_DEGREES = 360.0
_TRIPPED = int(DriveStatus.WATCHDOG)


class Motor(NamedTuple):
    """torque_constant: N m per A of motor current. pole_pairs: electrical per mechanical revolutions."""

    torque_constant: float
    pole_pairs: int


class Vesc(CyclicNode):
    """One VESC. node_id: its VESC ID, 0 to 254. turns: position of its motor now, in turns.

    feedback_ns: period of STATUS_4. status_ns: of STATUS and STATUS_5.
    """

    def __init__(
        self,
        node_id: int,
        servo: ServoDrive,
        turns: Callable[[], float],
        start_ns: int,
        *,
        motor: Motor,
        feedback_ns: int,
        status_ns: int,
    ) -> None:
        periodic = ((feedback_ns, self._status_4), (status_ns, self._status), (status_ns, self._status_5))
        super().__init__(node_id, servo, start_ns, *periodic)
        self._turns = turns
        self._motor = motor
        self._last = (start_ns, math.nan)

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey a frame to this VESC; it answers none."""
        if not frame.can_id & EXTENDED or frame.flags & FD or frame.can_id & 0xFF != self.node_id:
            return []
        command = (frame.can_id & ~EXTENDED) >> 8
        if command > SET_POS or len(frame.data) < _CURRENT.size:
            return []
        if self.servo.status & _TRIPPED:
            self.unlatch()
        (value,) = _CURRENT.unpack_from(frame.data)
        limit = self.servo.rated_force
        torque = value * 1e-3 * self._motor.torque_constant if command == SET_CURRENT else 0.0
        self.servo.on_command(max(-limit, min(limit, torque)), torque != 0.0, False, 0, self.now_ns)
        return []

    def _send(self, command: int, data: bytes) -> Frame:
        return Frame(EXTENDED | command << 8 | self.node_id, data)

    def _status_4(self) -> Frame:
        self._last = (self.now_ns, self._turns())
        raw = round(self._last[1] % 1.0 * _DEGREES * _PER_DEGREE) % round(_DEGREES * _PER_DEGREE)
        return self._send(STATUS_4, _STATUS_4.pack(250, 250, 0, raw))

    def _status(self) -> Frame:
        amperes = self.servo.force / self._motor.torque_constant
        return self._send(STATUS, _STATUS.pack(0, max(-32768, min(32767, round(amperes * _PER_AMPERE))), 0))

    def _status_5(self) -> Frame:
        tachometer = round(self._turns() * self._motor.pole_pairs * _PER_EREV)
        return self._send(STATUS_5, _STATUS_5.pack(tachometer, 240))
