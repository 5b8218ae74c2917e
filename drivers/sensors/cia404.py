"""`kind = "cia404"`: a measuring device (CiA 404) beside CiA 402 drives, as its EDS describes it.

Its TPDO 1 carries the process value of an analogue input: object 130h of 5000h (INTEGER8), 6000h (REAL32), 7000h
(INTEGER16), 8000h (INTEGER24) or 9000h (INTEGER32), and its status (6150h) where the mapping has it. The host sets
transmission type 1, so that the device samples at every SYNC, as the drives do; reads it back; and starts the node.
What it says before that is not valid. The mapping is the device's own: a DCF says another.
"""

import struct
from pathlib import Path

from drivers.base.text_file import words_of
from drivers.eds.data_types import Kind
from drivers.eds.reader import Eds, EdsError, Entry, object_name, read_eds
from drivers.families.cia402 import cia301
from drivers.families.cia402.node import NodeMaster, Phase
from drivers.families.cia402.sdo import Step
from drivers.frame import FD, Frame
from drivers.protocols.base import LayoutError, Reject
from drivers.sensors.base import Measured
from drivers.sensors.config import SensorConfig

SYNC_COUNTER = 0x1019
PARAMETERS, MAPPING = 0x1800, 0x1A00  # of TPDO 1
PROCESS_VALUES, STATUS = (0x5130, 0x6130, 0x7130, 0x8130, 0x9130), 0x6150  # of an analogue input
_MOST_MAPPED = 64
_BOOT_TICKS = 12  # the drives' master resets communication on the whole bus at its start
_FLOAT_STEPS = 2.0**24


class Field:
    """Bits of the TPDO. first: of the least significant. entry: the object, as the EDS has it."""

    def __init__(self, first: int, bits: int, entry: Entry) -> None:
        self._first, self._mask = first, (1 << bits) - 1
        self.real = entry.type.kind is Kind.REAL
        self._sign = 1 << bits - 1 if entry.type.signed and not self.real else 0
        self.low, self.steps = -float(self._sign), float(1 << bits)

    def of(self, word: int) -> float:
        """Its value in the payload, read as one little-endian number."""
        raw = word >> self._first & self._mask
        if self.real:
            found: float = struct.unpack("<f", raw.to_bytes(4, "little"))[0]
            return found
        return float((raw ^ self._sign) - self._sign)


class Tpdo:
    """TPDO 1 of a device: its identifier, bytes, value and status. Raises LayoutError naming the object."""

    def __init__(self, eds: Eds, channel: int) -> None:
        cob = eds.value(PARAMETERS, 1)
        self.can_id = -1 if cob is None else cob & cia301.STANDARD_IDS
        self.valid = cob is not None and not cob & cia301.PDO_INVALID
        value = status = None
        first = 0
        for place in range(1, min(eds.value(MAPPING) or 0, _MOST_MAPPED) + 1):
            mapped = eds.value(MAPPING, place) or 0
            index, subindex, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
            entry = eds.entry(index, subindex)
            if entry is not None and subindex == channel and index in PROCESS_VALUES:
                if entry.type.kind is Kind.REAL and bits != 32:
                    raise LayoutError(f"{object_name(index, subindex)}: a floating-point number of {bits} bits")
                value = Field(first, bits, entry)
            elif entry is not None and (index, subindex) == (STATUS, channel):
                status = Field(first, bits, entry)
            first += bits
        if value is None:
            raise LayoutError(
                f"TPDO 1 ({MAPPING:04X}h) carries no process value of channel {channel} (6130h, 7130h, 9130h:"
                f"{channel:02X}); give a DCF whose mapping does"
            )
        self.value, self.status, self.length = value, status, (first + 7) // 8
        if not 0 < self.length <= 8:
            raise LayoutError(f"TPDO 1 ({MAPPING:04X}h) has {first} bits")


class Cia404Sensor:
    """One device. name: of the sensor. counted: SYNC carries a counter. Raises LayoutError naming the key."""

    def __init__(self, name: str, config: SensorConfig, base_dir: Path, *, counted: bool) -> None:
        where = f"sensors.{name}"
        try:
            eds = read_eds(base_dir / config.file, config.node)
            self._tpdo = tpdo = Tpdo(eds, config.channel)
        except (EdsError, LayoutError) as error:
            raise LayoutError(f"{where}.file: {error}") from None
        except OSError as error:
            raise LayoutError(f"{where}.file: {base_dir / config.file}: {words_of(error)}") from None
        if config.fd:
            raise LayoutError(f"{where}.fd = true: CANopen devices send classic frames; expected false")
        if tpdo.can_id != config.can_id:
            raise LayoutError(
                f"{where}.can_id = {config.can_id:#x}: its file has {tpdo.can_id:#x} for TPDO 1 of node {config.node}"
            )
        if counted and eds.entry(SYNC_COUNTER) is None:
            raise LayoutError(
                f"{where}.file: no object 1019h, and SYNC carries a counter; set bus.cia402.sync_counter = 'off'"
            )
        field, scale, (low, high) = tpdo.value, config.scale, config.range
        if field.real:
            problem = config.unfit((high - low) / _FLOAT_STEPS, low, 2.0 * abs(high) + 1.0)
        else:
            problem = config.unfit(scale, field.low * scale, (field.low + field.steps) * scale)
        if problem:
            raise LayoutError(f"{where}: {problem}")
        self._answers, self._beats = cia301.SDO_RESPONSE_ID + config.node, cia301.HEARTBEAT_ID + config.node
        self.can_ids = (config.can_id, self._answers, self._beats)
        self._scale, self._name = scale, name
        self._ticks = 0
        self.node = NodeMaster(config.node, _steps(tpdo, eds, counted=counted))

    @property
    def problem(self) -> str:
        """See SensorReader."""
        return f"sensors.{self._name}: {self.node.problem}" if self.node.problem else ""

    def decode(self, frame: Frame) -> Measured | Reject:
        """See SensorReader."""
        if frame.flags & FD:
            return Reject.WRONG_FORMAT
        data, tpdo = frame.data, self._tpdo
        if frame.can_id != tpdo.can_id:
            return self._decode_service(frame.can_id, data)
        if len(data) != tpdo.length:
            return Reject.WRONG_LENGTH
        self.node.on_pdo()
        word = int.from_bytes(data, "little")
        value = tpdo.value.of(word) * self._scale
        finite = value - value == 0.0
        good = finite and (tpdo.status is None or tpdo.status.of(word) == 0)
        return Measured(value if finite else 0.0, valid=good and self.node.phase is Phase.RUNNING)

    def _decode_service(self, can_id: int, data: bytes) -> Reject:
        if len(data) != (8 if can_id == self._answers else 1):
            return Reject.WRONG_LENGTH
        if can_id == self._answers:
            self.node.on_sdo(data)
        else:
            self.node.on_heartbeat(data[0] & 0x7F)
        return Reject.SERVICE

    def service(self) -> Frame | None:
        """See SensorReader: what configures it, and starts it."""
        self._ticks += 1
        return self.node.service(self._ticks) if self._ticks >= _BOOT_TICKS else None


def _steps(tpdo: Tpdo, eds: Eds, *, counted: bool) -> list[Step]:
    """Sampled at every SYNC, and in use."""
    counter = cia301.SYNC_COUNTER_MAX if counted else 0
    found = [] if eds.entry(SYNC_COUNTER) is None else [Step(SYNC_COUNTER, 0, counter, size=1)]
    found += [
        Step(PARAMETERS, 2, 1, size=1),
        Step(PARAMETERS, 2, 1, mask=0xFF, width=1, proof=True),
    ]
    if not tpdo.valid:
        found.append(Step(PARAMETERS, 1, tpdo.can_id, size=4))
    return found
