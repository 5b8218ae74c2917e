"""One message of a DBC file as a rig uses it, or one page of a multiplexed message: its codec, and what its values are.

A page is what the multiplexers of a message select: the signals that are there for these values. A message that is not
multiplexed is one page.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from cantools.database.can import Message as DbcMessage
from cantools.database.can import Signal
from cantools.database.errors import Error as CantoolsError

from drivers.families.dbc.config import SignalBinding
from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame
from drivers.protocols.base import LayoutError, Reject
from drivers.protocols.checksum import ALGORITHMS
from drivers.protocols.dbc_codec import LONGEST_CLASSIC, Codec, bits_of, compile_signals, is_fd, switches_rate

LONGEST: Final = FD_LENGTHS[-1]  # bytes of a payload
_NOBODY = "Vector__XXX"  # a file's word for no node in particular
Selection = Mapping[str, frozenset[int]]  # multiplexer -> the values with which a signal is there


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


def selection_of(message: DbcMessage, signal: Signal) -> dict[str, frozenset[int]]:
    """What the multiplexers above a signal have to be for it to be there; empty where it always is."""
    by_name = {str(other.name): other for other in message.signals}
    selection: dict[str, frozenset[int]] = {}
    at = signal
    while at.multiplexer_signal is not None and at.multiplexer_ids:
        selection[str(at.multiplexer_signal)] = frozenset(at.multiplexer_ids)
        at = by_name[str(at.multiplexer_signal)]
        if len(selection) > len(by_name):
            raise LayoutError(f"message {message.name}: its multiplexers select each other")
    return selection


class Mark(NamedTuple):
    """Bits of a payload, as an integer of LONGEST bytes from its start: which ones, and what they are."""

    mask: int = 0
    bits: int = 0


def as_number(payload: bytes) -> int:
    """A payload as an integer of LONGEST bytes, from its start."""
    return int.from_bytes(payload.ljust(LONGEST, b"\0"), "big")


class BoundMessage:
    """One page of a message that the rig uses.

    selection: of the page. chosen: its multiplexers' places, and the raw values that each may have. fixed: raw values
    by place that are the same in every frame: the multiplexers'. checksum_at: byte of its checksum, or -1. owners:
    nodes at the drives' end, by the file. Signals that are not bound are sent as zero and not looked at.
    """

    def __init__(self, message: DbcMessage, algorithm: str, selection: Selection | None = None) -> None:
        self.selection = dict(selection or {})
        self.name = str(message.name)
        self.can_id = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        self.fd = is_fd(message)
        self.brs = self.fd and switches_rate(message)
        self._flags = (FD | BRS if self.brs else FD) if self.fd else 0
        self.length = message.length
        self.owners = _owners(message)
        if self.length not in FD_LENGTHS or (self.length > LONGEST_CLASSIC and not self.fd):
            raise LayoutError(
                f"message {self.name} has {self.length} bytes, which no {'FD' if self.fd else 'classic'} frame has"
            )
        try:
            message.refresh(strict=True)
        except CantoolsError as error:
            raise LayoutError(f"message {self.name}: {error}") from None
        signals = [signal for signal in message.signals if self._has(message, signal)]
        self.codec: Codec = compile_signals(signals, self.length)
        self._signals = {str(signal.name): signal for signal in signals}
        chosen = {self.codec.names.index(name): ids for name, ids in self.selection.items()}
        self.chosen = tuple(chosen.items())
        self.fixed = {at: min(ids) for at, ids in chosen.items()}
        self._whole = max((_end(signal) for signal in signals), default=0)
        self._known = max((_end(self._signals[name]) for name in self.selection), default=self.length)
        self._checksum = ALGORITHMS[algorithm]
        self.checksum_at = -1
        self._mark = Mark()

    def _has(self, message: DbcMessage, signal: Signal) -> bool:
        """Whether the signal is there with every value that the page's multiplexers may have."""
        needs = selection_of(message, signal)
        return all(name in self.selection and self.selection[name] <= ids for name, ids in needs.items())

    def carries(self, signal: str) -> bool:
        """Whether the signal is on this page."""
        return signal in self._signals

    def unit(self, signal: str) -> str:
        """The unit of a signal, as the file writes it; empty where it has none."""
        return str(self._signals[signal].unit or "")

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

    def _unfit(self, frame: Frame) -> Reject | None:
        """Why a frame with this identifier cannot be unpacked, or None."""
        if bool(frame.flags & FD) != self.fd:
            return Reject.WRONG_FORMAT
        cut = bool(self.selection) and self._whole <= len(frame.data) < self.length  # behind all that is on the page
        if len(frame.data) != self.length and not cut:
            return Reject.WRONG_LENGTH
        at = self.checksum_at
        if at >= 0 and self._checksum(frame.data[:at] + frame.data[at + 1 :]) != frame.data[at]:
            return Reject.BAD_CHECKSUM
        return None

    def bits(self, at: int) -> int:
        """The bits of the value at this place, as those of a Mark."""
        return as_number(bits_of(self._signals[self.codec.names[at]], self.length))

    def marked(self, mark: Mark) -> None:
        """Take only frames with these bits: another bound message has the same identifier."""
        self._mark = Mark(self._mark.mask | mark.mask, self._mark.bits | mark.bits)

    def read(self, frame: Frame) -> Sequence[Any] | Reject | None:
        """Raw values of a frame that is of this page; None of one that is not; Reject of one that cannot be read."""
        if self._mark.mask and self._is_foreign(frame):
            return None
        unfit = self._unfit(frame)
        if unfit is not None:
            return None if self._is_another(frame) else unfit
        values = self._values(frame.data)
        return values if self._is_in(values) else None

    def _is_foreign(self, frame: Frame) -> bool:
        """A frame of another message with this identifier; one that is too short to tell is none."""
        mask, bits = self._mark
        untold = 8 * (LONGEST - len(frame.data))
        return not mask & ((1 << untold) - 1) and as_number(frame.data) & mask != bits

    def _values(self, data: bytes) -> Sequence[Any]:
        """Raw values of a frame that fits; of a page that is sent shorter than its message, those that are there."""
        return self.codec.unpack(data if len(data) == self.length else data.ljust(self.length, b"\0"))

    def _is_another(self, frame: Frame) -> bool:
        """A frame of a multiplexed message, shorter than it, that has another page in it than this one."""
        if not self._known <= len(frame.data) < self.length or bool(frame.flags & FD) != self.fd:
            return False
        return not self._is_in(self._values(frame.data))

    def _is_in(self, values: Sequence[Any]) -> bool:
        """Whether these values are of this page."""
        return not self.chosen or all(values[at] in ids for at, ids in self.chosen)

    def blank(self) -> list[Any]:
        """Values of a frame that says nothing yet."""
        values: list[Any] = [0] * len(self.codec.names)
        for at, raw in self.fixed.items():
            values[at] = raw
        return values

    def frame(self, values: Sequence[Any]) -> Frame:
        """Frame of raw values, checksum filled in."""
        data = self.codec.pack(*values)
        at = self.checksum_at
        if at >= 0:
            head, tail = data[:at], data[at + 1 :]
            data = head + bytes((self._checksum(head + tail),)) + tail
        return Frame(self.can_id, data, self._flags)


def _owners(message: DbcMessage) -> frozenset[str]:
    """The nodes that send a message, or else those that receive it; of one that all nodes have, none is told."""
    receivers = {str(node) for signal in message.signals for node in signal.receivers or ()}
    return frozenset({str(node) for node in message.senders} | receivers) - {_NOBODY}


def _end(signal: Signal) -> int:
    """Bytes from the payload's start to the end of a signal."""
    if signal.byte_order == "little_endian":
        return -(-(signal.start + signal.length) // 8)
    return signal.start // 8 + 1 + -(-max(0, signal.length - signal.start % 8 - 1) // 8)


class Bound(NamedTuple):
    """A binding resolved: its page and the place in it."""

    message: BoundMessage
    place: Place
