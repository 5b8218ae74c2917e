"""[bus.dbc]: how the signals of a DBC file carry the rig."""

from typing import Any, Literal

from drivers.base.keys import REQUIRED, Table, key
from drivers.protocols.base import InputName


class SignalBinding(Table):
    """One value in a DBC file, by message and signal name."""

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


class InputBinding(SignalBinding):
    """A digital input of an axis: a switch that is wired to its drive, or to another node."""

    axis: int = key(REQUIRED, "whose switch, from 0, in the order of [axes]", "1", ge=0, le=63)
    input: InputName = key(REQUIRED, "limit switch at the least or greatest position of the drive, or the home switch")
    closed: list[int] = key([1], "raw values with which the switch is closed", "1", min_length=1)


class ConstantBinding(SignalBinding):
    """A signal of a command message that always has the same raw value."""

    value: int = key(REQUIRED, "raw value", "1", ge=-(2**63), lt=2**64)


class BesideBinding(Table):
    """A signal of such a frame that always has the same raw value."""

    signal: str = key(REQUIRED, "name of the signal in the message")
    value: int = key(REQUIRED, "raw value", "1", ge=-(2**63), lt=2**64)


class FrameBinding(Table):
    """A frame that says something by itself: a message without signals, or with stated values in it."""

    message: str = key(REQUIRED, "name of the message in the DBC file")
    signal: str = key("", "name of a signal in it; without: the message alone says it")
    value: int = key(0, "raw value of that signal", "1", ge=-(2**63), lt=2**64)
    constant: list[BesideBinding] = key(
        [], "other signals of the frame, with their raw values", exclude_if=lambda entries: not entries
    )


class AskBinding(Table):
    """The frame that asks for a value."""

    message: str = key(REQUIRED, "name of the message in the DBC file")
    signal: str = key("", "name of a signal in it; without: the message alone asks")
    value: int | None = key(
        None,
        "raw value of that signal",
        "1",
        derived="the value of the multiplexer of the same name with which the answer is there",
        ge=-(2**63),
        lt=2**64,
    )


class ReadBackBinding(SignalBinding):
    """A value that a drive tells when it is asked: before READY, after every reset, and now and then."""

    axis: int = key(REQUIRED, "whose drive, from 0, in the order of [axes]", "1", ge=0, le=63)
    ask: AskBinding = key(REQUIRED, "the frame that asks for it")
    endpoint: str = key(
        "",
        "ODrive: path of the value in the file of bus.dbc.endpoints, which has its number",
        exclude_if=lambda path: not path,
    )
    least: float = key(REQUIRED, "physical value that it has to have at least", "1")
    most: float = key(REQUIRED, "and at most", "1")


class VescValue(Table):
    """A value of a VESC's configuration, and what it may be."""

    value: str = key(
        REQUIRED,
        "name of the value as the firmware has it. Without `at` one of motor_type, sensor_mode, l_current_max, "
        "l_current_min, l_in_current_max, l_in_current_min, controller_id, timeout_msec, timeout_brake_current",
    )
    least: float = key(REQUIRED, "value that it has to have at least, in the firmware's unit (A, ms)", "1")
    most: float = key(REQUIRED, "and at most", "1")
    axis: int | None = key(None, "whose drive, from 0, in the order of [axes]", "1", derived="every one's", ge=0, le=63)
    configuration: Literal["motor", "application"] = key("motor", "with `at`: which configuration it is in")
    at: int | None = key(
        None,
        "its first byte in the configuration, counted from the signature's first: of a value that each firmware has "
        "elsewhere",
        "1",
        derived="from its name",
        ge=4,
        le=510,
    )
    type: Literal["uint8", "uint16", "uint32", "int16", "float32"] = key("float32", "with `at`: how it is written")
    scale: float = key(1.0, "with `at`: value of 1 in its number; 1e-4 for l_current_max_scale of firmware 6", "1")


class VescBinding(Table):
    """[bus.dbc.vesc]: the configurations that VESCs are asked for, before READY and after a reset."""

    motor_signature: int = key(
        0, "MCCONF_SIGNATURE of their firmware; 0: the motor configuration is not asked for", "1", ge=0, lt=2**32
    )
    application_signature: int = key(
        0, "APPCONF_SIGNATURE of their firmware; 0: the application's is not asked for", "1", ge=0, lt=2**32
    )
    values: list[VescValue] = key([], "values that have to be as stated")
    ask_as: int = key(
        200,
        "VESC ID in whose name the first axis' drive is asked; one more for each further axis. No node of the bus may "
        "have one of them",
        "1",
        ge=0,
        le=254,
    )


class PeriodBinding(Table):
    """How often a message is sent."""

    message: str = key(REQUIRED, "name of the message in the DBC file, or MESSAGE.SIGNAL of a multiplexed one")
    period_s: float = key(
        REQUIRED, "period in which it is sent, and at once when a value in it changes", "s", gt=0, le=1
    )


Signals = list[SignalBinding]


class DbcBinding(Table):
    """[bus.dbc]: how an arbitrary DBC file carries the rig. Lists are in the order of [axes]."""

    position: list[PositionBinding] = key(REQUIRED, "encoder position of each axis")
    status: list[StatusBinding] = key([], "state of each axis' drive; may be in another message than its position")
    error: Signals = key([], "error code of each axis' drive, beside its status: anything but 0 is a fault")
    inputs: list[InputBinding] = key(
        [],
        "limit switches and home switches; an axis whose inputs are not told for 0.5 s counts as in fault",
        exclude_if=lambda entries: not entries,
    )
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
        "period of the messages with `status`, `error` or `inputs` alone; what they say is seen so much later",
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
    read_back: list[ReadBackBinding] = key(
        [],
        "mode and limits that drives are asked for; with another value, or without an answer, a drive counts as in "
        "fault and no rig gets READY",
        exclude_if=lambda entries: not entries,
    )
    vesc: VescBinding | None = key(
        None,
        "VESC: configurations that the drives are asked for; as with `read_back`, none gets READY that differs",
        exclude_if=lambda table: table is None,
    )
    endpoints: str = key(
        "",
        "ODrive: flat_endpoints.json of its firmware, beside the rig file: numbers of the pages of `read_back`",
        exclude_if=lambda name: not name,
    )
    feedback_counter: Signals = key([], "sequence number in the answers")
    command_counter: Signals = key([], "sequence number in the commands")
    checksum: Signals = key([], "checksums in the payload, besides CAN's own")
    checksum_algorithm: Literal["crc8-sae-j1850", "sum8", "xor8"] = key("crc8-sae-j1850", "how they are computed")


class DbcKeys(Table):
    """What this family adds to [bus]."""

    dbc: DbcBinding | None = key(None, "signals of the DBC file; for a dbc: layout")


def dbc_keys(bus: Any) -> DbcKeys:
    """The keys of this family in [bus]."""
    keys: DbcKeys = bus
    return keys
