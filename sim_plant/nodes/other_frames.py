"""How an emulated sensor says what it has measured, where that is no frame of ours: by cantools, or a user's class."""

import math
from pathlib import Path

import cantools
from cantools.database.can import Database

from drivers.frame import BRS, FD, Frame
from drivers.sensors.config import SensorConfig
from drivers.sensors.user_frame import UserSensorFrame
from sim_plant.nodes.sensor_frames import FINE, Sampled


class SignalFrame:
    """kind = "dbc": the message as cantools makes it."""

    def __init__(self, config: SensorConfig, base_dir: Path) -> None:
        database = cantools.database.load_file(base_dir / config.file, database_format="dbc", encoding="cp1252")
        assert isinstance(database, Database)
        self._message = database.get_message_by_frame_id(config.can_id)
        self._config = config
        signal = self._message.get_signal_by_name(config.signal)
        self._real = bool(signal.is_float)
        self._factor, self._offset = float(signal.scale), float(signal.offset)
        self.resolution = abs(self._factor) * config.scale
        low, high = config.range
        if self._real:
            self.resolution = (high - low) * FINE
            ends = [-math.inf, math.inf]
        else:
            least = -(1 << signal.length - 1) if signal.is_signed else 0
            ends = [self._counts(least), self._counts(least + (1 << signal.length) - 1)]
        self.least, self.most = (int(max(-(2**62), min(2**62, end))) for end in (min(ends), max(ends)))

    def _counts(self, raw: int) -> float:
        return (raw * self._factor + self._offset) * self._config.scale / self.resolution

    def frame(self, shown: Sampled) -> Frame:
        """See Carrier."""
        config, message = self._config, self._message
        values = dict.fromkeys((str(signal.name) for signal in message.signals), 0.0)
        values = {name: message.get_signal_by_name(name).offset or 0 for name in values}
        physical = shown.counts * self.resolution / config.scale
        if not self._real:  # as a sensor that counts says it
            physical = round((physical - self._offset) / self._factor) * self._factor + self._offset
        values[config.signal] = physical
        if config.counter:
            values[config.counter] = shown.sequence % (1 << message.get_signal_by_name(config.counter).length)
        if config.status:
            values[config.status] = shown.status
        flags = FD | BRS if config.fd else 0
        return Frame(config.can_id, message.encode(values, strict=False), flags)


class UserFrame:
    """A class of the user's, by its `encode`."""

    least, most = -(2**53), 2**53

    def __init__(self, name: str, config: SensorConfig) -> None:
        self._side, self._can_id, self._fd = UserSensorFrame(name, config), config.can_id, config.fd
        self.resolution = (config.range[1] - config.range[0]) * FINE

    def frame(self, shown: Sampled) -> Frame:
        """See Carrier. A sensor that says its value is none has nothing to send in."""
        data = self._side.encode(shown.counts * self.resolution, shown.sequence % 256, shown.stamp_us * 1000)
        return Frame(self._can_id, data, FD | BRS if self._fd else 0)
