"""An emulated moteus controller, from its maker's documentation and not from the rig's layout.

Source: moteus' documentation, pages "CAN Protocol", "Register Reference", "Configuration" and "Timeout - mode 11"
(github.com/mjbots/moteus, docs). Rules:
- A frame to it has its number in bits 0 to 6, the sender's in bits 8 to 14, and in bit 15 whether an answer is wanted.
  The answer goes the other way; its identifier is an extended one where 11 bits are not enough.
- Frames are CAN FD and hold subframes that write and read registers, obeyed in their order; what follows one that is
  damaged is lost. What it reads is from before the frame came, as commands act in its next control cycle. Read
  registers come back as the type they were asked for. Registers that it has not, or may not be written, are answered
  with an error.
- Mode 10 (position): a frame that writes it begins from defaults: position 0, no feedforward, scales 1, watchdog as
  configured. Torque is the feedforward where the scale of the loop is 0. The loop itself is not emulated, nor are the
  other modes with power: they apply no torque.
- The watchdog timeout is that of the last such command; NaN: none. When it expires: mode 11, which is without torque
  (servo.timeout_mode 0). A defect: mode 1, with a code. Mode 0 alone leads out of both.
"""

import math
import struct
from collections.abc import Callable, Mapping

from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.cyclic import CyclicNode
from sim_plant.drives.servo import NEVER_NS, ServoDrive

STOPPED, FAULT, PREPARING, POSITION, TIMEOUT = 0, 1, 2, 10, 11
WITHOUT_LOOP = (5, 6, 7, 8, 9, 12, 13, 15)  # modes with power that are not emulated
MOTOR_DRIVER_FAULT, ENCODER_FAULT, LIMITED_BY_CURRENT, LIMITED_BY_COMMAND = 33, 35, 99, 102
_DEFAULTS = {0x20: 0.0, 0x21: 0.0, 0x22: 0.0, 0x23: 1.0, 0x24: 1.0, 0x25: math.nan, 0x27: 0.0}
_WRITABLE = {0x00, *_DEFAULTS, 0x26, 0x28, 0x29, 0x2A, 0x2B, 0x2C, 0x2D}
_PINS = ((int(DriveStatus.LIMIT_LOW), 1), (int(DriveStatus.LIMIT_HIGH), 2), (int(DriveStatus.HOME), 4))  # of aux 1
_FORMATS, _SIZES = "bhif", (1, 2, 4, 4)
_UNIT = {  # steps of int8, int16, int32
    "position": (0.01, 0.0001, 0.00001),
    "velocity": (0.1, 0.00025, 0.00001),
    "torque": (0.5, 0.01, 0.001),
    "scale": (1 / 127, 1 / 32767, 1 / 2147483647),
    "time": (0.01, 0.001, 0.000001),
    "voltage": (0.5, 0.1, 0.001),
    "temperature": (1.0, 0.1, 0.001),
}
_QUANTITY = {
    0x01: "position",
    0x02: "velocity",
    0x03: "torque",
    0x0D: "voltage",
    0x0E: "temperature",
    0x20: "position",
    0x21: "velocity",
    0x22: "torque",
    0x23: "scale",
    0x24: "scale",
    0x25: "torque",
    0x27: "time",
    0x2B: "scale",
}
_NAMES = {  # of registers that `instead` may name
    "mode": 0x00,
    "kp_scale": 0x23,
    "kd_scale": 0x24,
    "maximum_torque": 0x25,
    "watchdog_timeout": 0x27,
    "ilimit_scale": 0x2B,
}
_OF_SCALES = (1.0, 1.0, 1.0)


class Moteus(CyclicNode):
    """One controller. node_id: its id, 1 to 127. turns: of its output shaft now.

    enable_delay_ns: from the command to mode 10, by way of 2. instead: values that it acknowledges and has otherwise,
    by register; a mode: the one it enters in place of 10. inputs: DriveStatus with those of its switches. Raises
    ValueError for a register that is not among them.
    """

    fd = True

    def __init__(
        self,
        node_id: int,
        servo: ServoDrive,
        turns: Callable[[], float],
        start_ns: int,
        *,
        enable_delay_ns: int = 0,
        instead: Mapping[str, float] | None = None,
        inputs: Callable[[], int] = lambda: 0,
    ) -> None:
        super().__init__(node_id, servo, start_ns)
        unknown = sorted((instead or {}).keys() - _NAMES.keys())
        if unknown:
            raise ValueError(f"plant.drive.instead: {', '.join(unknown)}: none of {', '.join(_NAMES)}")
        self._instead = {_NAMES[name]: value for name, value in (instead or {}).items()}
        self._turns, self._inputs = turns, inputs
        self._enable_delay_ns = enable_delay_ns
        self._default_ns = servo.watchdog_ns
        self._mode = STOPPED
        self._speed = 0.0
        self._enabling_ns = 0  # while it prepares: when that has ended
        self._command = dict(_DEFAULTS)
        self._last = (start_ns, math.nan)
        self._told = (float(STOPPED), 0.0)  # mode and fault code when the latest frame came
        self._readers: dict[int, Callable[[], float]] = {
            0x00: lambda: self._told[0],
            0x01: self._position,
            0x02: self._velocity,
            0x03: lambda: servo.force,
            0x0C: lambda: 1.0,  # referenced to the rotor
            0x0D: lambda: 24.0,
            0x0E: lambda: 25.0,
            0x0F: lambda: self._told[1],
            0x5E: self._aux1,
            0x5F: lambda: 0.0,
        }

    def receive(self, frame: Frame) -> list[Frame]:
        """Obey a frame to this controller, and answer it where an answer is wanted."""
        number = frame.can_id & 0xFFFF
        extended = bool(frame.can_id & EXTENDED)
        if not frame.flags & FD or number & 0xFF != self.node_id or (number > 0x7FF and not extended):
            return []
        self._sample()
        reply = self._obey(frame.data)
        self.servo.last_command_ns = self.now_ns
        if not number & 0x8000:
            return []
        can_id = self.node_id << 8 | number >> 8 & 0x7F
        length = next((length for length in FD_LENGTHS if length >= len(reply)), 0)
        if not length and reply:
            return []  # more than a frame holds
        data = bytes(reply) + b"\x50" * (length - len(reply))
        return [Frame(can_id if can_id <= 0x7FF else EXTENDED | can_id, data, FD | BRS)]

    def live(self) -> None:
        """Enter the mode that was asked for when it is time."""
        if self.mode == PREPARING and self._enabling_ns <= self.now_ns:
            self._mode = POSITION
            self._apply()

    @property
    def mode(self) -> int:
        """The mode that it is in."""
        status = self.servo.status
        if status & DriveStatus.FAULT:
            return FAULT
        return TIMEOUT if status & DriveStatus.WATCHDOG else self._mode

    def _sample(self) -> None:
        before, now = self._last, self._turns()
        elapsed = (self.now_ns - before[0]) * 1e-9
        self._speed = (now - before[1]) / elapsed if elapsed > 0 and math.isfinite(before[1]) else 0.0
        self._last = self.now_ns, now
        self._told = self._shown_mode(), self._fault()
        self.sampled_ns = self.now_ns

    # subframes --------------------------------------------------------------------------------------------------------

    def _obey(self, data: bytes) -> bytearray:
        """Every subframe in turn. What it answers."""
        reply = bytearray()
        at, told = 0, False
        try:
            while at < len(data):
                head, at = data[at], at + 1
                if head == 0x50:
                    continue
                kind, count = head >> 2 & 3, head & 3
                if head & 0xF0 not in (0x00, 0x10):
                    break  # an operation that is none of its own: the rest has no meaning
                if not count:
                    count, at = _number(data, at)
                first, at = _number(data, at)
                if head & 0x10:
                    self._read(first, count, kind, reply)
                    continue
                values = struct.unpack_from(f"<{count}{_FORMATS[kind]}", data, at)
                at += count * _SIZES[kind]
                for register, value in enumerate(values, first):
                    told = self._write(register, kind, value, reply) or told
        except (IndexError, struct.error):
            pass
        if told:
            self._apply()
        return reply

    def _write(self, register: int, kind: int, raw: float, reply: bytearray) -> bool:
        """Write a register; whether it was one of a command in a mode with power."""
        if register not in _WRITABLE:
            reply += bytes((0x30, *_varuint(register), 2 if register in self._readers else 1))
            return False
        value = _physical(register, kind, raw)
        if register == 0x00:
            return self._enter(value)
        self._command[register] = self._instead.get(register, value)
        return self._mode in (POSITION, PREPARING)

    def _read(self, first: int, count: int, kind: int, reply: bytearray) -> None:
        for register in range(first, first + min(count, 64)):
            reader = self._readers.get(register)
            if reader is None and register not in self._command:
                reply += bytes((0x31, *_varuint(register), 1))
                continue
            value = reader() if reader else self._command[register]
            reply += bytes((0x20 | kind << 2 | 1, *_varuint(register))) + _packed(register, kind, value)

    # modes ------------------------------------------------------------------------------------------------------------

    def _enter(self, mode: float) -> bool:
        """A mode is written; whether it is one that applies what follows."""
        if mode == STOPPED:
            self._mode = STOPPED
            self.unlatch()
            self.servo.deadline_ns = NEVER_NS
            return False
        if self.mode in (FAULT, TIMEOUT):
            return False
        self._command = dict(_DEFAULTS)
        mode = self._instead.get(0x00, mode)
        if mode == POSITION:
            if self._mode not in (POSITION, PREPARING):
                self._mode = PREPARING if self._enable_delay_ns else POSITION
                self._enabling_ns = self.now_ns + self._enable_delay_ns
            return True
        if mode in WITHOUT_LOOP:
            self._mode = int(mode)
            return True
        return False

    def _apply(self) -> None:
        """Torque and watchdog by what was told."""
        if self.mode in (STOPPED, FAULT, TIMEOUT):
            return
        servo, command = self.servo, self._command
        timeout = command[0x27]
        servo.watchdog_ns = NEVER_NS if math.isnan(timeout) else round(timeout * 1e9) or self._default_ns
        servo.on_command(self._torque(), self.mode != PREPARING, False, 0, self.now_ns)

    def _torque(self) -> float:
        command = self._command
        torque = command[0x22]
        if self.mode != POSITION or command[0x23] != 0.0 or not math.isfinite(torque):
            return 0.0
        limit = self._limit()
        return max(-limit, min(limit, torque))

    def _limit(self) -> float:
        most = self._command[0x25]
        return self.servo.rated_force if math.isnan(most) else min(abs(most), self.servo.rated_force)

    # what it tells ----------------------------------------------------------------------------------------------------

    def _aux1(self) -> float:
        """GPIO status: limit switches at pins 1 and 2, the home switch at pin 3, high when closed."""
        status = self._inputs()
        return float(sum(bit for closed, bit in _PINS if status & closed))

    def _position(self) -> float:
        return self._last[1]

    def _velocity(self) -> float:
        return self._speed

    def _shown_mode(self) -> float:
        """Its mode, or what faults injected into it let it say."""
        status, mode = self.shown().status, self.mode
        if status & (DriveStatus.FAULT | DriveStatus.ENCODER_FAULT):
            return FAULT
        if status & DriveStatus.WATCHDOG:
            return TIMEOUT
        powered = mode not in (STOPPED, FAULT, PREPARING, TIMEOUT)
        if bool(status & DriveStatus.ENABLED) != powered:
            return POSITION if status & DriveStatus.ENABLED else STOPPED
        return mode

    def _fault(self) -> float:
        status = self.shown().status
        if status & DriveStatus.ENCODER_FAULT:
            return ENCODER_FAULT
        if status & DriveStatus.FAULT:
            return MOTOR_DRIVER_FAULT
        if self.mode == POSITION and abs(self._command[0x22]) > self._limit() * (1 + 1e-6):
            limited_by_command = self._limit() < self.servo.rated_force
            return LIMITED_BY_COMMAND if limited_by_command else LIMITED_BY_CURRENT
        return 0


def _number(data: bytes, at: int) -> tuple[int, int]:
    """A varuint, and where it ends. Raises IndexError where it is cut short or longer than five bytes."""
    value = 0
    for place in range(5):
        byte = data[at + place]
        value |= (byte & 0x7F) << 7 * place
        if not byte & 0x80:
            return value, at + place + 1
    raise IndexError


def _varuint(value: int) -> list[int]:
    encoded = []
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return [*encoded, value]


def _physical(register: int, kind: int, raw: float) -> float:
    """In units of the register; the least integer is none."""
    if kind == 3:
        return raw
    if raw == -(1 << (8 * _SIZES[kind] - 1)):
        return math.nan
    quantity = _QUANTITY.get(register)
    return raw * (_UNIT[quantity] if quantity else _OF_SCALES)[kind]


def _packed(register: int, kind: int, value: float) -> bytes:
    """As it is sent; beyond the ends of its type it stays there, none is the least integer."""
    if kind == 3:
        return struct.pack("<f", value)
    most = (1 << (8 * _SIZES[kind] - 1)) - 1
    if not math.isfinite(value):
        return struct.pack("<" + _FORMATS[kind], -most - 1)
    quantity = _QUANTITY.get(register)
    steps = round(value / (_UNIT[quantity] if quantity else _OF_SCALES)[kind])
    return struct.pack("<" + _FORMATS[kind], max(-most, min(most, steps)))
