"""The part of a rig file that describes the bus: [bus] and [wire]."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SignalBinding(BaseModel):
    """One value in a DBC file, by message and signal name."""

    model_config = STRICT
    message: str
    signal: str
    scale: Annotated[float, Field(gt=0)] = 1.0  # raw counts (position) or N (force) per physical unit of the DBC


class DbcBinding(BaseModel):
    """How an arbitrary DBC file carries the rig: lists in the order of the axes."""

    model_config = STRICT
    position: list[SignalBinding]
    status: list[SignalBinding] = []
    torque: list[SignalBinding]
    enable: list[SignalBinding] = []  # one signal (a bit for all, or a bit per axis), or one per axis
    reset: list[SignalBinding] = []
    feedback_counter: list[SignalBinding] = []
    command_counter: list[SignalBinding] = []
    checksum: list[SignalBinding] = []
    checksum_algorithm: Literal["crc8-sae-j1850", "sum8", "xor8"] = "crc8-sae-j1850"


class ObjectValue(BaseModel):
    """A value to write into a drive's object dictionary; its size is what the drive's EDS says."""

    model_config = STRICT
    object: Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{4}h?(:[0-9A-Fa-f]{1,2})?$")]  # "6007h", "1029h:01"
    value: Annotated[int, Field(ge=-(2**31), lt=2**32)]

    @property
    def key(self) -> tuple[int, int]:
        """Index and sub-index."""
        index, _, subindex = self.object.partition(":")
        return int(index.rstrip("h"), 16), int(subindex or "0", 16)


class Cia402Config(BaseModel):
    """[bus.cia402]: CiA 402 drives as their makers describe them. Without it they are the project's own (cia402.eds).

    Lists have one entry per axis; `eds` may also have one for all.
    """

    model_config = STRICT
    eds: Annotated[list[str], Field(min_length=1)]  # EDS or DCF files; relative to the rig file
    nodes: list[Annotated[int, Field(ge=1, le=126)]] = []  # node numbers; empty: bus.node_id and the next ones
    rpdo: Literal["auto", "shared", "own"] = "auto"  # one RPDO for the torques of all drives, or one per drive
    sync_counter: Literal["auto", "on", "off"] = "auto"  # the counter of 1019h; auto: where all drives have it
    rated_torque: list[Annotated[float, Field(gt=0, lt=1e6)]] = []  # N m (N) that 6076h stands for; empty: read it
    write_rated_torque: bool = False  # write 6076h, on many drives a property of the motor
    start: Literal["nmt", "autostart"] = "nmt"  # autostart: the drives go to operational by themselves
    write: list[ObjectValue] = []  # further objects, written in this order before the drive is started


class BusConfig(BaseModel):
    """[bus]: which CAN interface, at what bit rates, with which frame layout."""

    model_config = STRICT
    interface: Literal["auto", "socketcan", "local"] = "auto"
    channel: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,15}$")] = "can0"
    protocol: Annotated[str, Field(pattern=r"^(stage_fd|stage_classic|cia402|dbc:.+)$")] = "stage_fd"
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    data_bitrate: Annotated[int, Field(ge=10_000, le=8_000_000)] = 5_000_000
    transmit_queue: Annotated[int, Field(ge=1, le=1000)] = 16  # frames
    receive_limit: Annotated[int, Field(ge=4, le=32)] = 32  # frames handed to one tick; more is a flood
    host_id: Annotated[int, Field(ge=0, le=0x7FF)] = 0x080  # stage layouts: the command frame
    feedback_id: Annotated[int, Field(ge=0, le=0x7F0)] = 0x100  # stage layouts: axis i answers on feedback_id + i
    node_id: Annotated[int, Field(ge=1, le=120)] = 1  # cia402: node of the first axis
    dbc: DbcBinding | None = None
    cia402: Cia402Config | None = None


class WireConfig(BaseModel):
    """[wire]: the simulated CAN segment of lockstep runs (drivers/wire/wire.py)."""

    model_config = STRICT
    drop_probability: Annotated[float, Field(ge=0, lt=1)] = 0.0  # per frame
    jitter: Annotated[float, Field(ge=0, le=0.01)] = 0.0  # s, the host's sending instant, uniform in +- jitter
    # worst: every frame is as long as any of its size can be, so that timing does not depend on payloads (hil sweep)
    stuffing: Literal["exact", "worst"] = "exact"
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
