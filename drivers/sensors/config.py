"""[sensors.NAME]: a node that measures something, and what its readings are held to."""

import math
from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from drivers.base.keys import REQUIRED, Table, key

MAX_SENSORS: Final = 8
_COUNTS: Final = 2.0**31  # a value on the bus is an int32
_FALSE_ALARM: Final = 1e-12  # most probable that a sensor that works looks stuck in a tick: once in 30 years at 1 kHz

Identifier = Annotated[int, Field(ge=1, le=0x7FF)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Ticks = Annotated[int, Field(ge=1, le=10_000)]


def _is_zero(value: float) -> bool:
    return not value


class SensorConfig(Table):
    """[sensors.NAME]: a node on the bus that samples with the drives and sends one reading a tick.

    Its frame is read beside the frame layout of the drives, on the first segment of the bus.
    """

    kind: Literal["hil"] = key("hil", "how it sends its readings; hil: the frame of drivers/sensors/hil_frame.py")
    can_id: Identifier = key(REQUIRED, "identifier of its frame; no other node may use it", "1")
    fd: bool = key(False, "a CAN FD frame of 12 bytes with a CRC-32, instead of a classic one of 8 bytes")
    unit: Annotated[str, Field(pattern=r"^[ -~]{1,12}$")] = key(REQUIRED, 'SI unit of its readings, as "N"')
    scale: float = key(REQUIRED, "reading per count on the bus, in that unit", "unit", gt=0, le=1e6)
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
        most = self.scale * _COUNTS
        if low < -most or high >= most:
            raise ValueError(f"range = {self.range}: with scale = {self.scale:g} a frame carries -{most:g} to {most:g}")
        if self.stuck_ticks and not self.noise:
            raise ValueError(
                f"noise = 0, stuck_ticks = {self.stuck_ticks}: only the noise tells a sensor that is stuck from one "
                "that measures nothing new; state the noise, or stuck_ticks = 0"
            )
        if self.stuck_ticks and self.stuck_ticks < self.least_stuck_ticks:
            raise ValueError(
                f"stuck_ticks = {self.stuck_ticks}: with noise = {self.noise:g} and scale = {self.scale:g} a sensor "
                f"that works repeats its value so often; allowed: 0, or {self.least_stuck_ticks} and more"
            )
        return self

    @property
    def least_stuck_ticks(self) -> int:
        """The least `stuck_ticks` that a sensor with this noise, other than 0, hardly ever reaches while it works."""
        again = self.scale / (2.0 * math.sqrt(math.pi) * self.noise)  # probability that a value is the one before
        return math.ceil(math.log(_FALSE_ALARM) / math.log(min(again, 0.999))) + 1
