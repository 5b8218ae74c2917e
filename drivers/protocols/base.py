"""What every frame layout offers: bytes to values and back, no I/O, no clock."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final, Literal, NamedTuple, Protocol

from drivers.frame import Frame


class LayoutError(ValueError):
    """A frame layout, or the binding of a rig to it, that cannot be used. The text says what to change."""


class DriveStatus(IntFlag):
    """A drive's status in the layout-independent form the control cycle works with."""

    ENABLED = 1 << 0  # applies the torque it is told
    FAULT = 1 << 1  # internal fault, latched in the drive
    WATCHDOG = 1 << 2  # its command watchdog tripped: torque is zero, latched
    TORQUE_LIMITED = 1 << 3  # applied less torque than it was told
    HOMED = 1 << 4  # its position is absolute
    BRAKE = 1 << 5  # holding brake engaged
    ENCODER_FAULT = 1 << 6  # its position cannot be trusted
    LIMIT_LOW = 1 << 7  # limit switch at the axis' least position: closed
    LIMIT_HIGH = 1 << 8  # at its greatest position
    HOME = 1 << 9  # home switch: closed


MOST_SENT: Final = 16  # frames to the drives in a tick, of any layout: a record keeps every one (hil/cycle/record.py)
EVERY_STATUS: Final = int(~DriveStatus(0))  # all bits; anything beyond is no status
INPUTS = DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH | DriveStatus.HOME  # digital inputs, of the axis' mechanics
OF_DRIVES: Final = (1 << 7) - 1  # ENABLED to ENCODER_FAULT: what any drive says of itself; a later bit, who names it
UNHEALTHY = DriveStatus.FAULT | DriveStatus.WATCHDOG | DriveStatus.ENCODER_FAULT  # with any of these no rig gets READY
InputName = Literal["limit_low", "limit_high", "home"]  # INPUTS, as rig files name them
STATUS_NAMES: Final = tuple((bit.name or "").lower() for bit in DriveStatus)  # as rig files and recordings name them


class Reject(IntEnum):
    """Why a received frame carries no sample. Each reason has a counter."""

    UNKNOWN_ID = 0
    WRONG_LENGTH = 1
    WRONG_FORMAT = 2  # classic where FD is due, remote frame, extended id
    BAD_CHECKSUM = 3
    INVALID_VALUE = 4  # a field outside its range
    ERROR_FRAME = 5
    OWN_ECHO = 6
    SERVICE = 7  # NMT, SDO, heartbeat, EMCY: understood, but not a sample
    STALE = 8  # answers an older command than the newest sample did (the cycle's judgement)
    DUPLICATE = 9  # answers a command already answered (the cycle's judgement)


@dataclass(slots=True, init=False)  # the one it would write stays interpreted where the rest is compiled
class Sample:
    """One axis' encoder sample.

    axis: index, 0-based. position: encoder counts, int. status: DriveStatus bits. sequence: of the command frame
    whose reception triggered the sample, modulo the layout's `sequence_modulus`; -1 where the layout has none.
    stamp_ns: the drive's sampling time, unwrapped to the value nearest the frame's reception time; -1 where the layout
    has none.
    """

    axis: int
    position: int
    status: int
    sequence: int
    stamp_ns: int

    def __init__(self, axis: int, position: int, status: int, sequence: int, stamp_ns: int) -> None:
        self.axis, self.position, self.status, self.sequence, self.stamp_ns = axis, position, status, sequence, stamp_ns


class Command(NamedTuple):
    """What the host tells all drives in one tick.

    sequence: tick's sequence number, >= 0 (the layout takes it modulo `sequence_modulus`).
    force: N or N m per axis, within the rated force. enable: bit i set = axis i applies its torque; clear = zero
    torque, brake engaged. reset: clear latched drive faults (acts on its rising edge).
    """

    sequence: int
    force: Sequence[float]
    enable: int
    reset: bool


class Message(NamedTuple):
    """One periodic message for the schedulability analysis.

    name: as shown to people. can_id: identifier (with EXTENDED where it is). length: payload bytes. fd: CAN FD, with
    bit-rate switch where `brs` says so. period_ns;
    deadline_ns: from the tick's start. jitter_ns: queueing jitter (latest minus earliest
    queueing after the tick's start). sender: node name ("host", "x", ...). after: name of the message whose reception
    triggers this one (feedback after the command), or None. also: other payloads that it may have, bytes. at_rest: of
    one that is sent while no drive is enabled, and at no other time, how many follow each other at most; 0: any time.
    """

    name: str
    can_id: int
    length: int
    fd: bool
    period_ns: int
    deadline_ns: int
    jitter_ns: int
    sender: str
    after: str | None = None
    brs: bool = True
    also: tuple[int, ...] = ()
    at_rest: int = 0


class HostProtocol(Protocol):
    """The host's side of a frame layout. May keep state (CANopen start-up); never reads a clock."""

    name: str
    n_axes: int
    sequence_modulus: int  # 0: the layout carries no sequence number
    checksum: bool  # its frames carry one besides CAN's own
    tells: int  # DriveStatus bits that its answers can carry: what a rig may ask of it (hil/rig/layout.py)
    states: bool  # drives say whether they are enabled or in fault
    causes: bool  # every answer says what is wrong with its drive, not only that something is
    resets: bool  # a command can tell drives to clear what they latched
    fd: bool
    positions: Sequence[tuple[float, float]]  # by axis, the least and greatest count that a sample can carry
    echo_id: int | None  # own frame that triggers sampling and whose echo `decode` wants (drivers.frame.ECHO)
    # ns per axis from the tick's start until a drive that samples in its own time applies its torque; empty where what
    # triggers sampling applies the torque too.
    acts_ns: Sequence[int]
    # ns after which the drives' own time stamps repeat, per axis; 0: stamps are of the host's clock. A stamp is rounded
    # to a thousandth of the wrap at most.
    stamp_wraps_ns: Sequence[int]
    state_ns: int  # period in which drives tell their state; 0: with every position

    @property
    def problems(self) -> Sequence[str]:
        """Why drives were refused, for people; empty where all is well."""

    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        """Value of one received frame; several samples where it carries those of several axes. Never raises, whatever
        the bytes.
        """

    def encode(self, command: Command) -> list[Frame]:
        """Frames of one tick, in sending order; the one that triggers sampling is the last of the cyclic ones."""

    def messages(self, period_ns: int) -> list[Message]:
        """The periodic and service traffic this layout puts on the bus, both directions."""


class DeviceProtocol(Protocol):
    """The drives' side of a frame layout."""

    name: str
    n_axes: int

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command in a received frame. Never raises, whatever the bytes."""

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback frame of one axis."""


class Layout(Protocol):
    """Both sides of a frame layout, as the rest of the product meets them."""

    def host(self) -> HostProtocol:
        """A new host's side."""

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""


def tells_of(layout: HostProtocol, axis: int) -> int:
    """DriveStatus bits that the answers of one axis can carry: those of every axis, and its own inputs, which a layout
    has as `axis_tells` where not all axes have them.
    """
    unmounted = getattr(layout, "layout", layout)
    own: list[int] = []
    for part in getattr(unmounted, "segments", (unmounted,)):
        own += getattr(part, "axis_tells", None) or [0] * part.n_axes
    return layout.tells | own[axis]


SERVICE: Final = "service"  # how the name of a message begins with which other tools may ask a drive, too


class OwnIds(NamedTuple):
    """Identifiers in which the host alone speaks: those whose bits of `mask` are one of `masked`."""

    mask: int
    masked: frozenset[int]

    def __contains__(self, can_id: object) -> bool:
        return isinstance(can_id, int) and can_id & self.mask in self.masked


def fixed_bits(layout: HostProtocol) -> tuple[int, int]:
    """Bits of an identifier that tell a command of the host, and those that tell an answer. They are all bits, but
    where a layout has an `own_mask` (its commands have values in theirs) or an `answer_mask` (answers a drive's state).
    """
    unmounted = getattr(layout, "layout", layout)
    return getattr(unmounted, "own_mask", -1), getattr(unmounted, "answer_mask", -1)


def own_ids(layout: HostProtocol, period_ns: int = 1_000_000) -> list[OwnIds]:
    """Those of a layout, by segment: of its commands, SYNC and NMT. Not those of SDO requests, in which other tools may
    ask a drive, too.
    """
    unmounted = getattr(layout, "layout", layout)
    found = []
    for part in getattr(unmounted, "segments", (unmounted,)):
        messages = part.messages(period_ns)
        mask, _ = fixed_bits(part)
        own = {message.can_id & mask for message in messages if message.sender == "host" and not _is_service(message)}
        others = {message.can_id & mask for message in messages if message.sender != "host"}
        found.append(OwnIds(mask, frozenset(own | set(getattr(part, "network_ids", ()))) - others))
    return found


def _is_service(message: Message) -> bool:
    return message.name.partition(" ")[0] == SERVICE


def echo_ids(layout: HostProtocol) -> Sequence[int | None]:
    """The `echo_id` of every segment: of one, but where the layout has several."""
    found: Sequence[int | None] = getattr(layout, "echo_ids", (layout.echo_id,))
    return found
