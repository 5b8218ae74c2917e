"""`kind = "dbc"`: a reading that is a signal of a DBC file, in the message of the sensor's identifier."""

from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import Any

from drivers.frame import FD, FD_LENGTHS, Frame
from drivers.protocols.base import LayoutError, Reject
from drivers.protocols.dbc_codec import compile_codec, message_of_node
from drivers.sensors.base import Measured
from drivers.sensors.config import SensorConfig

_FLOAT_STEPS = 2.0**24  # of a floating-point number, over the sensor's range: as fine as 32 bits are


class DbcSensorFrame:
    """One sensor's message. name: of the sensor. Raises LayoutError naming the key."""

    def __init__(self, name: str, config: SensorConfig, base_dir: Path) -> None:
        self._key = f"sensors.{name}"
        self.message = message = message_of_node(
            self._key, base_dir / config.file, config.can_id, fd=config.fd, what="sensor"
        )
        self.can_ids = (config.can_id,)
        self.problem = ""
        self._fd = config.fd
        codec = compile_codec(message)
        self._length = codec.length
        self._unpack: Callable[[bytes], tuple[Any, ...]] = codec.unpack
        places = {signal: place for place, signal in enumerate(codec.names)}
        named = {key: self._place(key, getattr(config, key), places) for key in ("signal", "counter", "status")}
        self._value, self._counter, self._status = named["signal"], named["counter"], named["status"]
        signal = message.get_signal_by_name(config.signal)
        self._factor, self._offset = float(signal.scale) * config.scale, float(signal.offset) * config.scale
        self._wrap = 1 << message.get_signal_by_name(config.counter).length if config.counter else 256
        self._counted, self._sequence = 0, -1
        low, high = config.range
        if signal.is_float:
            problem = config.unfit((high - low) / _FLOAT_STEPS, low, 2.0 * abs(high) + 1.0)
        else:
            least = -(1 << signal.length - 1) if signal.is_signed else 0
            ends = [least * self._factor + self._offset, (least + (1 << signal.length)) * self._factor + self._offset]
            problem = config.unfit(abs(self._factor), min(ends), max(ends))
        if problem:
            raise LayoutError(f"{self._key}: {problem}")

    def _place(self, key: str, name: str, places: dict[str, int]) -> int:
        if name and name not in places:
            there = ", ".join(places) or "none"
            raise LayoutError(f"{self._key}.{key} = '{name}': message {self.message.name} has {there}")
        return places[name] if name else -1

    def decode(self, frame: Frame) -> Measured | Reject:
        """See SensorReader."""
        data = frame.data
        if bool(frame.flags & FD) != self._fd:
            return Reject.WRONG_FORMAT
        if len(data) != self._length and not (self._fd and len(data) in FD_LENGTHS and len(data) > self._length):
            return Reject.WRONG_LENGTH
        raw = self._unpack(data[: self._length])
        value = raw[self._value] * self._factor + self._offset
        valid = isfinite(value) and (self._status < 0 or raw[self._status] == 0)
        return Measured(value if isfinite(value) else 0.0, self._count(raw), valid=valid)

    def _count(self, raw: tuple[Any, ...]) -> int:
        """Samples so far, modulo 256, whatever the length of the counter."""
        if self._counter < 0:
            return -1
        counted = int(raw[self._counter])
        self._sequence = (self._sequence + (counted - self._counted) % self._wrap) % 256
        self._counted = counted
        return self._sequence

    def service(self) -> Frame | None:
        """It needs nothing."""
        return None
