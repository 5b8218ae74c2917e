"""What a frame layout of users is made of: a host's side and, apart from it, a drives' side."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from drivers.config import Wiring
from drivers.frame import Frame
from drivers.protocols.base import OF_DRIVES, Command, Message, Reject, Sample


class FrameLayout(ABC):
    """A frame layout: which CAN frames carry the torques, and which the positions.

        class Maker(hil.FrameLayout):
            def __init__(self, wiring, base_id=0x300):
                super().__init__(wiring)
                self.base_id = base_id

            def host(self):
                return MakerHost(self.wiring, self.base_id)

            def drives(self):
                return MakerDrives(self.wiring, self.base_id)

    One of your own is constructed with the rig's `Wiring` and [bus.parameters]; it raises ValueError for a rig that it
    cannot carry. The two sides are written apart, each from the drives' documentation: what one gets wrong the other
    then shows.
    """

    def __init__(self, wiring: Wiring, **parameters: Any) -> None:
        self.wiring = wiring

    @abstractmethod
    def host(self) -> "HostSide":
        """A new host's side."""

    @abstractmethod
    def drives(self) -> "DriveSide":
        """A new drives' side."""


class HostSide(ABC):
    """The host's side of a frame layout of your own: what the control process sends, and what it makes of answers.

    It may keep state; it reads no clock, opens nothing, and builds new frames in `encode` alone. What it says of itself
    are attributes, of the class or set in its constructor:

    sequence_modulus: an answer says which command it answers, modulo so much; 0: it does not.
    checksum: frames carry one besides CAN's own. states: drives say whether they are enabled or in fault. causes: every
    answer says what is wrong with its drive, not only that something is. resets: a command can tell drives to clear
    what they latched. fd: CAN FD frames.
    positions: by axis, the least and greatest count that an answer can carry; empty: those of 32 bits.
    echo_id: identifier of the own frame at whose end the drives sample; None where samples carry stamps of their own.
    acts_ns: of drives that sample in their own time, ns per axis from the tick's start until a torque acts; else empty.
    tells: DriveStatus bits that its answers can carry; limit switches and home switch are not among them by default.
    state_ns: period in which drives tell their state; 0: with every position.
    problems: why drives were refused, for people.
    """

    sequence_modulus: int = 0
    checksum: bool = False
    states: bool = False
    causes: bool = False
    resets: bool = True
    tells: int = OF_DRIVES
    fd: bool = False
    positions: Sequence[tuple[float, float]] = ()
    echo_id: int | None = None
    acts_ns: Sequence[int] = ()
    state_ns: int = 0
    problems: Sequence[str] = ()

    @abstractmethod
    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        """The sample in a received frame, or why there is none; several where a frame has those of several axes.

        It must never raise, whatever the bytes. A `Sample` with stamp_ns = -1 was taken at the end of the frame
        `echo_id`; without one, just before the first answer began. Frames of other identifiers come here, too.
        """

    @abstractmethod
    def encode(self, command: Command) -> list[Frame]:
        """All frames of one tick, in sending order. Forces are finite and within the rated ones."""

    @abstractmethod
    def messages(self, period_ns: int) -> list[Message]:
        """All frames that this layout ever puts on the bus, in both directions. sender: "host", "axis 0", ..."""


class DriveSide(ABC):
    """The drives' side of a frame layout of your own: for emulated drives, and for what reads commands off the bus.

    fd: CAN FD frames. sequence_modulus: as the host's side has it. force_resolution: half a step of the torque as a
    fraction of the rated force. enable_lag: commands that may still carry older enable bits.
    """

    fd: bool = False
    sequence_modulus: int = 0
    force_resolution: float = 0.0
    enable_lag: int = 0

    @abstractmethod
    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command for all axes that this frame completes; Reject.SERVICE for a part of one.

        It must never raise, whatever the bytes. Reject.INVALID_VALUE says that a frame arrived intact and asks for what
        no drive may do: the emulated drives then latch a fault.
        """

    @abstractmethod
    def encode_feedback(self, sample: Sample) -> Frame | Sequence[Frame]:
        """What the drive of one axis answers to a command: a frame, or several, the one with the position last."""
