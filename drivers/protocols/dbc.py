"""`protocol = "dbc:<file>"`: drives that some other DBC file describes, bound to the rig by message and signal name.

What the binding (drivers.config.DbcBinding) means:
- position: one signal per axis, each in a message of its own (a frame gives one sample). counts = physical * scale.
- torque: one signal per axis, in any messages. N (N m) = physical * scale; it has to reach the rated force.
- enable: one signal per axis; or one for all, of a bit per axis, or of one bit (set while any axis is enabled). Without
  it disabled axes get zero torque.
- reset: clears latched faults; any number of signals. Without it the drives' own means have to.
- status: per axis, raw value = DriveStatus bits. Without it a drive counts as enabled while it is told to be.
- command_counter, feedback_counter: the drives echo the commands' counter; both or none. Its length is the modulus;
  every command message may have one.
- checksum: any bound message's 8-bit checksum over its other bytes.
All command messages are sent every tick, the one with the highest identifier last: its reception is the SYNC.
"""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage

from drivers.config import BusConfig, DbcBinding, SignalBinding
from drivers.frame import BRS, ECHO, ERROR, EXTENDED, EXTENDED_MASK, FD, FD_LENGTHS, REMOTE, Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Message, Reject, Sample
from drivers.protocols.checksum import ALGORITHMS
from drivers.protocols.dbc_codec import Codec, compile_codec, load_dbc
from drivers.protocols.sampling_clock import SamplingClock
from drivers.protocols.stage_common import STATUS_MASK, check_force

PREFIX = "dbc:"
ENABLED = int(DriveStatus.ENABLED)


class Place(NamedTuple):
    """A bound signal: place among its message's values; counts or N = raw * gain + offset; raw range; is_float."""

    at: int
    gain: float
    offset: float
    low: float
    high: float
    is_float: bool
    bits: int

    def value(self, raw: Any) -> float:
        """Counts or N of a raw value."""
        return float(raw * self.gain + self.offset)

    def raw(self, value: float) -> Any:
        """Raw value nearest to counts or N, within the signal's range."""
        raw = (value - self.offset) / self.gain
        return max(self.low, min(self.high, raw if self.is_float else round(raw)))


class BoundMessage:
    """One message of the file that the rig uses.

    checksum_at: byte of its checksum, or -1. Signals that are not bound are sent as zero and not looked at.
    """

    def __init__(self, message: DbcMessage, algorithm: str) -> None:
        self.name = str(message.name)
        self.can_id = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        self.fd = bool(message.is_fd)
        self.codec: Codec = compile_codec(message)
        self.length = self.codec.length
        if self.length not in FD_LENGTHS or (self.length > 8 and not self.fd):
            raise LayoutError(
                f"message {self.name} has {self.length} bytes, which no {'FD' if self.fd else 'classic'} frame has"
            )
        self._signals = {str(signal.name): signal for signal in message.signals}
        self._checksum = ALGORITHMS[algorithm]
        self.checksum_at = -1

    def place(self, binding: SignalBinding) -> Place:
        """Where a signal is and how it scales."""
        signal = self._signals[binding.signal]
        gain, offset = float(signal.scale) * binding.scale, float(signal.offset) * binding.scale
        sign = 1 << (signal.length - 1) if signal.is_signed else 0
        low, high = -sign, (1 << signal.length) - 1 - sign
        if signal.is_float:
            return Place(self.codec.names.index(binding.signal), gain, offset, -3.4e38, 3.4e38, True, signal.length)
        return Place(self.codec.names.index(binding.signal), gain, offset, low, high, False, signal.length)

    def whole(self, key: str, binding: SignalBinding) -> None:
        """Raise LayoutError unless the signal is an unsigned integer: bits or a counter."""
        signal = self._signals[binding.signal]
        if signal.is_float or signal.is_signed:
            raise LayoutError(f"{key}: {self.name}.{binding.signal} is not an unsigned integer")

    def protect(self, binding: SignalBinding) -> None:
        """Use the signal as the message's checksum."""
        signal = self._signals[binding.signal]
        if signal.length != 8 or signal.start % 8 not in (0, 7):
            raise LayoutError(f"bus.dbc.checksum: {self.name}.{binding.signal} is not one whole byte")
        self.checksum_at = signal.start // 8

    def fits(self, frame: Frame) -> Reject | None:
        """Why a frame with this identifier cannot be unpacked, or None."""
        if bool(frame.flags & FD) != self.fd:
            return Reject.WRONG_FORMAT
        if len(frame.data) != self.length:
            return Reject.WRONG_LENGTH
        at = self.checksum_at
        if at >= 0 and self._checksum(frame.data[:at] + frame.data[at + 1 :]) != frame.data[at]:
            return Reject.BAD_CHECKSUM
        return None

    def frame(self, values: Sequence[Any]) -> Frame:
        """Frame of raw values, checksum filled in."""
        data = self.codec.pack(*values)
        at = self.checksum_at
        if at >= 0:
            head, tail = data[:at], data[at + 1 :]
            data = head + bytes((self._checksum(head + tail),)) + tail
        return Frame(self.can_id, data, FD | BRS if self.fd else 0)


class _Bound(NamedTuple):
    """A binding resolved: its message and the place in it."""

    message: BoundMessage
    place: Place


class DbcLayout:
    """What both ends share: the bound messages. Raises LayoutError naming every signal that is not there."""

    name = "dbc"

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path) -> None:
        binding = bus.dbc
        if binding is None:
            raise LayoutError(f"bus.protocol = {bus.protocol!r} needs a table [bus.dbc] that binds its signals")
        path = base_dir / bus.protocol.removeprefix(PREFIX)
        _check_binding(binding, n_axes)
        self.n_axes = n_axes
        self._rated = list(rated_force)
        self._messages = _bind_messages(load_dbc(path), binding, path.name)
        for key, item in _items(binding):
            if not key.startswith(("bus.dbc.position", "bus.dbc.torque")):
                self._messages[item.message].whole(key, item)
        for checksum in binding.checksum:
            self._messages[checksum.message].protect(checksum)
        self._position = [self._bound(item) for item in binding.position]
        self._torque = [self._bound(item) for item in binding.torque]
        self._status = [self._bound(item) for item in binding.status]
        self._enable = [self._bound(item) for item in binding.enable]
        self._reset = [self._bound(item) for item in binding.reset]
        self._echo = [self._bound(item) for item in binding.feedback_counter]
        self._counters = [self._bound(item) for item in binding.command_counter]
        self.sequence_modulus = 1 << self._counters[0].place.bits if self._counters else 0
        commands = [bound.message for bound in [*self._torque, *self._enable, *self._reset, *self._counters]]
        self._commands = sorted(dict.fromkeys(commands), key=lambda message: _arbitration(message.can_id))
        self._feedback = [bound.message for bound in self._position]
        self.checksum = all(message.checksum_at >= 0 for message in self._messages.values())
        self.fd = any(message.fd for message in self._messages.values())
        self._check_places(binding, path.name)

    def _bound(self, binding: SignalBinding) -> _Bound:
        message = self._messages[binding.message]
        return _Bound(message, message.place(binding))

    def _check_places(self, binding: DbcBinding, file: str) -> None:
        """Feedback signals of one axis share a message; each axis has its own; counters echo; torques reach."""
        for key, group in (("status", self._status), ("feedback_counter", self._echo)):
            for axis, bound in enumerate(group):
                if bound.message is not self._feedback[axis]:
                    raise LayoutError(
                        f"bus.dbc.{key}[{axis}] is in message {bound.message.name}; it has to be in "
                        f"{self._feedback[axis].name}, which carries position[{axis}]"
                    )
        if len({message.can_id for message in self._feedback}) != self.n_axes:
            raise LayoutError(f"{file}: two positions in one message; each axis needs a message of its own")
        for message in self._feedback:
            if message in self._commands:
                raise LayoutError(f"{file}: message {message.name} is bound both as command and as feedback")
        if len({bound.place.bits for bound in [*self._counters, *self._echo]}) > 1:
            raise LayoutError("bus.dbc: command_counter and feedback_counter have signals of different lengths")
        for axis, (bound, rated) in enumerate(zip(self._torque, self._rated, strict=True)):
            place = bound.place
            reach = min(abs(place.value(place.low)), abs(place.value(place.high)))
            if reach < rated * (1 - 1e-9) or not place.low <= -place.offset / place.gain <= place.high:
                raise LayoutError(
                    f"bus.dbc.torque[{axis}]: {bound.message.name}.{binding.torque[axis].signal} reaches +-{reach:g}; "
                    f"the rated force is {rated:g}: check its scale"
                )
        if len(self._enable) == 1 and 1 < self._enable[0].place.bits < self.n_axes:
            raise LayoutError(f"bus.dbc.enable has {self._enable[0].place.bits} bits; 1, or one per axis, is needed")

    def messages(self, period_ns: int) -> list[Message]:
        """All commands, then the feedbacks, which the last command triggers."""
        commands = [Message(m.name, m.can_id, m.length, m.fd, period_ns, period_ns, 0, "host") for m in self._commands]
        return commands + [
            Message(m.name, m.can_id, m.length, m.fd, period_ns, period_ns, 0, f"axis {axis}", self._commands[-1].name)
            for axis, m in enumerate(self._feedback)
        ]


class DbcHost(DbcLayout):
    """HostProtocol of any DBC file."""

    def __init__(
        self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path, period_ns: int = 1_000_000
    ) -> None:
        super().__init__(bus, n_axes, rated_force, base_dir)
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, period_ns)
        self._axis = {message.can_id: axis for axis, message in enumerate(self._feedback)}
        self._own = {message.can_id for message in self._commands}
        self.echo_id: int | None = self._commands[-1].can_id
        self._enabled = 0

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of a feedback message; its stamp is an estimate (sampling.py)."""
        axis = self._axis.get(frame.can_id)
        if axis is None:
            if frame.flags & ECHO:
                self._clock.triggered(frame.timestamp_ns)
            return _reject_id(frame.can_id, self._axis, self._own)
        message = self._feedback[axis]
        unfit = message.fits(frame)
        if unfit is not None:
            return unfit
        values = message.codec.unpack(frame.data)
        counts = self._position[axis].place.value(values[self._position[axis].place.at])
        if not -(2.0**53) <= counts <= 2.0**53:  # also where it is not a number
            return Reject.INVALID_VALUE
        status = self._enabled >> axis & ENABLED
        if self._status:
            status = int(values[self._status[axis].place.at])
            if status & ~STATUS_MASK:
                return Reject.INVALID_VALUE
        sequence = int(values[self._echo[axis].place.at]) if self._echo else -1
        return Sample(axis, round(counts), status, sequence, self._clock.instant(axis, frame))

    def encode(self, command: Command) -> list[Frame]:
        """All command messages. Raises ValueError for a force not finite or beyond its rated force."""
        check_force(command.force, self._rated)
        self._enabled = enable = command.enable
        self._clock.trigger()
        values = {message.can_id: [0] * len(message.codec.names) for message in self._commands}
        for axis, (message, place) in enumerate(self._torque):
            values[message.can_id][place.at] = place.raw(command.force[axis] if enable >> axis & 1 else 0.0)
        if len(self._enable) == 1 < self.n_axes:
            ((message, place),) = self._enable
            values[message.can_id][place.at] = enable if place.bits > 1 else int(enable != 0)
        else:
            for axis, (message, place) in enumerate(self._enable):
                values[message.can_id][place.at] = enable >> axis & 1
        for message, place in self._reset:
            values[message.can_id][place.at] = int(command.reset)
        for message, place in self._counters:
            values[message.can_id][place.at] = command.sequence % self.sequence_modulus
        return [message.frame(values[message.can_id]) for message in self._commands]


class DbcDevice(DbcLayout):
    """DeviceProtocol of any DBC file: a command is whole once its last message came, after all the others.

    force_resolution: half of the coarsest axis' step as a fraction of its rated force.
    """

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path) -> None:
        super().__init__(bus, n_axes, rated_force, base_dir)
        self._by_id = {message.can_id: message for message in self._commands}
        self._received: dict[int, Sequence[Any]] = {}
        steps = [0.0 if bound.place.is_float else abs(bound.place.gain) for bound in self._torque]
        self.force_resolution = max(0.5 * step / rated for step, rated in zip(steps, rated_force, strict=True))
        self._all_axes = (1 << n_axes) - 1

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that this frame completes; SERVICE for a part of one, STALE where a part is missing."""
        message = self._by_id.get(frame.can_id)
        if message is None:
            return _reject_id(frame.can_id, self._by_id, ())
        unfit = message.fits(frame)
        if unfit is not None:
            return unfit
        self._received[message.can_id] = message.codec.unpack(frame.data)
        if message is not self._commands[-1]:
            return Reject.SERVICE
        received, self._received = self._received, {}
        if len(received) != len(self._commands):
            return Reject.STALE
        return self._assemble(received)

    def _assemble(self, received: dict[int, Sequence[Any]]) -> Command | Reject:
        def raw(bound: _Bound) -> Any:
            return received[bound.message.can_id][bound.place.at]

        force = [bound.place.value(raw(bound)) for bound in self._torque]
        for value, rated, bound in zip(force, self._rated, self._torque, strict=True):
            if not abs(value) <= rated + 0.5 * abs(bound.place.gain):  # rounding; also where it is not a number
                return Reject.INVALID_VALUE
        enable = self._enabled([int(raw(bound)) for bound in self._enable])
        if enable & ~self._all_axes:
            return Reject.INVALID_VALUE
        counters = {int(raw(bound)) for bound in self._counters}
        if len(counters) > 1:
            return Reject.STALE  # parts of two commands
        force = [max(-rated, min(rated, value)) for value, rated in zip(force, self._rated, strict=True)]
        return Command(max(counters, default=0), force, enable, any(raw(bound) for bound in self._reset))

    def _enabled(self, raw: Sequence[int]) -> int:
        """Bit per axis from the raw values of the enable signals."""
        if not raw:
            return self._all_axes
        if len(raw) == 1 < self.n_axes:
            common = self._enable[0].place.bits == 1
            return self._all_axes * raw[0] if common else raw[0]
        return sum(1 << axis for axis, bit in enumerate(raw) if bit)

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback message of one axis; a position beyond its signal's range stays at its end."""
        axis = sample.axis
        message = self._feedback[axis]
        values: list[Any] = [0] * len(message.codec.names)
        place = self._position[axis].place
        values[place.at] = place.raw(sample.position)
        if self._status:
            values[self._status[axis].place.at] = sample.status & STATUS_MASK
        if self._echo:
            values[self._echo[axis].place.at] = sample.sequence % self.sequence_modulus
        return message.frame(values)


def _arbitration(can_id: int) -> tuple[int, int]:
    """Sorts identifiers as arbitration does: base identifier first, standard before extended."""
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        return identifier >> 18, 1 + (identifier & 0x3FFFF)
    return can_id, 0


def _reject_id(can_id: int, known: Any, own: Any) -> Reject:
    """Why a frame whose identifier is none that is listened to carries nothing."""
    if can_id & ERROR:
        return Reject.ERROR_FRAME
    if can_id & REMOTE:
        return Reject.WRONG_FORMAT if can_id & ~REMOTE in known else Reject.UNKNOWN_ID
    return Reject.OWN_ECHO if can_id in own else Reject.UNKNOWN_ID


def _check_binding(binding: DbcBinding, n_axes: int) -> None:
    """Lists have one entry per axis; counters come in pairs."""
    for key in ("position", "torque"):
        count = len(getattr(binding, key))
        if count != n_axes:
            raise LayoutError(f"bus.dbc.{key} has {count} signals for {n_axes} axes")
    for key in ("status", "feedback_counter"):
        count = len(getattr(binding, key))
        if count not in (0, n_axes):
            raise LayoutError(f"bus.dbc.{key} has {count} signals for {n_axes} axes; it may also be left out")
    if len(binding.enable) not in (0, 1, n_axes):
        raise LayoutError(
            f"bus.dbc.enable has {len(binding.enable)} signals for {n_axes} axes; it may also have one or none"
        )
    if bool(binding.feedback_counter) != bool(binding.command_counter):
        raise LayoutError("bus.dbc: feedback_counter echoes command_counter; bind both or neither")


def _bind_messages(database: Database, binding: DbcBinding, file: str) -> dict[str, BoundMessage]:
    """Every message the binding names. Raises LayoutError with every name that is not in the file, and the nearest."""
    problems: list[str] = []
    messages: dict[str, BoundMessage] = {}
    for key, item in _items(binding):
        try:
            message = database.get_message_by_name(item.message)
        except KeyError:
            problems.append(
                f"{key}: {file} has no message {item.message!r}{_nearest(item.message, database.messages, '')}"
            )
            continue
        if item.signal not in [signal.name for signal in message.signals]:
            problems.append(
                f"{key}: message {item.message} has no signal {item.signal!r}"
                f"{_nearest(item.signal, message.signals, item.message + '.')}"
            )
        elif message.is_multiplexed():
            problems.append(f"{key}: message {item.message} is multiplexed, which is not supported")
        elif item.message not in messages:
            messages[item.message] = BoundMessage(message, binding.checksum_algorithm)
    if problems:
        raise LayoutError("; ".join(problems))
    return messages


def _items(binding: DbcBinding) -> list[tuple[str, SignalBinding]]:
    items: list[tuple[str, SignalBinding]] = []
    for key in ("position", "torque", "status", "enable", "reset", "command_counter", "feedback_counter", "checksum"):
        items += [(f"bus.dbc.{key}[{at}]", item) for at, item in enumerate(getattr(binding, key))]
    return items


def _nearest(name: str, candidates: Sequence[Any], prefix: str) -> str:
    """'; did you mean ...?' with the nearest names, in any case; all of them where none is near."""
    names = [str(candidate.name) for candidate in candidates]
    lower = {candidate.lower(): candidate for candidate in reversed(names)}
    near = [lower[match] for match in get_close_matches(name.lower(), lower, n=3, cutoff=0.5)]
    if near:
        return f"; did you mean {' or '.join(prefix + candidate for candidate in near)}?"
    return f"; it has {', '.join(names[:8])}" + (", ..." if len(names) > 8 else "")
