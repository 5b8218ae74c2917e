"""[sensors.NAME]: a node that measures something, and what its readings are held to."""

import math
from typing import Annotated, Any, Final

from pydantic import Field, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import Kind, known, unknown

KINDS: dict[str, str] = {
    "hil": "drivers.sensors.hil_frame:HilSensorFrame",
    "dbc": "drivers.sensors.dbc_frame:DbcSensorFrame",
    "cia404": "drivers.sensors.cia404:Cia404Sensor",
}
SENSOR_KIND = Kind("sensor frame", "sensor frames", "sensors", "kind", "hil.sensors", KINDS, ("decode",))


def sensor_kind(name: str) -> Kind:
    """SENSOR_KIND of one sensor: messages name its own table."""
    return SENSOR_KIND._replace(table=f"sensors.{name}")


MAX_SENSORS: Final = 8
_COUNTS: Final = 2.0**31  # a value on the bus is an int32
_FALSE_ALARM: Final = 1e-12  # most probable that a sensor that works looks stuck in a tick: once in 30 years at 1 kHz

Identifier = Annotated[int, Field(ge=1, le=0x7FF)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Ticks = Annotated[int, Field(ge=1, le=10_000)]


def _is_zero(value: float) -> bool:
    return not value


def _is_empty(value: Any) -> bool:
    return not value


class SensorConfig(Table):
    """[sensors.NAME]: a node on the bus that samples with the drives and sends one reading a tick.

    Its frame is read beside the frame layout of the drives, on the first segment of the bus.
    """

    kind: str = key(
        "hil",
        "how it sends its readings. hil: the frame of docs/sensors.md; dbc: a signal of a DBC file; cia404: a "
        "measuring device (CiA 404) beside CiA 402 drives; or a class of your own (hil.SensorFrame): its registered "
        "name, package.module:Class, or ./file.py:Class beside the rig file",
    )
    can_id: Identifier = key(REQUIRED, "identifier of its frame; no other node may use it", "1")
    fd: bool = key(False, "it sends CAN FD frames; kind = hil: of 12 bytes with a CRC-32, else classic ones of 8 bytes")
    file: str = key(
        "", "kind = dbc: DBC file beside the rig file; cia404: the device's EDS or DCF file", exclude_if=_is_empty
    )
    signal: str = key("", "kind = dbc: signal of the reading, in the message of can_id", exclude_if=_is_empty)
    counter: str = key(
        "", "kind = dbc: signal that counts the samples; without it frames are counted", exclude_if=_is_empty
    )
    status: str = key("", "kind = dbc: signal that is 0 where the reading is valid", exclude_if=_is_empty)
    node: int = key(0, "kind = cia404: CANopen node of the device", "1", exclude_if=_is_zero, ge=0, le=126)
    channel: int = key(1, "kind = cia404: sub-index of its analogue input", "1", ge=1, le=199,
                       exclude_if=lambda channel: channel == 1)  # fmt: skip
    parameters: dict[str, Any] = key({}, "of a class of your own: what it takes", exclude_if=_is_empty)
    source: str = key(
        "", "of such a class: its file's text, or its package's digest; filled in when the rig is loaded",
        exclude_if=_is_empty,
    )  # fmt: skip
    unit: Annotated[str, Field(pattern=r"^[ -~]{1,12}$")] = key(REQUIRED, 'SI unit of its readings, as "N"')
    scale: float = key(
        REQUIRED,
        "reading per count on the bus, in that unit; of other kinds than hil: per unit of the signal or process value",
        "unit",
        gt=0,
        le=1e6,
    )
    noise: float = key(REQUIRED, "RMS noise of a reading, in that unit; 0: not known", "unit", ge=0, le=1e6)
    range: Range = key(REQUIRED, "least and greatest reading that can be true, in that unit", "unit")
    tool_mass: float = key(
        0.0, "mass between it and the tip, which it feels when that is accelerated; 0: it is on the cell's side", "kg",
        exclude_if=_is_zero, ge=0, le=1,
    )  # fmt: skip
    decay: float = key(
        0.0, "time constant with which a constant reading fades, as a piezo's does; 0: never", "s",
        exclude_if=_is_zero, ge=0, le=1e4,
    )  # fmt: skip
    silent_ticks: Ticks = key(3, "ticks without a valid reading that are a fault", "ticks")
    stuck_ticks: int = key(
        8, "readings in a row of exactly one value that are a fault; 0: none are", "ticks", ge=0, le=10_000
    )

    @model_validator(mode="after")
    def _consistent(self) -> "SensorConfig":
        low, high = self.range
        if not low < high:
            raise ValueError(f"range = {self.range}: the first must be below the second")
        if not self.source and not known(SENSOR_KIND, self.kind):  # with it: of a package not here
            raise ValueError(unknown(SENSOR_KIND, self.kind))
        if self.stuck_ticks and not self.noise:
            raise ValueError(
                f"noise = 0, stuck_ticks = {self.stuck_ticks}: only the noise tells a sensor that is stuck from one "
                "that measures nothing new; state the noise, or stuck_ticks = 0"
            )
        if self.kind == "hil" and (problem := self.unfit(self.scale, -_COUNTS * self.scale, _COUNTS * self.scale)):
            raise ValueError(problem)
        self._every_key_acts()
        return self

    def _every_key_acts(self) -> None:
        """Raise ValueError for a key of another kind, or one that this kind lacks."""
        own = not SENSOR_KIND.own(self.kind)
        for name, kinds, needed in _OF_KINDS:
            given = bool(getattr(self, name)) and getattr(self, name) != type(self).model_fields[name].default
            if given and self.kind not in kinds and not own:
                raise ValueError(f"{name}: a key of kind = {' or '.join(map(repr, kinds))}, not of {self.kind!r}")
            if needed and not given and self.kind in kinds:
                raise ValueError(f"{name}: kind = {self.kind!r} needs it")
        if self.parameters and not own:
            raise ValueError(f"parameters: of a class of your own; kind = {self.kind!r} takes none")

    def unfit(self, resolution: float, low: float, high: float) -> str:
        """Why frames of this resolution, which carry low to high, both in the sensor's unit, are none for it; empty:
        they are.
        """
        if self.range[0] < low or self.range[1] >= high:
            return f"range = {self.range}: with scale = {self.scale:g} a frame carries {low:g} to {high:g}"
        least = least_stuck_ticks(resolution, self.noise) if self.stuck_ticks else 0
        if self.stuck_ticks < least:
            return (
                f"stuck_ticks = {self.stuck_ticks}: with noise = {self.noise:g} and scale = {self.scale:g} a sensor "
                f"that works repeats its value so often; allowed: 0, or {least} and more"
            )
        return ""


def least_stuck_ticks(resolution: float, noise: float) -> int:
    """The least `stuck_ticks` that a sensor with this noise, above 0, hardly ever reaches while it works."""
    again = resolution / (2.0 * math.sqrt(math.pi) * noise)  # probability that a value is the one before
    return math.ceil(math.log(_FALSE_ALARM) / math.log(min(again, 0.999))) + 1


_OF_KINDS: Final = (  # key, kinds that have it, whether they need it
    ("file", ("dbc", "cia404"), True),
    ("signal", ("dbc",), True),
    ("counter", ("dbc",), False),
    ("status", ("dbc",), False),
    ("node", ("cia404",), True),
    ("channel", ("cia404",), False),
)
