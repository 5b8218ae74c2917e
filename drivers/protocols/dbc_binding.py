"""The signals of a DBC file that a rig binds: found by name, checked, and with the scale from raw values to SI."""

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple

from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage
from cantools.database.errors import Error as CantoolsError

from drivers.config import DbcBinding, SignalBinding
from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame
from drivers.protocols.base import LayoutError, Reject
from drivers.protocols.checksum import ALGORITHMS
from drivers.protocols.dbc_codec import Codec, compile_codec

_COUNTERS = ("command_counter", "feedback_counter", "checksum")


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
        try:
            message.refresh(strict=True)
        except CantoolsError as error:
            raise LayoutError(f"message {self.name}: {error}") from None
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


class Bound(NamedTuple):
    """A binding resolved: its message and the place in it."""

    message: BoundMessage
    place: Place


def check_binding(binding: DbcBinding, n_axes: int) -> None:
    """Lists have one entry per axis; counters come in pairs."""
    for key in ("position", "torque"):
        count = len(getattr(binding, key))
        if count != n_axes:
            raise LayoutError(f"bus.dbc.{key} has {count} signals for {n_axes} axes")
    for key in ("status", "error", "feedback_counter"):
        count = len(getattr(binding, key))
        if count not in (0, n_axes):
            raise LayoutError(f"bus.dbc.{key} has {count} signals for {n_axes} axes; it may also be left out")
    if len(binding.enable) not in (0, 1, n_axes):
        raise LayoutError(
            f"bus.dbc.enable has {len(binding.enable)} signals for {n_axes} axes; it may also have one or none"
        )
    if binding.feedback_period_s and binding.feedback != "cyclic":
        raise LayoutError("bus.dbc.feedback_period_s: triggered drives answer commands and have no period of their own")
    if binding.checksum_algorithm != DbcBinding.model_fields["checksum_algorithm"].default and not binding.checksum:
        raise LayoutError("bus.dbc.checksum_algorithm: no bus.dbc.checksum is bound that it would act on")
    if bool(binding.feedback_counter) != bool(binding.command_counter):
        raise LayoutError("bus.dbc: feedback_counter echoes command_counter; bind both or neither")


def bind_messages(database: Database, binding: DbcBinding, file: str) -> dict[str, BoundMessage]:
    """Every message the binding names. Raises LayoutError with every name that is not in the file, and the nearest."""
    problems: list[str] = []
    messages: dict[str, BoundMessage] = {}
    for key, item in bound_items(binding):
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


def bound_items(binding: DbcBinding) -> list[tuple[str, SignalBinding]]:
    """Every bound signal, with its key in the rig file."""
    items: list[tuple[str, SignalBinding]] = []
    for key in ("position", "torque", "status", "error", "enable", "reset", "constant", *_COUNTERS):
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
