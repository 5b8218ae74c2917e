"""candump's log format (can-utils), every kind of frame whole: FD flags, lengths of remote frames, classes of errors.

    (1700000000.000100) can0 123#0102           a classic frame
    (1700000000.000200) can0 18DA0102#R5        a remote frame of 29 bits that asks for five bytes
    (1700000000.000300) can0 123##50102         an FD frame; the digit is Linux' flags: 1 BRS, 2 ESI, 4 FD
    (1700000000.000400) can0 20000040#00000000  an error frame: bus off (include/uapi/linux/can/error.h)

What candump shows on a screen is read, too: `can0  123   [2]  01 02`, with a time in front or without one.

Our own, as python-can 4.6 forgets what a remote frame asks for and what an error frame says. A last word R or T tells
whether the frame was received or sent.
"""

import contextlib
import gzip
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import can

from drivers.bus.local_bus import from_message, to_message
from drivers.frame import BRS, ERROR, ESI, EXTENDED, EXTENDED_MASK, FD, FD_LENGTHS, REMOTE, STANDARD_MASK, Frame

_LINE = re.compile(
    r"\((?P<time>\d+(?:\.\d+)?)\) +(?P<channel>\S+) +(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"(?:#R(?P<asks>[0-8])?|##(?P<flags>[0-9A-Fa-f])(?P<fd>[0-9A-Fa-f]*)|#(?P<data>[0-9A-Fa-f.]*))"
    r"(?:_[0-9A-Fa-f])?(?: +(?P<way>[RT]))?\s*"
)

_SCREEN = re.compile(
    r"\s*(?:\((?P<time>-?\d+(?:\.\d+)?)\)\s+)?(?P<channel>[^\s(]\S*)\s+(?:(?P<way>RX|TX)\s+(?P<marks>[BE -]+)\s+)?"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(?P<length>\d{1,2})\](?P<data>(?:\s+[0-9A-Fa-f]{2})*)\s*"
    r"(?P<what>ERRORFRAME|remote request)?(?:\s+'.*')?\s*"
)


class TraceError(ValueError):
    """A trace that cannot be read; the text names the file, and the place in it where that is known."""


def frame_text(frame: Frame) -> str:
    """A frame as candump writes it."""
    can_id, data, flags, _ = frame
    if can_id & ERROR:
        name = f"{can_id & (ERROR | EXTENDED_MASK):08X}"
    elif can_id & EXTENDED:
        name = f"{can_id & EXTENDED_MASK:08X}"
    else:
        name = f"{can_id & STANDARD_MASK:03X}"
    if can_id & REMOTE:
        return f"{name}#R{len(data) or ''}"
    if flags & FD:
        return f"{name}##{flags & (BRS | ESI) | FD:X}{data.hex().upper()}"
    return f"{name}#{data.hex().upper()}"


def read_line(line: str) -> can.Message | None:
    """The message of a line, None where it is none."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    number, asks, extended = int(match["id"], 16), match["asks"], len(match["id"]) == 8
    if number > (ERROR | EXTENDED_MASK if extended else STANDARD_MASK):
        return None
    can_id = number | EXTENDED if extended and not number & ERROR else number
    flags = 0
    if match["flags"] is not None:
        flags, hexadecimal = int(match["flags"], 16) & (BRS | ESI) | FD, match["fd"]
    else:
        hexadecimal = (match["data"] or "").replace(".", "")
    if match["data"] is None and not flags:
        can_id |= REMOTE
        hexadecimal = "00" * int(asks or 0)
    if len(hexadecimal) % 2 or not _possible(len(hexadecimal) // 2, flags):
        return None
    message = to_message(Frame(can_id, bytes.fromhex(hexadecimal), flags), float(match["time"]), match["channel"])
    message.is_rx = match["way"] != "T"
    return message


def read_screen_line(line: str) -> can.Message | None:
    """The message of a line as candump shows it on a screen, None where it is none. Two digits of length: CAN FD."""
    match = _SCREEN.fullmatch(line)
    if match is None:
        return None
    number, length, data = int(match["id"], 16), int(match["length"]), bytes.fromhex(match["data"])
    extended, marks = len(match["id"]) == 8, match["marks"] or ""
    flags = FD if len(match["length"]) == 2 else 0
    flags |= (BRS if "B" in marks else 0) | (ESI if "E" in marks else 0) if flags else 0
    can_id = number | EXTENDED if extended and not number & ERROR else number
    if match["what"] == "remote request":
        can_id, data = can_id | REMOTE, bytes(length)
    if number > (ERROR | EXTENDED_MASK if extended else STANDARD_MASK) or len(data) != length:
        return None
    if not _possible(length, flags):
        return None
    message = to_message(Frame(can_id, data, flags), float(match["time"] or 0.0), match["channel"])
    message.is_rx = match["way"] != "TX"
    return message


@contextlib.contextmanager
def write_log(file: Path) -> Iterator[Callable[[can.Message], None]]:
    """A context that takes messages for a log; .gz compresses. Raises OSError."""
    with gzip.open(file, "wt", encoding="ascii") if file.suffix == ".gz" else file.open("w", encoding="ascii") as log:

        def write(message: can.Message) -> None:
            way = "R" if message.is_rx else "T"
            channel = message.channel if message.channel not in (None, "") else "can0"
            log.write(f"({message.timestamp:.6f}) {channel} {frame_text(from_message(message))} {way}\n")

        yield write


def read_log(lines: Iterable[str]) -> Iterator[can.Message]:
    """The messages of a log's lines, oldest first. Raises TraceError naming the line that is none."""
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        message = read_line(line) or read_screen_line(line)
        if message is None:
            raise TraceError(f"line {number} is no frame of candump's: {line.strip()[:60]!r}")
        yield message


def _possible(length: int, flags: int) -> bool:
    return length in FD_LENGTHS if flags & FD else length <= 8
