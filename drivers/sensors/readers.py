"""Who reads the frames of a rig's sensors, by their kind."""

from collections.abc import Mapping
from pathlib import Path

from drivers.sensors.base import SensorReader
from drivers.sensors.config import SensorConfig
from drivers.sensors.hil_frame import HilSensorFrame


def sensor_readers(sensors: Mapping[str, SensorConfig], base_dir: Path, *, counted: bool = False) -> list[SensorReader]:
    """One for each sensor, in their order. base_dir: the rig file's folder. counted: SYNC carries a counter. Raises
    LayoutError naming the key.
    """
    return [_reader(name, config, base_dir, counted) for name, config in sensors.items()]


def _reader(name: str, config: SensorConfig, base_dir: Path, counted: bool) -> SensorReader:
    if config.kind == "hil":
        return HilSensorFrame(config.can_id, fd=config.fd, scale=config.scale)
    if config.kind == "dbc":
        from drivers.sensors.dbc_frame import DbcSensorFrame  # few rigs have one

        return DbcSensorFrame(name, config, base_dir)
    if config.kind == "cia404":
        from drivers.sensors.cia404 import Cia404Sensor

        return Cia404Sensor(name, config, base_dir, counted=counted)
    from drivers.sensors.user_frame import UserSensorFrame

    return UserSensorFrame(name, config)
