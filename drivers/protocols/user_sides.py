"""The sides of a frame layout that users bring: Python classes, run interpreted in every build, trusted with nothing.

What they say of themselves is checked when they are made, what they return at every call. A host's side that raises,
returns no frames of its own messages, or does not return sends nothing any more. The drives' watchdogs act, and the
control cycle does what it does when no answer comes. The next reset gives it another chance. A frame that it cannot
decode is a frame with an invalid value. `problems` says which line of which file it was. A drives' side that raises
ends the run of the emulated drives.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from drivers.base import plugins
from drivers.base.guard import BadAnswerError, Guard, Limited
from drivers.config import LAYOUT_KIND, Wiring
from drivers.frame import ECHO, FD, FD_LENGTHS, Frame
from drivers.protocols.base import EVERY_STATUS, Command, LayoutError, Message, Reject, Sample
from drivers.protocols.common import INT32
from drivers.protocols.frame_layout import DriveSide, HostSide
from drivers.protocols.sampling_clock import SamplingClock

FARTHEST = 2**53  # counts that a float still tells apart
_COUNTS = ("sequence_modulus", "state_ns")
_SWITCHES = ("checksum", "states", "causes", "resets", "fd")


class Maker:
    """The class that a rig's bus.protocol names, and what is said of it. Raises LayoutError."""

    def __init__(self, wiring: Wiring) -> None:
        self.wiring = wiring
        name, source = wiring.bus.protocol, wiring.bus.source
        try:
            self._made = plugins.find(LAYOUT_KIND, name, source)
        except ValueError as error:
            raise LayoutError(str(error)) from None
        self.name = name
        self._guard = Guard(LAYOUT_KIND, name, self._made, LayoutError)
        self.told, self.call = self._guard.told, self._guard.call

    def sides(self) -> tuple["UserHost", "UserDrives"]:
        """Both sides of a new object of the class."""
        made = self.call("it cannot be made", self._made, self.wiring, **self.wiring.bus.parameters)
        host, drives = self.call("host()", made.host), self.call("drives()", made.drives)
        if type(host) is type(drives):
            raise LayoutError(
                self.told("host() and drives()", f"both are {type(host).__name__}; the two sides are written apart, so "
                          "that one shows what the other gets wrong")
            )  # fmt: skip
        for side, what, methods in (
            (host, "host()", ("decode", "encode", "messages")),
            (drives, "drives()", ("decode_command", "encode_feedback")),
        ):
            if missing := [name for name in methods if not callable(getattr(side, name, None))]:
                raise LayoutError(self.told(what, f"{type(side).__name__} has no {' and no '.join(missing)}"))
        return UserHost(self, host), UserDrives(self, drives)


class UserHost:
    """HostProtocol of a user's layout: what it says of itself is checked once, what it returns at every call."""

    def __init__(self, maker: Maker, side: Any) -> None:
        wiring = maker.wiring
        self._maker, self._side = maker, side
        self._decode, self._encode = side.decode, side.encode
        self.name, self.n_axes = maker.name, wiring.n_axes
        self._failure = self._garbled = ""
        self._decoding, self._encoding = Limited(self._undecoded), Limited(self._unsent)
        self.sequence_modulus, self.state_ns = (self._count(name) for name in _COUNTS)
        self.checksum, self.states, self.causes, self.resets, self.fd = (self._switch(name) for name in _SWITCHES)
        self.tells = int(self._of_side("tells")) & EVERY_STATUS
        self.stamp_wraps_ns: Sequence[int] = ()
        self.positions: Sequence[tuple[float, float]] = self._positions()
        self.acts_ns: Sequence[int] = self._acts_ns()
        self.echo_id: int | None = self._of_side("echo_id")
        if self.echo_id is not None and not _is_whole(self.echo_id, 0, 2**32 - 1):
            raise LayoutError(maker.told("host()", f"echo_id = {self.echo_id!r}, expected an identifier or None"))
        self._clock = SamplingClock(wiring.n_axes, wiring.bus.bitrate, wiring.bus.data_bitrate, wiring.period_ns)
        self._own = {message.can_id for message in self.messages(wiring.period_ns) if message.sender == "host"}

    def _of_side(self, name: str) -> Any:
        return _of(self._side, HostSide, name)

    def _count(self, name: str) -> int:
        value = self._of_side(name)
        if not _is_whole(value, 0, 2**62):
            raise LayoutError(self._maker.told("host()", f"{name} = {value!r}, expected a whole number of at least 0"))
        return int(value)

    def _switch(self, name: str) -> bool:
        value = self._of_side(name)
        if not isinstance(value, bool):
            raise LayoutError(self._maker.told("host()", f"{name} = {value!r}, expected True or False"))
        return value

    def _positions(self) -> list[tuple[float, float]]:
        given = self._of_side("positions")
        try:
            ends = [(float(least), float(greatest)) for least, greatest in given] or [INT32] * self.n_axes
        except (TypeError, ValueError):
            ends = []
        if len(ends) != self.n_axes or not all(-FARTHEST <= low < high <= FARTHEST for low, high in ends):
            raise LayoutError(
                self._maker.told("host()", f"positions = {given!r}, expected (least, greatest) for {self.n_axes} axes")
            )
        return ends

    def _acts_ns(self) -> list[int]:
        given = self._of_side("acts_ns")
        found: list[Any] = list(given) if isinstance(given, Sequence) else [None]
        if found and not (len(found) == self.n_axes and all(_is_whole(value, 0, 10**9) for value in found)):
            raise LayoutError(self._maker.told("host()", f"acts_ns = {given!r}, expected ns for {self.n_axes} axes"))
        return [int(value) for value in found]

    @property
    def own_problems(self) -> list[str]:
        """What the layout itself did wrong, and where."""
        return [text for text in (self._failure, self._garbled) if text]

    @property
    def problems(self) -> Sequence[str]:
        """That, and why drives were refused."""
        said = self._of_side("problems")
        silent = [f"{self._failure}; nothing is sent until a reset"] if self._failure else []
        garbled = [self._garbled] if self._garbled else []
        return [*silent, *garbled, *map(str, said if isinstance(said, list | tuple) else ())]

    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        """See HostProtocol."""
        if frame.flags & ECHO:
            if frame.can_id == self.echo_id:
                self._clock.triggered(frame.timestamp_ns)
            return Reject.OWN_ECHO
        self._frame = frame
        with self._decoding:
            outcome = self._decode(frame)
            if isinstance(outcome, Reject):
                return outcome
            if isinstance(outcome, tuple):
                return tuple([self._checked(sample, frame) for sample in outcome])
            return self._checked(outcome, frame)
        return Reject.INVALID_VALUE

    def _undecoded(self, error: BaseException) -> None:
        self._garbled = self._maker.told(f"host().decode of {shown(self._frame)}", error)

    def _unsent(self, error: BaseException) -> None:
        self._failure = self._maker.told("host().encode", error)

    def _checked(self, sample: Any, frame: Frame) -> Sample:
        if not isinstance(sample, Sample):
            raise BadAnswerError(f"returned {sample!r:.60}, expected a Sample, a Reject, or a tuple of Samples")
        if not _is_whole(sample.axis, 0, self.n_axes - 1):
            raise BadAnswerError(f"a Sample of axis {sample.axis!r}; there are {self.n_axes}, from 0")
        least, greatest = self.positions[sample.axis]
        if not _is_whole(sample.position, least, greatest):
            raise BadAnswerError(f"position {sample.position!r} is no whole number of {least:.0f} to {greatest:.0f}")
        if not _is_whole(sample.status, 0, EVERY_STATUS):
            raise BadAnswerError(f"status {sample.status!r} has bits that DriveStatus does not know")
        if not _is_whole(sample.sequence, 0 if self.sequence_modulus else -1, max(self.sequence_modulus - 1, -1)):
            raise BadAnswerError(f"sequence {sample.sequence!r}; sequence_modulus is {self.sequence_modulus}")
        if not _is_whole(sample.stamp_ns, -1, 2**62):
            raise BadAnswerError(f"stamp_ns {sample.stamp_ns!r} is no time in ns")
        stamp_ns = self._clock.instant(sample.axis, frame) if sample.stamp_ns < 0 else int(sample.stamp_ns)
        return Sample(int(sample.axis), int(sample.position), int(sample.status), int(sample.sequence), stamp_ns)

    def encode(self, command: Command) -> list[Frame]:
        """See HostProtocol; nothing from the first failure on, until a reset is asked for."""
        if self._failure and not command.reset:
            return []
        self._failure = ""
        self._clock.trigger()
        with self._encoding:
            return checked_frames(self._encode(command), self._own, "messages() of the host")
        return []

    def messages(self, period_ns: int) -> list[Message]:
        """See HostProtocol. Raises LayoutError."""
        found = self._maker.call("host().messages", self._side.messages, period_ns)
        if not isinstance(found, list) or not found:
            raise LayoutError(self._maker.told("host().messages", f"returned {found!r:.60}, not a list of Messages"))
        names = {message.name for message in found if isinstance(message, Message)}
        for message in found:
            if problem := _message_problem(message, self.n_axes, names):
                raise LayoutError(self._maker.told("host().messages", problem))
        return found


class UserDrives:
    """DeviceProtocol of a user's layout. Raises LayoutError, which ends a run, for whatever its methods do wrong."""

    def __init__(self, maker: Maker, side: Any) -> None:
        self._maker, self._side = maker, side
        self.name, self.n_axes = maker.name, maker.wiring.n_axes
        try:
            self.fd = bool(_of(side, DriveSide, "fd"))
            self.sequence_modulus = int(_of(side, DriveSide, "sequence_modulus"))
            self.force_resolution = float(_of(side, DriveSide, "force_resolution"))
            self.enable_lag = int(_of(side, DriveSide, "enable_lag"))
        except (TypeError, ValueError) as error:
            raise LayoutError(maker.told("drives()", str(error))) from None
        if not 0.0 <= self.force_resolution <= 1.0:
            raise LayoutError(maker.told("drives()", f"force_resolution = {self.force_resolution}, expected 0 to 1"))

    def decode_command(self, frame: Frame) -> Command | Reject:
        """See DeviceProtocol."""
        what = "drives().decode_command"
        found = self._maker.call(what, self._side.decode_command, frame)
        if isinstance(found, Reject):
            return found
        if not isinstance(found, Command):
            raise LayoutError(self._maker.told(what, f"returned {found!r:.60}, expected a Command or a Reject"))
        sequence, force, enable, reset = found
        try:
            forces = [float(value) for value in force]
        except (TypeError, ValueError):
            forces = []
        if len(forces) != self.n_axes or not _is_whole(enable, 0, (1 << self.n_axes) - 1) or not _is_whole(sequence):
            raise LayoutError(self._maker.told(what, f"returned {found!r:.90}, which is none for {self.n_axes} axes"))
        return Command(int(sequence), forces, int(enable), bool(reset))

    def frames_of(self, sample: Sample) -> list[Frame]:
        """What the drive of the sample's axis answers."""
        what = "drives().encode_feedback"
        found = self._maker.call(what, self._side.encode_feedback, sample)
        try:
            return checked_frames([found] if isinstance(found, Frame) else found, None, "")
        except BadAnswerError as error:
            raise LayoutError(self._maker.told(what, error)) from None

    def encode_feedback(self, sample: Sample) -> Frame:
        """See DeviceProtocol: of several frames that with the position."""
        return self.frames_of(sample)[-1]


def _of(side: Any, contract: type, name: str) -> Any:
    """What a side says of itself, or what holds where it says nothing."""
    return getattr(side, name, getattr(contract, name))


def shown(frame: Frame) -> str:
    """A frame for people: identifier and bytes."""
    return f"{frame.can_id:X}#{frame.data.hex().upper()}"


def checked_frames(frames: Any, known: set[int] | None, where: str) -> list[Frame]:
    """The frames that a method returned, of these identifiers. Raises BadAnswerError for what no bus can carry."""
    if not isinstance(frames, Iterable) or isinstance(frames, str | bytes):
        raise BadAnswerError(f"returned {frames!r:.60}, expected a list of Frames")
    found = list(frames)
    for frame in found:
        if not isinstance(frame, Frame) or not isinstance(frame.data, bytes):
            raise BadAnswerError(f"returned {frame!r:.60}, expected a Frame with bytes")
        if not _is_whole(frame.can_id, 0, 2**32 - 1) or not _is_whole(frame.flags, 0, 0x7F):
            raise BadAnswerError(f"returned {frame!r:.60}: no identifier or flags of a frame")
        if not _fits(len(frame.data), bool(frame.flags & FD)):
            raise BadAnswerError(f"a frame of {len(frame.data)} bytes: {shown(frame)}")
        if known is not None and frame.can_id not in known:
            raise BadAnswerError(f"sends {shown(frame)}, whose identifier is none of {where}")
    return found


def _fits(length: int, fd: bool) -> bool:
    return length in FD_LENGTHS if fd else length <= 8


def _is_whole(value: Any, least: float = -(2**62), greatest: float = 2**62) -> bool:
    return isinstance(value, int) and least <= value <= greatest


def _message_problem(message: Any, n_axes: int, names: set[str]) -> str:
    """Why a message of the layout's own list is none; empty for one that is."""
    senders = ["host", *(f"axis {axis}" for axis in range(n_axes))]
    if not isinstance(message, Message):
        return f"returned {message!r:.60} in its list, expected a Message"
    if not all(_is_whole(number, 0) for number in (*message[1:3], *message[4:7], message.at_rest)):
        return f"{message!r:.90}: identifier, length and times are whole numbers of at least 0"
    if message.period_ns < 1 or not _fits(message.length, bool(message.fd)):
        return f"{message!r:.90}: no length of a frame, or no period"
    if message.after is not None and message.after not in names:
        return f"after = {message.after!r} is the name of no message"
    return "" if message.sender in senders else f"sender = {message.sender!r}, expected one of {', '.join(senders)}"
