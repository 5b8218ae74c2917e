"""Turns a DBC message into a codec fast enough for the loop.

cantools interprets its description of a message at every call (1 to 4 us). Here the description is read once: a message
of whole bytes becomes a `struct.Struct`, any other a few shifts and masks. Both work on raw values, before the
DBC's factor and offset. tests/drivers/protocols/test_protocols.py holds them equal to cantools' own encode and decode.
"""

import logging
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cantools
from cantools.database import UnsupportedDatabaseFormatError  # type: ignore[attr-defined]
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from drivers.base.text_file import UnsuitableFileError, read_bounded, words_of
from drivers.base.toml_file import short
from drivers.protocols.base import LayoutError

LARGEST = 2**20  # bytes of a DBC file that is parsed; cantools takes two seconds for the densest
LARGEST_FILE = 2**23  # of one whose bound messages alone are
# What cantools would work on for minutes: frames, signals and multiplexer ranges beyond any that a CAN bus has.
_STRING_OR_COMMENT = re.compile(r'"(?:\\"|[^"])*?"|//[^\n]*')
_SIZES = (
    ("frame length", re.compile(r"\bBO_\s+\S+\s+\w+\s*:\s*([-+]?\d+)"), 64),
    ("signal's first bit", re.compile(r":\s*([-+]?\d+)\s*\|"), 511),
    ("signal length", re.compile(r"\|\s*([-+]?\d+)\s*@"), 512),
    ("byte order", re.compile(r"\|\s*\d+\s*@\s*(\d+)"), 1),
    ("multiplexer value", re.compile(r"\bSG_MUL_VAL_\s+\d+\s+\w+\s+\w+([^;]*)"), 65535),
)
_RANGES = re.compile(r"\bSG_MUL_VAL_\s[^;]*")
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")
_NODES = re.compile(r"\bBU_\s*:([^\n]*)")
_MOST_SELECTED, _MOST_NODES = 2**17, 2**16  # multiplexer values of all ranges together; nodes of the network
logging.getLogger("cantools").addHandler(logging.NullHandler())  # whatever matters of a file is said in our words

LONGEST_CLASSIC = 8  # bytes of a frame

_OF_DAMAGED_TEXT = (ValueError, ArithmeticError, LookupError, TypeError, AttributeError, RecursionError)


class Codec(NamedTuple):
    """Raw values of one message, in the order of `names` (ascending position in the payload).

    unpack takes exactly `length` bytes. pack takes one value per name and raises struct.error or OverflowError for one
    that does not fit; bits that no signal covers are zero.
    """

    names: tuple[str, ...]
    length: int
    unpack: Callable[[bytes], tuple[Any, ...]]
    pack: Callable[..., bytes]


_BRS = "CANFD_BRS"
_NO = ("0", "No", "no", "")  # a definition without a default leaves it open


def load_dbc(path: Path) -> Database:
    """Read a whole DBC file of at most LARGEST bytes; single messages may be inconsistent. Raises LayoutError."""
    return parse_dbc(read_dbc(path), path)


def read_dbc(path: Path) -> str:
    """The text of a DBC file, of at most LARGEST_FILE bytes. Raises LayoutError."""
    try:
        data = read_bounded(path, LARGEST_FILE)
    except OSError as error:
        raise LayoutError(f"{path}: {words_of(error)}") from None
    except UnsuitableFileError as error:
        raise LayoutError(f"{path}: not a usable DBC file: {error}") from None
    # cp1252 is the encoding of DBC files, as in cantools; names and numbers are ASCII whatever its comments are in
    return data.removeprefix(b"\xef\xbb\xbf").decode("cp1252", errors="replace")


def parse_dbc(text: str, path: Path) -> Database:
    """The database in the text of a DBC file; path: where it is from. Raises LayoutError."""
    try:
        if len(text) > LARGEST:
            raise UnsuitableFileError(f"longer than {LARGEST} bytes")
        _refuse_sizes(text)
        database = cantools.database.load_string(text, database_format="dbc", strict=False)
    except UnsuitableFileError as error:
        raise LayoutError(f"{path}: not a usable DBC file: {error}") from None
    except (CantoolsError, UnsupportedDatabaseFormatError, *_OF_DAMAGED_TEXT) as error:
        raise LayoutError(f"{path}: not a usable DBC file: {short(str(error), 400)}") from None
    assert isinstance(database, Database)  # what database_format="dbc" gives
    return database


def _refuse_sizes(text: str) -> None:
    """Raise UnsuitableFileError for a number beyond what a CAN bus has."""
    bare = _STRING_OR_COMMENT.sub(" ", text)
    for what, pattern, most in _SIZES:
        for number in (digits for found in pattern.finditer(bare) for digits in re.findall(r"\d+", found[1])):
            if len(number) > 9 or int(number) > most:
                raise UnsuitableFileError(f"{what} {short(number)}: allowed 0 to {most}")
    spans = (pair for found in _RANGES.finditer(bare) for pair in _RANGE.findall(found[0]))
    if sum(max(0, int(high) - int(low)) for low, high in spans) > _MOST_SELECTED:
        raise UnsuitableFileError(f"its multiplexer ranges have more than {_MOST_SELECTED} values together")
    if sum(len(found[1].split()) for found in _NODES.finditer(bare)) > _MOST_NODES:
        raise UnsuitableFileError(f"more than {_MOST_NODES} nodes")


def is_fd(message: Message) -> bool:
    """Whether a message is one of CAN FD: its file says so, or leaves it open and no other frame is so long."""
    return bool(message.is_fd) or (message.length > LONGEST_CLASSIC and not _states_format(message))


def message_of_node(key: str, path: Path, can_id: int, *, fd: bool, what: str) -> Message:
    """The one message of a sensor or an output beside the drives. key: its table in the rig file. can_id: 11 bits.

    Raises LayoutError naming the key: the file cannot be read, has no such message, or one of pages or of the other
    frame format.
    """
    try:
        messages = load_dbc(path).messages
    except LayoutError as error:
        raise LayoutError(f"{key}.file: {error}") from None
    for message in messages:
        if message.frame_id == can_id and not message.is_extended_frame:
            break
    else:
        some = ", ".join(f"{message.name} {message.frame_id:#x}" for message in messages[:6])
        raise LayoutError(f"{key}.can_id = {can_id:#x}: no such message in {path.name}: {some}")
    if message.is_multiplexed():
        raise LayoutError(f"{key}.file: message {message.name} is multiplexed, which no {what} may be")
    if is_fd(message) != fd:
        found = "a CAN FD" if is_fd(message) else "a classic"
        raise LayoutError(f"{key}.fd = {str(fd).lower()}: message {message.name} of {path.name} is {found} frame")
    return message


def fd_by_length(message: Message) -> bool:
    """Whether its length alone says that it is."""
    return is_fd(message) and not message.is_fd


def switches_rate(message: Message) -> bool:
    """Whether the data of an FD message is sent at the higher rate: the file says so, or says nothing of it."""
    if message.dbc is None:
        return True
    stated = message.dbc.attributes.get(_BRS)
    if stated is not None:
        return str(stated.value) not in _NO
    definition = message.dbc.attribute_definitions.get(_BRS)
    default = None if definition is None else definition.default_value
    return default is None or str(default) not in _NO


def _states_format(message: Message) -> bool:
    """The file gives this very message a frame format."""
    return message.dbc is not None and "VFrameFormat" in message.dbc.attributes


def compile_codec(message: Message, expected: Sequence[str] | None = None) -> Codec:
    """Codec of all signals of a message that is not multiplexed.

    expected: the names the caller's code counts on; LayoutError where the DBC has others or has them in another order.
    """
    codec = compile_signals(message.signals, message.length)
    if expected is not None and codec.names != tuple(expected):
        raise LayoutError(f"message {message.name}: signals {', '.join(codec.names)}; expected {', '.join(expected)}")
    return codec


def compile_signals(signals: Sequence[Signal], length: int) -> Codec:
    """Codec of signals that do not overlap, in a payload of so many bytes."""
    signals = sorted(signals, key=lambda signal: _top_bit(signal))
    names = tuple(str(signal.name) for signal in signals)
    if not signals:
        return Codec((), length, lambda data: (), lambda: bytes(length))
    layout = _struct_format(signals, length)
    if layout is not None:
        return Codec(names, length, layout.unpack, layout.pack)
    unpack, pack = _compile_bits(signals, length)
    return Codec(names, length, unpack, pack)


def _is_little(signal: Signal) -> bool:
    return signal.byte_order == "little_endian"


def _top_bit(signal: Signal) -> tuple[int, int]:
    """Byte of the signal's start and its bit in it, so that signals sort in the order they are drawn."""
    bit = signal.start % 8
    return signal.start // 8, bit if _is_little(signal) else 7 - bit


_INTEGER = {8: "b", 16: "h", 32: "i", 64: "q"}
_FLOAT = {16: "e", 32: "f", 64: "d"}


def _struct_format(signals: Sequence[Signal], length: int) -> struct.Struct | None:
    """The message as a struct, or None where a signal is not made of whole bytes or byte orders are mixed."""
    orders = {signal.byte_order for signal in signals if signal.length > 8}
    if len(orders) > 1:
        return None
    layout = "<" if orders <= {"little_endian"} else ">"
    position = 0
    for signal in signals:
        offset, bit = divmod(signal.start, 8)
        if bit != (0 if _is_little(signal) else 7) or signal.length not in _INTEGER:
            return None
        kind = _FLOAT.get(signal.length) if signal.is_float else _INTEGER[signal.length]
        if kind is None:
            return None
        layout += f"{offset - position}x" if offset > position else ""
        layout += kind if signal.is_float or signal.is_signed else kind.upper()
        position = offset + signal.length // 8
    return struct.Struct(layout + (f"{length - position}x" if length > position else ""))


class _Field(NamedTuple):
    """A signal in the payload read as one integer of big or little byte order; sign: weight of the sign bit, or 0."""

    big: bool
    shift: int
    mask: int
    sign: int
    to_float: Callable[[int], float] | None
    from_float: Callable[[float], int] | None


def _field(signal: Signal, length: int) -> _Field:
    big = not _is_little(signal)
    offset, bit = divmod(signal.start, 8)
    shift = 8 * length - (8 * offset + 7 - bit) - signal.length if big else signal.start
    to_float = from_float = None
    if signal.is_float:
        if signal.length not in _FLOAT:
            lengths = ", ".join(map(str, _FLOAT))
            raise LayoutError(
                f"signal {signal.name}: a floating-point number of {signal.length} bits; allowed {lengths}"
            )
        bits, number = struct.Struct(">" + _INTEGER[signal.length].upper()), struct.Struct(">" + _FLOAT[signal.length])
        to_float = lambda raw: float(number.unpack(bits.pack(raw))[0])  # noqa: E731
        from_float = lambda value: int(bits.unpack(number.pack(value))[0])  # noqa: E731
    sign = 1 << (signal.length - 1) if signal.is_signed and not signal.is_float else 0
    return _Field(big, shift, (1 << signal.length) - 1, sign, to_float, from_float)


def bits_of(signal: Signal, length: int) -> bytes:
    """A payload of so many bytes in which the bits of a signal are set, and no other."""
    field = _field(signal, length)
    return (field.mask << field.shift).to_bytes(length, "big" if field.big else "little")


_WORD = {1: "B", 2: "H", 4: "I", 8: "Q"}  # lengths that a struct turns into an integer, in half of int.from_bytes' time
_SOURCE = """
def unpack(data):
    word = {word}
    return ({reads},)

def pack({names}):
    if not ({checks}):
        raise OverflowError(f"raw values {{({names},)}} do not fit {ranges}")
    return ({writes}).to_bytes({length}, {order!r})
"""


def _compile_bits(signals: Sequence[Signal], length: int) -> tuple[Callable[..., Any], Callable[..., bytes]]:
    """unpack and pack of a message whose signals are not whole bytes: shifts and masks on the payload as one integer.

    Integers of one byte order are written out as Python source (made of numbers only) and compiled, which halves the
    time of a loop over them; other messages are rare and take the loop.
    """
    fields = [_field(signal, length) for signal in signals]
    if len({field.big for field in fields}) > 1 or any(field.to_float for field in fields):
        plan = MixedPlan(fields, length)
        return plan.unpack, plan.pack
    reads, checks, writes, ranges = [], [], [], []
    for place, field in enumerate(fields):
        read = f"word >> {field.shift}" if field.shift else "word"
        top = field.shift + field.mask.bit_length() == 8 * length
        read += "" if top else f" & {field.mask}"
        reads.append(f"({read} ^ {field.sign}) - {field.sign}" if field.sign else read)
        checks.append(f"{-field.sign} <= v{place} <= {field.mask - field.sign}")
        writes.append(f"(v{place} & {field.mask}) << {field.shift}" if field.sign else f"v{place} << {field.shift}")
        ranges.append((-field.sign, field.mask - field.sign))
    big = fields[0].big
    source = _SOURCE.format(
        order="big" if big else "little",
        word="read(data)[0]" if length in _WORD else f"int.from_bytes(data, {'big' if big else 'little'!r})",
        names=", ".join(f"v{place}" for place in range(len(fields))),
        reads=", ".join(reads),
        checks=" and ".join(checks),
        writes=" | ".join(writes),
        ranges=ranges,
        length=length,
    )
    namespace: dict[str, Any] = {}
    if length in _WORD:
        namespace["read"] = struct.Struct((">" if big else "<") + _WORD[length]).unpack
    exec(source, namespace)
    return namespace["unpack"], namespace["pack"]


class MixedPlan:
    """The same for messages that mix byte orders or hold floats between other bits."""

    def __init__(self, fields: Sequence[_Field], length: int) -> None:
        self._length = length
        self._fields = fields

    def unpack(self, data: bytes) -> tuple[Any, ...]:
        """Raw values of `length` bytes."""
        words = int.from_bytes(data, "little"), int.from_bytes(data, "big")
        values: list[Any] = []
        for big, shift, mask, sign, to_float, _ in self._fields:
            raw = (((words[big] >> shift) & mask) ^ sign) - sign
            values.append(raw if to_float is None else to_float(raw))
        return tuple(values)

    def pack(self, *values: Any) -> bytes:
        """Payload of raw values; OverflowError where one does not fit its signal."""
        words = [0, 0]
        for (big, shift, mask, sign, _, from_float), value in zip(self._fields, values, strict=True):
            raw = value if from_float is None else from_float(value)
            if not -sign <= raw <= mask - sign:
                raise OverflowError(f"raw value {raw} is outside {-sign} .. {mask - sign}")
            words[big] |= (raw & mask) << shift
        little = int.from_bytes(words[0].to_bytes(self._length, "little"), "big")
        return (little | words[1]).to_bytes(self._length, "big")
