"""How an emulated sensor of each kind says what it has measured.

Written from the documents (docs/sensors.md, the DBC file by cantools, the EDS by the emulated CANopen node), apart from
the host's side in drivers/sensors: what one gets wrong shows against the other.
"""

import zlib
from dataclasses import dataclass
from typing import Protocol

from drivers.frame import BRS, FD, Frame
from drivers.sensors.config import SensorConfig

FINE = 2.0**-24  # of a sensor's range: a count, where a floating-point number carries the reading


@dataclass(frozen=True)
class Sampled:
    """What the sensor is about to send: counts, microseconds of its clock, sequence, status (0: valid)."""

    counts: int
    stamp_us: int
    sequence: int
    status: int = 0


class Carrier(Protocol):
    """What a sample goes out in. resolution: of a count, in the sensor's unit. least, most: counts that it carries."""

    resolution: float
    least: int
    most: int

    def frame(self, shown: Sampled) -> Frame:
        """That sample's."""


class OwnFrame:
    """kind = "hil"."""

    least, most = -(2**31), 2**31 - 1

    def __init__(self, config: SensorConfig) -> None:
        self.resolution = config.scale
        self._can_id, self._fd = config.can_id, config.fd

    def frame(self, shown: Sampled) -> Frame:
        """See Carrier."""
        data = (shown.counts % 2**32).to_bytes(4, "little") + (shown.stamp_us % 2**16).to_bytes(2, "little")
        data += bytes((shown.sequence % 256, shown.status))
        if not self._fd:
            return Frame(self._can_id, data)
        return Frame(self._can_id, data + zlib.crc32(data, self._can_id).to_bytes(4, "little"), FD | BRS)
