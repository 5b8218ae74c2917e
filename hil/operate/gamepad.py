"""A gamepad as the kernel tells it: 24-byte events of a device below /dev/input (linux/input.h), no library needed.

What is not certain counts as let go: after events that the kernel dropped, and once the device is gone.
"""

import contextlib
import fcntl
import os
import struct
from collections.abc import Sequence
from glob import glob
from pathlib import Path
from typing import Final, NamedTuple

from hil.live.mapped_file import Closing

PADS: Final = "/dev/input/by-id/*-event-joystick"  # as udev names them
LEFT_X, LEFT_Y, RIGHT_X, RIGHT_Y, HAT_Y = 0, 1, 3, 4, 17  # ABS_X, ABS_Y, ABS_RX, ABS_RY, ABS_HAT0Y
SOUTH, EAST, SHOULDER_LEFT, SHOULDER_RIGHT, SELECT, START = 0x130, 0x131, 0x136, 0x137, 0x13A, 0x13B  # BTN_*
DEAD: Final = 0.12  # of a stick's way, at least, that is its middle
_EVENT: Final = struct.Struct("@llHHi")  # struct input_event: time, type, code, value
_RANGE: Final = struct.Struct("@6i")  # struct input_absinfo: value, minimum, maximum, fuzz, flat, resolution
_SYN, _KEY, _ABS = 0, 1, 3
_DROPPED: Final = 3  # SYN_DROPPED
_MOST: Final = 64  # events a read
_GET_ABS: Final = 2 << 30 | _RANGE.size << 16 | ord("E") << 8 | 0x40  # EVIOCGABS of axis 0


class Range(NamedTuple):
    """Of a stick: its ends, and how far from the middle it still is centred, in the device's counts."""

    low: int = -32768
    high: int = 32767
    flat: int = 0

    def part(self, value: int) -> float:
        """Of its way from the middle, -1 to 1; 0 in the dead zone, and rising from 0 behind it."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        way = max(-1.0, min((value - middle) / half, 1.0))
        dead = max(DEAD, self.flat / half)
        return 0.0 if abs(way) <= dead else (abs(way) - dead) / (1.0 - dead) * (1.0 if way > 0 else -1.0)


class GamepadGoneError(Exception):
    """The device was unplugged, or is none; the text says which."""


class Gamepad(Closing):
    """Its sticks and buttons, as of the last `read`."""

    def __init__(self, fd: int) -> None:
        """fd: of the device, opened without blocking; closed with this."""
        self._fd = fd
        self._ranges = {axis: _range(fd, axis) for axis in (LEFT_X, LEFT_Y, RIGHT_X, RIGHT_Y, HAT_Y)}
        self._values: dict[int, int] = {}
        self._held: set[int] = set()
        self._rest = b""
        self._skipping = False  # until the next report, after the kernel dropped some

    @classmethod
    def open(cls, path: str | None = None) -> "Gamepad":
        """Of a device; None: the first one that udev calls a joystick. Raises GamepadGoneError."""
        found = path or next(iter(sorted(glob(PADS))), None)
        if found is None:
            raise GamepadGoneError(f"no gamepad at {PADS}: name its device, --device /dev/input/event5")
        try:
            return cls(os.open(Path(found), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC))
        except OSError as error:
            raise GamepadGoneError(f"{found}: {error.strerror}; its readers are root and the group input") from None

    def fileno(self) -> int:
        """To wait for events on."""
        return self._fd

    def read(self) -> list[int]:
        """Take in what has come; buttons that were pressed. Raises GamepadGoneError."""
        try:
            data = os.read(self._fd, _MOST * _EVENT.size)
        except BlockingIOError:
            return []
        except OSError as error:
            self.let_go()
            raise GamepadGoneError(f"the gamepad is gone: {error.strerror}") from None
        if not data:
            self.let_go()
            raise GamepadGoneError("the gamepad is gone")
        return self.take(data)

    def take(self, data: bytes) -> list[int]:
        """The same of bytes as the kernel sends them."""
        data, pressed = self._rest + data, []
        whole = len(data) - len(data) % _EVENT.size
        self._rest = data[whole:]
        for _, _, kind, code, value in _EVENT.iter_unpack(data[:whole]):
            if kind == _SYN:
                self._skipping = code == _DROPPED
                if self._skipping:
                    self.let_go()
            elif kind == _KEY and not self._skipping:
                (self._held.add if value else self._held.discard)(code)
                if value == 1:
                    pressed.append(code)
            elif kind == _ABS and not self._skipping:
                self._values[code] = value
                if code == HAT_Y and value:
                    pressed.append(HAT_Y if value > 0 else -HAT_Y)
        return pressed

    def let_go(self) -> None:
        """As if every stick were centred and no button held."""
        self._values.clear()
        self._held.clear()

    def stick(self, axis: int) -> float:
        """-1 to 1; down and right are positive, as the kernel counts."""
        return self._ranges[axis].part(self._values[axis]) if axis in self._values else 0.0

    def holds(self, buttons: Sequence[int]) -> bool:
        """One of them is held."""
        return any(button in self._held for button in buttons)

    def close(self) -> None:
        """Let go of the device."""
        os.close(self._fd)


def _range(fd: int, axis: int) -> Range:
    """As the driver says; of what is no device, that of most gamepads."""
    with contextlib.suppress(OSError):
        _, low, high, _, flat, _ = _RANGE.unpack(fcntl.ioctl(fd, _GET_ABS + axis, bytes(_RANGE.size)))
        if low < high:
            return Range(low, high, flat)
    return Range()
