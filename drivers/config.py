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


class WireConfig(BaseModel):
    """[wire]: the simulated CAN segment of lockstep runs (drivers/wire/wire.py)."""

    model_config = STRICT
    drop_probability: Annotated[float, Field(ge=0, lt=1)] = 0.0  # per frame
    jitter: Annotated[float, Field(ge=0, le=0.01)] = 0.0  # s, the host's sending instant, uniform in +- jitter
    # worst: every frame is as long as any of its size can be, so that timing does not depend on payloads (hil sweep)
    stuffing: Literal["exact", "worst"] = "exact"
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
