"""The part of a rig file that describes the bus and what is on it: [bus], [wire] and [drives].

Every key of the rig file is declared with `key`: default, meaning and unit in one place. docs/rig-file.md, the JSON
schema for editors and `hil explain` are made from these declarations.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from drivers.frame import MAX_SEGMENTS
from drivers.plugins import Kind, known, unknown

CHANNEL_NAME = r"^[A-Za-z0-9_-][A-Za-z0-9_.-]{0,14}$"  # as Linux names interfaces; a local bus is a directory, too
CHANNEL_RULE = "1 to 15 letters, digits, '_', '.' or '-', not '.' first"
STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
REQUIRED = ...


def key(default: Any, description: str, unit: str = "", *, derived: str = "", **bounds: Any) -> Any:
    """A key of the rig file, as a pydantic field.

    default: its value where the file says nothing, REQUIRED where the file has to say it. unit: SI, "1" for a number
    without one. derived: where the value comes from if not from the file, in words. bounds: pydantic's ge, gt, le, lt.
    """
    extra: dict[str, Any] = {name: text for name, text in (("unit", unit), ("derived", derived)) if text}
    return Field(default, description=description, json_schema_extra=extra, **bounds)


class SignalBinding(BaseModel):
    """One value in a DBC file, by message and signal name."""

    model_config = STRICT
    message: str = key(REQUIRED, "name of the message in the DBC file")
    signal: str = key(REQUIRED, "name of the signal in that message")
    scale: float = key(1.0, "encoder counts (position) or N (torque) per physical unit of the DBC file", "1", gt=0)


class PositionBinding(SignalBinding):
    """An encoder position, which may tell a part of a turn alone."""

    wrap: float = key(
        0.0,
        "counts of one turn, after which it begins anew; turns are then counted here; 0: it does not",
        "1",
        ge=0,
    )


class SwitchBinding(SignalBinding):
    """A signal that switches something; by default one bit (or a bit per axis)."""

    on: int = key(1, "raw value that means yes: 8 for an axis state of closed loop", "1", ge=0, lt=2**64)
    off: int = key(0, "raw value that means no", "1", ge=0, lt=2**64)


class StatusBinding(SignalBinding):
    """A signal that tells the state of a drive; without lists of values its bits are drivers.protocols' DriveStatus."""

    enabled: list[int] = key([], "raw values with which the drive applies its torque", "1")
    fault: list[int] = key([], "raw values with which it is in fault", "1")


class ConstantBinding(SignalBinding):
    """A signal of a command message that always has the same raw value."""

    value: int = key(REQUIRED, "raw value", "1", ge=-(2**63), lt=2**64)


class FrameBinding(BaseModel):
    """A frame that says something by itself: a message without signals, or with one value in it."""

    model_config = STRICT
    message: str = key(REQUIRED, "name of the message in the DBC file")
    signal: str = key("", "name of a signal in it; without: the message alone says it")
    value: int = key(0, "raw value of that signal", "1", ge=-(2**63), lt=2**64)


class PeriodBinding(BaseModel):
    """How often a message is sent."""

    model_config = STRICT
    message: str = key(REQUIRED, "name of the message in the DBC file, or MESSAGE.SIGNAL of a multiplexed one")
    period_s: float = key(
        REQUIRED, "period in which it is sent, and at once when a value in it changes", "s", gt=0, le=1
    )


Signals = list[SignalBinding]


class DbcBinding(BaseModel):
    """[bus.dbc]: how an arbitrary DBC file carries the rig. Lists are in the order of [axes]."""

    model_config = STRICT
    position: list[PositionBinding] = key(REQUIRED, "encoder position of each axis")
    status: list[StatusBinding] = key([], "state of each axis' drive; may be in another message than its position")
    error: Signals = key([], "error code of each axis' drive, beside its status: anything but 0 is a fault")
    torque: Signals = key(REQUIRED, "force (torque) demanded of each axis")
    enable: list[SwitchBinding] = key(
        [], "permits torque: one signal (one bit for all axes, or a bit per axis), or one per axis"
    )
    reset: list[SwitchBinding] = key(
        [], "clears a latched drive fault; one for all axes, or one per axis; `on` = `off`: the message alone does it"
    )
    constant: list[ConstantBinding] = key([], "signals of command messages that never change")
    feedback: Literal["triggered", "cyclic"] = key(
        "triggered", "triggered: drives sample when they receive the last command; cyclic: in their own time"
    )
    feedback_period_s: float = key(
        0.0, "cyclic: period in which a drive sends its position", "s", derived="the control period", ge=0, le=1
    )
    state_period_s: float = key(
        0.01,
        "period of the messages with `status` or `error` alone; what drives say of themselves is seen so much later",
        "s",
        ge=1e-3,
        le=0.25,
    )
    on_change: list[str] = key(
        [],
        "command messages that are sent when a value in them changes: at the start too, and before every enabling; one "
        "with nothing but `reset` when a reset is asked for. MESSAGE.SIGNAL: that page of a multiplexed message",
    )
    start: list[FrameBinding] = key(
        [], "frames that enable by themselves; one for all drives, or one per axis; again while a drive says otherwise"
    )
    stop: list[FrameBinding] = key([], "frames that disable by themselves, likewise; also at the start")
    periodic: list[PeriodBinding] = key([], "command messages and requests that are not sent every tick but so often")
    remote: list[str] = key([], "feedback messages that drives send when they are asked by a remote frame: every tick")
    feedback_counter: Signals = key([], "sequence number in the answers")
    command_counter: Signals = key([], "sequence number in the commands")
    checksum: Signals = key([], "checksums in the payload, besides CAN's own")
    checksum_algorithm: Literal["crc8-sae-j1850", "sum8", "xor8"] = key("crc8-sae-j1850", "how they are computed")


class ObjectValue(BaseModel):
    """A value to write into a drive's object dictionary; its size is what the drive's EDS says."""

    model_config = STRICT
    object: Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{4}h?(:[0-9A-Fa-f]{1,2})?$")] = key(
        REQUIRED, 'index and sub-index, hexadecimal: "6007h", "1029h:01"'
    )
    value: int = key(REQUIRED, "value to write", "1", ge=-(2**31), lt=2**32)

    @property
    def place(self) -> tuple[int, int]:
        """Index and sub-index."""
        index, _, subindex = self.object.partition(":")
        return int(index.rstrip("h"), 16), int(subindex or "0", 16)


NodeNumber = Annotated[int, Field(ge=1, le=126)]
RatedTorque = Annotated[float, Field(gt=0, lt=1e6)]


class Cia402Config(BaseModel):
    """[bus.cia402]: CiA 402 drives as their makers describe them. Lists are in the order of [axes], one entry per axis.

    Without this table the drives are the project's own (drivers/protocols/canopen/cia402.eds).
    """

    model_config = STRICT
    eds: list[str] = key(REQUIRED, "EDS or DCF files, beside the rig file: one per axis, or one for all", min_length=1)
    nodes: list[NodeNumber] = key([], "CANopen node of each axis", "1", derived="bus.node_id and the numbers after it")
    rpdo: Literal["auto", "shared", "own"] = key(
        "auto", "shared: one RPDO with the torques of all drives; own: one per drive; auto: shared where all drives can"
    )
    sync_counter: Literal["auto", "on", "off"] = key("auto", "counter in SYNC (1019h); auto: where all drives have it")
    rated_torque: list[RatedTorque] = key(
        [],
        "torque (force) that 6076h stands for; compared with the drive's",
        "N or N m",
        derived="read from each drive",
    )
    write_rated_torque: bool = key(False, "write 6076h, which on many drives is a property of the motor")
    start: Literal["nmt", "autostart"] = key("nmt", "autostart: the drives go to operational by themselves")
    stop_options: Literal["release", "keep"] = key(
        "release",
        "release: disabled, in fault, or without its host a drive lets go at once (1029h, 6007h, 605Bh, 605Ch, 605Eh "
        "are written where they exist and `write` states none); keep: as the drive has them",
    )
    write: list[ObjectValue] = key([], "further objects, written in this order before the drive is started")


MoteusNumber = Annotated[int, Field(ge=1, le=127)]


class MoteusConfig(BaseModel):
    """[bus.moteus]: moteus controllers. Lists are in the order of [axes].

    A count is 1/100 000 of a turn of the output shaft, a torque is N m there: axes.NAME.gear and encoder_resolution
    follow from the travel of a turn.
    """

    model_config = STRICT
    nodes: list[MoteusNumber] = key([], "number (id.id) of each axis' controller", "1", derived="1, 2, ...")
    position: Literal["int16", "int32", "float"] = key(
        "int32", "type in which positions are asked for: int16 tells 3.2 turns in steps of 1/10 000 turn"
    )
    torque: Literal["int16", "int32", "float"] = key(
        "float", "type in which torques are sent: int16 in steps of 0.01 N m, int32 of 0.001 N m"
    )
    watchdog_s: float = key(
        0.01,
        "watchdog timeout in every command, after which a drive goes to servo.timeout_mode; as drives.watchdog_s",
        "s",
        gt=0,
        le=1,
    )


# Our own frame layouts, and where the two sides of each are made. A user's is a class like
# drivers.protocols.frame_layout.FrameLayout.
LAYOUTS: dict[str, str] = {
    "stage_fd": "drivers.protocols:StageFd",
    "stage_classic": "drivers.protocols:StageClassic",
    "cia402": "drivers.protocols:Cia402",
    "moteus": "drivers.protocols:Moteus",
    "dbc:FILE": "drivers.protocols:Dbc",
}
LAYOUT_KIND = Kind("frame layout", "frame layouts", "bus", "protocol", "hil.layouts", LAYOUTS, ("host", "drives"))

KERNEL_INTERFACES = ("auto", "socketcan", "local")  # what control loop and emulated drives run on


Option = bool | int | float | str


class SegmentConfig(BaseModel):
    """[[bus.segments]]: one of several CAN interfaces, each with some of the axes on it."""

    model_config = STRICT
    channel: Annotated[str, Field(pattern=CHANNEL_NAME)] = key(REQUIRED, f"name of the CAN interface: {CHANNEL_RULE}")
    axes: Annotated[list[str], Field(min_length=1)] = key(
        REQUIRED, "names of the axes whose drives are on it, in the order of [axes]"
    )


class BusConfig(BaseModel):
    """[bus]: which CAN interface, at what bit rates, with which frame layout."""

    model_config = STRICT
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
        "stage_fd",
        f"frame layout: {', '.join(LAYOUTS)} with FILE beside the rig file; or one of your own: its registered name, "
        "package.module:Class, or ./file.py:Class beside the rig file",
    )
    parameters: dict[str, Any] = key({}, "of a frame layout of your own: what its class takes")
    source: str = key("", "of such a layout: its file's text, or its package's digest; filled in when loaded")
    bitrate: int = key(1_000_000, "nominal bit rate", "bit/s", ge=10_000, le=1_000_000)
    data_bitrate: int = key(5_000_000, "bit rate of the data phase of CAN FD", "bit/s", ge=10_000, le=8_000_000)
    transmit_queue: int = key(16, "frames that may wait to be sent", "frames", ge=1, le=1000)
    receive_limit: int = key(32, "frames handed to one tick; more is a flood", "frames", ge=4, le=32)
    host_id: int = key(0x080, "stage layouts: identifier of the command frame", "1", ge=0, le=0x7FF)
    feedback_id: int = key(0x100, "stage layouts: axis i (from 0) answers on feedback_id + i", "1", ge=0, le=0x7F0)
    node_id: int = key(1, "cia402: CANopen node of the first axis; the others follow", "1", ge=1, le=120)
    dbc: DbcBinding | None = key(None, "signals of the DBC file; for a dbc: layout")
    moteus: MoteusConfig | None = key(None, "moteus: the controllers, where they are not as the defaults say")
    cia402: Cia402Config | None = key(None, "the drives' own EDS files; cia402 without it: the project's own drive")

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
    def _every_key_acts(self) -> "BusConfig":
        if self.parameters and LAYOUT_KIND.own(self.protocol):
            raise ValueError(f"parameters: of a frame layout of your own; protocol = {self.protocol!r} takes none")
        for table, layout in (("dbc", "dbc:FILE"), ("cia402", "cia402"), ("moteus", "moteus")):
            if getattr(self, table) is not None and self.protocol.partition(":")[0] != table:
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


class Wiring(NamedTuple):
    """What a frame layout is made for.

    bus: [bus] of the rig file. n_axes: number of axes. rated_force: N or N m per drive, its full scale. period_ns: of
    the control loop. base_dir: folder of the rig file, for the files that our own layouts name; a layout of users reads
    none.
    """

    bus: BusConfig
    n_axes: int
    rated_force: Sequence[float]
    period_ns: int
    base_dir: Path


class WireConfig(BaseModel):
    """[wire]: the simulated CAN segment of runs in virtual time (drivers/wire/wire.py)."""

    model_config = STRICT
    drop_probability: float = key(0.0, "probability that a frame is lost", "1", ge=0, lt=1)
    jitter: float = key(0.0, "variation of the host's sending instant, uniform in +- jitter", "s", ge=0, le=0.01)
    # worst: timing then does not depend on payloads (hil sweep)
    stuffing: Literal["exact", "worst"] = key(
        "exact", "frame lengths: exact bit stuffing, or as long as any frame of its size can be"
    )
    seed: int = key(1, "seed of the losses and of the jitter", "1", ge=0, lt=2**32)


class DrivesConfig(BaseModel):
    """[drives]: what the drives on the bus do by themselves. Safety rules go by it; the emulated drives do the same.

    Lists are in the order of [axes].
    """

    model_config = STRICT
    watchdog_s: float = key(
        0.01, "without a valid command for this long a drive goes to zero torque and latches a fault", "s", gt=0, le=1
    )
    brake: bool | list[bool] = key(
        False, "at zero torque the axis is held by a brake that its drive engages; false: it is free to move"
    )
