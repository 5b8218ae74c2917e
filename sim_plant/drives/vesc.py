"""An emulated VESC on its own CAN protocol, from its maker's documentation and not from any binding of ours.

Source: the firmware's documentation of its CAN protocol (github.com/vedderb/bldc). Rules:
- An identifier has 29 bits: command * 256 + VESC ID. Numbers are big-endian, signed.
- CAN_PACKET_SET_CURRENT (1): mA of the motor, clipped to its limits (l_current_max and l_current_min, times
  l_current_max_scale), at once. There is no enable: a current other than zero switches the power stage on, zero and the
  application timeout (timeout_msec; 0: none) release the motor (the least current counts as set to nothing). Nothing
  latches: the next command begins again.
- SET_CURRENT_BRAKE, SET_DUTY, SET_RPM and SET_POS are loops of its own, which are not emulated: no torque.
- It sends STATUS_4 (16: PID position, degrees times 50, of one turn) in its own time, and less often STATUS (9: ERPM,
  current, duty cycle) and STATUS_5 (27: tachometer, six to an electrical revolution).
- Its messages tell no fault and no state.
- CAN_PACKET_PROCESS_SHORT_BUFFER (8) with mode 0 asks for an answer: COMM_FW_VERSION, COMM_GET_MCCONF and
  COMM_GET_APPCONF. Its frames follow each other as the firmware hands them to the controller.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from struct import Struct
from typing import NamedTuple

from drivers.frame import EXTENDED, FD, Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.cyclic import CyclicNode
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from sim_plant.drives.vesc_configuration import (
    COMM_FW_VERSION,
    COMM_GET_APPCONF,
    COMM_GET_MCCONF,
    FIELDS,
    FIRMWARE,
    PROCESS_SHORT_BUFFER,
    SET_BY_NOBODY,
    answer,
    configuration,
)

SET_DUTY, SET_CURRENT, SET_CURRENT_BRAKE, SET_RPM, SET_POS = range(5)
STATUS, STATUS_4, STATUS_5 = 9, 16, 27

_CURRENT, _STATUS = Struct(">i"), Struct(">ihh")
_STATUS_4, _STATUS_5 = Struct(">hhhh"), Struct(">ihxx")
_PER_DEGREE, _PER_EREV, _PER_AMPERE = 50, 6, 10
_DEGREES = 360.0
_TRIPPED = int(DriveStatus.WATCHDOG)
ANSWER_FRAME = 300  # bits between two frames of an answer: a long one and as much again for others
_HUNDREDTHS = 100  # of an ampere, to which its current limits are set


class Motor(NamedTuple):
    """torque_constant: N m per A of motor current. pole_pairs: electrical per mechanical revolutions."""

    torque_constant: float
    pole_pairs: int


class Vesc(CyclicNode):
    """One VESC. node_id: its VESC ID, 0 to 254. turns: position of its motor now, in turns.

    feedback_ns: period of STATUS_4. status_ns: of STATUS and STATUS_5. instead: values of its configurations (FIELDS of
    vesc_configuration.py) that it has in place of those that fit its servo; it acts by them. Raises ValueError for a
    name that is none.
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
        instead: Mapping[str, float] | None = None,
        bitrate: int = 1_000_000,
    ) -> None:
        periodic = ((feedback_ns, self._status_4), (status_ns, self._status), (status_ns, self._status_5))
        super().__init__(node_id, servo, start_ns, *periodic)
        self._turns = turns
        self._motor = motor
        self._last = (start_ns, math.nan)
        self._answers: deque[Frame] = deque()
        self._answer_frame_ns = ANSWER_FRAME * 1_000_000_000 // bitrate
        self._answer_ns = self._status_ns = self.next_ns
        self.configure(instead or {})

    def configure(self, instead: Mapping[str, float]) -> None:
        """Set values of its configurations, by name; the others are as its servo has them."""
        unknown = sorted(set(instead) - set(FIELDS))
        if unknown:
            raise ValueError(f"{unknown[0]!r} is no value of an emulated VESC; there are {', '.join(FIELDS)}")
        most = math.ceil(self.servo.rated_force / self._motor.torque_constant * _HUNDREDTHS) / _HUNDREDTHS
        self._values = SET_BY_NOBODY | {
            "l_current_max": most,
            "l_current_min": -most,
            "controller_id": self.node_id,
            "timeout_msec": round(self.servo.watchdog_ns * 1e-6),
            **instead,
        }
        self.servo.watchdog_ns = round(self._values["timeout_msec"] * 1e6) or NEVER_NS

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey a frame to this VESC, or begin to answer it."""
        if not frame.can_id & EXTENDED or frame.flags & FD or frame.can_id & 0xFF != self.node_id:
            return []
        command = (frame.can_id & ~EXTENDED) >> 8
        if command == PROCESS_SHORT_BUFFER:
            self._on_packet(frame.data)
            return []
        if command > SET_POS or len(frame.data) < _CURRENT.size:
            return []
        if self.servo.status & _TRIPPED:
            self.unlatch()
        (value,) = _CURRENT.unpack_from(frame.data)
        values, limit = self._values, self.servo.rated_force
        scale = values["l_current_max_scale"] * 1e-4
        amperes = max(values["l_current_min"] * scale, min(values["l_current_max"] * scale, value * 1e-3))
        torque = amperes * self._motor.torque_constant if command == SET_CURRENT else 0.0
        self.servo.on_command(max(-limit, min(limit, torque)), torque != 0.0, False, 0, self.now_ns)
        return []

    def _on_packet(self, data: bytes) -> None:
        """A packet of one frame: the sender's VESC ID, a mode, the packet."""
        if len(data) < 3 or data[1] != 0:
            return
        asker, _, number = data[:3]
        packet = FIRMWARE if number == COMM_FW_VERSION else b""
        if number in (COMM_GET_MCCONF, COMM_GET_APPCONF):
            packet = configuration(number, self._values)
        if packet:
            if not self._answers:
                self._answer_ns = self.now_ns + self._answer_frame_ns
            self._answers += answer(packet, self.node_id, asker)
            self.next_ns = min(self._status_ns, self._answer_ns)

    def advance(self, now_ns: int) -> list[Frame]:
        """As every such drive, and the frames of answers that are due."""
        self.next_ns = self._status_ns
        frames = super().advance(now_ns)
        self._status_ns = self.next_ns
        while self._answers and self._answer_ns <= self.now_ns:
            frames.append(self._answers.popleft())
            self._answer_ns += self._answer_frame_ns
        if self._answers:
            self.next_ns = min(self._status_ns, self._answer_ns)
        return frames

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
