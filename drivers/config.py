"""The part of a rig file that describes the bus and what is on it: [bus], [wire] and [drives].

What a family of drives has in [bus] stands with the family (drivers/families).
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field, create_model, field_validator, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import Kind, known, unknown
from drivers.families import families, family_of, layouts
from drivers.frame import MAX_SEGMENTS

CHANNEL_NAME = r"^[A-Za-z0-9_-][A-Za-z0-9_.-]{0,14}$"  # as Linux names interfaces; a local bus is a directory, too
CHANNEL_RULE = "1 to 15 letters, digits, '_', '.' or '-', not '.' first"
# Our own frame layouts, by the class of their host's side. A user's is a class like
# drivers.protocols.frame_layout.FrameLayout.
LAYOUTS: dict[str, str] = {name: sides.host for name, sides in layouts().items()}
LAYOUT_KIND = Kind("frame layout", "frame layouts", "bus", "protocol", "hil.layouts", LAYOUTS, ("host", "drives"))

KERNEL_INTERFACES = ("auto", "socketcan", "local")  # what control loop and emulated drives run on


Option = bool | int | float | str


class SegmentConfig(Table):
    """[[bus.segments]]: one of several CAN interfaces, each with some of the axes on it."""

    channel: Annotated[str, Field(pattern=CHANNEL_NAME)] = key(REQUIRED, f"name of the CAN interface: {CHANNEL_RULE}")
    axes: Annotated[list[str], Field(min_length=1)] = key(
        REQUIRED, "names of the axes whose drives are on it, in the order of [axes]"
    )


class Bus(Table):
    """[bus]: which CAN interface, at what bit rates, with which frame layout."""

    interface: Annotated[str, Field(pattern=r"^[a-z0-9_-]{2,30}$")] = key(
        "auto",
        "socketcan: a CAN interface of the kernel; local: the emulated bus of this machine; auto: what there is; any "
        "other of python-can's (pcan, kvaser, slcan, ...): for `hil bus`, `hil drives` and `hil bench bus` alone",
    )
    channel: Annotated[str, Field(pattern=r"^[!-~]{1,100}$")] = key(
        "can0", f"name of the CAN interface: {CHANNEL_RULE}; or what the adapter calls it"
    )
    segments: Annotated[list[SegmentConfig], Field(max_length=MAX_SEGMENTS)] = key(
        [],
        "where the drives are on more than one interface: every axis on one of them, in the order of [axes]; all with "
        "the same bit rates and frame layout",
    )
    options: dict[str, Option] = key(
        {}, "what an interface of python-can takes besides channel and bit rate, as ttyBaudrate for slcan"
    )
    protocol: str = key(
        next(iter(LAYOUTS)),
        f"frame layout: {', '.join(LAYOUTS)} with FILE beside the rig file; or one of your own: its registered name, "
        "package.module:Class, or ./file.py:Class beside the rig file",
    )
    parameters: dict[str, Any] = key({}, "of a frame layout of your own: what its class takes")
    source: str = key("", "of such a layout: its file's text, or its package's digest; filled in when loaded")
    bitrate: int = key(1_000_000, "nominal bit rate", "bit/s", ge=10_000, le=1_000_000)
    data_bitrate: int = key(5_000_000, "bit rate of the data phase of CAN FD", "bit/s", ge=10_000, le=8_000_000)
    transmit_queue: int = key(16, "frames that may wait to be sent", "frames", ge=1, le=1000)
    receive_limit: int = key(32, "frames handed to one tick; more is a flood", "frames", ge=4, le=32)

    @field_validator("protocol")
    @classmethod
    def _known_layout(cls, name: str) -> str:
        if not known(LAYOUT_KIND, name):
            raise ValueError(unknown(LAYOUT_KIND, name))
        return name

    @model_validator(mode="before")
    @classmethod
    def _channel_of_segments(cls, table: Any) -> Any:
        """`channel`, where the segments alone say it."""
        segments = table.get("segments") if isinstance(table, dict) and "channel" not in table else None
        first = segments[0] if isinstance(segments, list) and segments else None
        return {**table, "channel": first["channel"]} if isinstance(first, dict) and "channel" in first else table

    @model_validator(mode="after")
    def _every_key_acts(self) -> "Bus":
        if self.parameters and LAYOUT_KIND.own(self.protocol):
            raise ValueError(f"parameters: of a frame layout of your own; protocol = {self.protocol!r} takes none")
        for family in families().values():
            tables = [name for name, field in family.keys.model_fields.items() if field.default is None]
            for table in tables:
                if getattr(self, table) is not None and family is not family_of(self.protocol):
                    layout = next(iter(family.layouts))
                    raise ValueError(f"{table}: a table of protocol = {layout!r}, not of {self.protocol!r}")
        if self.interface in KERNEL_INTERFACES:
            if not re.fullmatch(CHANNEL_NAME, self.channel):
                raise ValueError(f"channel {self.channel!r}: {CHANNEL_RULE}")
            if self.options:
                raise ValueError(f"options: none are taken with interface = {self.interface!r}")
        if self.segments:
            self._check_segments()
        return self

    def _check_segments(self) -> None:
        channels = self.channels
        if self.channel != channels[0]:
            raise ValueError(f"channel = {self.channel!r}: beside `segments` it is the first one's, {channels[0]!r}")
        if self.interface not in KERNEL_INTERFACES:
            raise ValueError(f"segments: with interface = {', '.join(KERNEL_INTERFACES)} alone, not {self.interface!r}")
        if len(channels) == 1:
            raise ValueError(f"segments: one alone; say channel = {channels[0]!r}")
        if len(set(channels)) != len(channels):
            raise ValueError(f"segments: a channel twice in {', '.join(channels)}")

    @property
    def channels(self) -> list[str]:
        """The CAN interfaces by name: one, or one a segment."""
        return [segment.channel for segment in self.segments] or [self.channel]

    @property
    def file(self) -> str:
        """The file that the layout's name takes; empty for other layouts, and for those of users."""
        return self.protocol.partition(":")[2] if family_of(self.protocol) else ""


if TYPE_CHECKING:  # its other keys are for their families alone, which say what they are
    BusConfig = Bus
else:
    BusConfig = create_model(
        "BusConfig",
        __base__=(*(family.keys for family in reversed(families().values())), Bus),
        __doc__=Bus.__doc__,
        __module__=__name__,
    )


class Wiring(NamedTuple):
    """What a frame layout is made for.

    bus: [bus] of the rig file. n_axes: number of axes. rated_force: N or N m per drive, its full scale. period_ns: of
    the control loop. base_dir: folder of the rig file, for the files that our own layouts name; a layout of users reads
    none.
    """

    bus: BusConfig
    n_axes: int
    rated_force: Sequence[float]
    period_ns: int = 1_000_000
    base_dir: Path = Path()


class WireConfig(Table):
    """[wire]: the simulated CAN segment of runs in virtual time (drivers/wire/wire.py)."""

    drop_probability: float = key(0.0, "probability that a frame is lost", "1", ge=0, lt=1)
    jitter: float = key(0.0, "variation of the host's sending instant, uniform in +- jitter", "s", ge=0, le=0.01)
    # worst: timing then does not depend on payloads (hil sweep)
    stuffing: Literal["exact", "worst"] = key(
        "exact", "frame lengths: exact bit stuffing, or as long as any frame of its size can be"
    )
    seed: int = key(1, "seed of the losses and of the jitter", "1", ge=0, lt=2**32)


class DrivesConfig(Table):
    """[drives]: what the drives on the bus do by themselves. Safety rules go by it; the emulated drives do the same.

    Lists are in the order of [axes].
    """

    watchdog_s: float = key(
        0.01, "without a valid command for this long a drive goes to zero torque and latches a fault", "s", gt=0, le=1
    )
    brake: bool | list[bool] = key(
        False, "at zero torque the axis is held by a brake that its drive engages; false: it is free to move"
    )
    # The host holds the weight against the closed brake meanwhile, and moves nothing.
    brake_opening_s: float = key(
        0.0, "longest that a brake takes to open once its drive applies torque", "s", ge=0, le=2,
        exclude_if=lambda seconds: seconds == 0.0,
    )  # fmt: skip
