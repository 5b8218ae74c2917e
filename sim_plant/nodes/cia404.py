"""An emulated measuring device (CiA 404): a CANopen node by its EDS, whose process value is what it measures."""

from collections.abc import Callable
from pathlib import Path

from drivers.families.cia402 import cia301
from drivers.frame import Frame
from drivers.sensors.config import SensorConfig
from sim_plant.config import EmulatedSensorConfig
from sim_plant.drives.canopen_node import CanopenNode
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.quirks import NO_QUIRKS
from sim_plant.nodes.sensor import NEVER_NS, SensorNode, Stage
from sim_plant.nodes.sensor_frames import FINE, Sampled

_VALUES = (0x5130, 0x6130, 0x7130, 0x8130, 0x9130)  # CiA 404: INTEGER8, REAL32, INTEGER16, INTEGER24, INTEGER32
_STATUS = 0x6150


class _Device(CanopenNode):
    """measure: called at every SYNC, before its TPDO goes out."""

    def __init__(self, node: int, eds: Path) -> None:
        self.measure: Callable[[], None] = lambda: None
        super().__init__(node, 0, eds, NO_QUIRKS)
        self._boot()

    def _apply(self) -> None:
        self.measure()


class Cia404Node(SensorNode):
    """One device. It is started by its host, and samples at SYNC; what is asked by SDO it answers at once."""

    def __init__(
        self, name: str, config: SensorConfig, place: int, entry: EmulatedSensorConfig | None, seed: int, base_dir: Path
    ) -> None:
        self.device = _Device(config.node, base_dir / config.file)
        self.device.measure = self._measure
        entries = self.device.dictionary.entries
        self._value = next(at for index in _VALUES if (at := key_of(index, config.channel)) in entries)
        self._status = key_of(_STATUS, config.channel) if key_of(_STATUS, config.channel) in entries else -1
        self._real = self._value >> 8 == 0x6130
        low, high = config.range
        bits = 8 * entries[self._value].type.size
        self.resolution = (high - low) * FINE if self._real else config.scale
        self.least, self.most = (-(2**53), 2**53) if self._real else (-(1 << bits - 1), (1 << bits - 1) - 1)
        super().__init__(name, config, place, entry, self, (0x7FF, cia301.SYNC_ID), seed)
        self.can_ids = (config.can_id, cia301.SDO_RESPONSE_ID + config.node, cia301.HEARTBEAT_ID + config.node)
        self._stage: Stage | None = None
        self._spoken: list[Frame] = []
        self._mute = False  # in this SYNC

    def frame(self, shown: Sampled) -> Frame:
        """None is made here: the device sends its TPDO."""
        raise NotImplementedError

    @property
    def next_ns(self) -> int:
        """It answers at once, or when it is told."""
        return 0 if self._spoken else NEVER_NS

    def hears(self, frame: Frame) -> bool:
        """It is on the bus as every node is."""
        return True

    def hear(self, frame: Frame, stage: Stage) -> None:
        """See SensorNode."""
        self._stage = stage
        self._mute = False
        spoken = self.device.on_frame(frame._replace(timestamp_ns=stage.now_ns))
        self._spoken += [found for found in spoken if not self._mute or found.can_id != self.can_id]

    def due(self, now_ns: int) -> list[Frame]:
        """See SensorNode."""
        found, self._spoken = self._spoken, []
        return found

    def _measure(self) -> None:
        assert self._stage is not None
        shown = self._sampled(self._stage)
        if shown is None:
            self._mute = True
            return
        values = self.device.dictionary.values
        values[self._value] = shown.counts * self.resolution / self.config.scale if self._real else shown.counts
        if self._status >= 0:
            values[self._status] = shown.status
