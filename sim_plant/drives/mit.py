"""Emulated drives of the MIT kind, from their makers' documents and not from the rig's layout.

Sources: Damiao, motor user guide of the DM-J4310-2EC (MIT mode, feedback frame, ERR); CubeMars, AK series module driver
user manual, 5.3; RobStride, user manual of the RS01 (private protocol). Rules:
- Every frame to a drive is answered with position, speed, torque and its state. A frame of another length is none.
- The power stage is switched on by an order of its own, unless the drive has an error, and off by another.
- A command has position, speed, two gains and a torque. The loop over the gains is not emulated: a command with a gain
  applies no torque.
- A value of n bits goes evenly over its range; what is beyond is sent as the end of the range.
- The timeout ends torque. Damiao says so (ERR D), and it and any other error end with `clear`; CubeMars forgets it
  when it is told to stop; RobStride ends it with the stop that clears faults.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from drivers.frame import EXTENDED, FD, Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.cyclic import CyclicNode
from sim_plant.drives.servo import ServoDrive

_TURN = 2.0 * math.pi
_ENABLED = int(DriveStatus.ENABLED)
_WATCHDOG = int(DriveStatus.WATCHDOG)
_ENCODER = int(DriveStatus.ENCODER_FAULT)
_BROKEN = int(DriveStatus.FAULT) | _ENCODER
ENABLE, DISABLE, CLEAR_ERROR = 0xFC, 0xFD, 0xFB  # after seven FF
CONTROL, FEEDBACK, START, STOP = 1, 2, 3, 4  # types of RobStride
SPEED = 45.0  # rad/s, the greatest that is told


class Ranges(NamedTuple):
    """Greatest position (rad) and torque (N m) of a drive's values. host: number or identifier that it answers to."""

    position: float
    torque: float
    host: int


class MitDrive(CyclicNode):
    """What the three have in common. turns: of the output shaft now."""

    def __init__(
        self, node_id: int, servo: ServoDrive, turns: Callable[[], float], start_ns: int, ranges: Ranges
    ) -> None:
        super().__init__(node_id, servo, start_ns)
        self._turns = turns
        self._ranges = ranges
        self._on = False
        self._last = (start_ns, math.nan)
        self._position = self._speed = 0.0

    def start(self) -> None:
        """Power stage on, if nothing is wrong."""
        if not self.servo.status & (_BROKEN | _WATCHDOG):
            self._on = True
            self.servo.on_command(0.0, True, False, 0, self.now_ns)

    def stop(self) -> None:
        """Power stage off."""
        self._on = False
        self.servo.on_command(0.0, False, False, 0, self.now_ns)

    def clear(self) -> None:
        """Power stage off, errors ended."""
        self.stop()
        self.unlatch()

    def apply(self, torque: float, gains: bool) -> None:
        """Torque, N m, where the stage is on."""
        if self._on and self.servo.status & (_BROKEN | _WATCHDOG):
            self._on = False
        limit = min(self.servo.rated_force, self._ranges.torque)
        torque = 0.0 if gains or not self._on else max(-limit, min(limit, torque))
        self.servo.on_command(torque, self._on, False, 0, self.now_ns)

    def look(self) -> None:
        """Sample the encoder."""
        (then, before), turns = self._last, self._turns()
        elapsed = (self.now_ns - then) * 1e-9
        self._position = turns * _TURN
        self._speed = (turns - before) * _TURN / elapsed if elapsed > 0 and math.isfinite(before) else 0.0
        self._last = self.now_ns, turns
        self.sampled_ns = self.now_ns

    def told(self, bits: int) -> tuple[int, int]:
        """Speed and torque in so many bits."""
        return packed(self._speed, SPEED, bits), packed(self.servo.force, self._ranges.torque, bits)


class Damiao(MitDrive):
    """Commands in its CAN_ID, answers in its MST_ID."""

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey and answer."""
        if frame.can_id != self.node_id or frame.flags & FD or len(frame.data) != 8:
            return []
        self.look()
        if frame.data[:7] == b"\xff" * 7 and frame.data[7] >= CLEAR_ERROR:
            self._order(frame.data[7])
        else:
            kp = (frame.data[3] & 0xF) << 8 | frame.data[4]
            kd = frame.data[5] << 4 | frame.data[6] >> 4
            torque = (frame.data[6] & 0xF) << 8 | frame.data[7]
            self.apply(unpacked(torque, self._ranges.torque, 12), bool(kp or kd))
        return [self._answer()]

    def _order(self, code: int) -> None:
        if code == ENABLE:
            self.start()
        elif code == DISABLE:
            self.stop()
        elif code == CLEAR_ERROR:
            self.clear()

    def _values(self) -> bytes:
        position = packed(self._position, self._ranges.position, 16)
        speed, torque = self.told(12)
        return (position << 24 | speed << 12 | torque).to_bytes(5, "big")

    def _answer(self) -> Frame:
        status = self.shown().status
        error = 0xD if status & _WATCHDOG else 0xA if status & _BROKEN else status & _ENABLED
        return Frame(self._ranges.host, bytes((error << 4 | self.node_id & 0xF,)) + self._values() + bytes((30, 28)))


class CubeMars(Damiao):
    """The same frames; its answers tell errors, not whether it is on. It forgets a timeout when it is told to stop.

    answers_as_asked: it answers in the identifier in which it is asked. No node hears itself, but on the emulated bus.
    """

    @property
    def answers_as_asked(self) -> bool:
        """Whether both have one identifier."""
        return self._ranges.host == self.node_id

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey and answer; what begins with its number is its own answer."""
        own = self.answers_as_asked and frame.data[:1] == bytes((self.node_id,))
        return [] if own else super().receive(frame)

    def _order(self, code: int) -> None:
        if code == ENABLE:
            self.start()
        elif code == DISABLE:
            self.clear()

    def _answer(self) -> Frame:
        status = self.shown().status
        error = 5 if status & _ENCODER else 2 if status & _BROKEN else 0
        return Frame(self._ranges.host, bytes((self.node_id,)) + self._values() + bytes((28, error)))


class RobStride(MitDrive):
    """Extended identifiers with values in them."""

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey and answer."""
        if not frame.can_id & EXTENDED or frame.flags & FD or len(frame.data) != 8:
            return []
        kind, middle, node = frame.can_id >> 24 & 0x1F, frame.can_id >> 8 & 0xFFFF, frame.can_id & 0xFF
        if node != self.node_id or kind not in (CONTROL, START, STOP):
            return []
        self.look()
        if kind == CONTROL:
            self.apply(unpacked(middle, self._ranges.torque, 16), any(frame.data[4:]))
        elif kind == START:
            self.start()
        elif frame.data[0] == 1:
            self.clear()
        else:
            self.stop()
        return [self._answer()]

    def _answer(self) -> Frame:
        status = self.shown().status
        faults = 0x08 if status & _ENCODER else 0x02 if status & (_BROKEN | _WATCHDOG) else 0
        mode = 2 if status & _ENABLED else 0
        speed, torque = self.told(16)
        position = packed(self._position, self._ranges.position, 16)
        data = b"".join(value.to_bytes(2, "big") for value in (position, speed, torque, 285))
        return Frame(
            EXTENDED | FEEDBACK << 24 | mode << 22 | faults << 16 | self.node_id << 8 | self._ranges.host, data
        )


def packed(value: float, greatest: float, bits: int) -> int:
    """As it is sent."""
    inside = max(-greatest, min(greatest, value))
    return int((inside + greatest) * ((1 << bits) - 1) / (2.0 * greatest))


def unpacked(code: int, greatest: float, bits: int) -> float:
    """What a code means."""
    return code * 2.0 * greatest / ((1 << bits) - 1) - greatest
