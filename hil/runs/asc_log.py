"""Vector's text format (.asc) as recorded: any header, either base, absolute and relative times, remote and FD frames.

    0.100000 1  29A             Rx   d 2 98 01      a classic frame; decimal under "base dec"
    0.200000 1  18FEF200x       Tx   r 5            a remote frame of 29 bits that asks for five bytes
    0.300000 CANFD   1 Rx  29c  1 0 8  8 f8 62 01 00 ...  136 303040   an FD frame, its flags in hexadecimal at the end
    0.400000 1  ErrorFrame

Our own, as python-can 4.6 loses the frame behind a header without a trigger block, takes relative times for absolute
ones, and classic and remote frames in CANFD lines for FD frames. Lines of other events are passed over; a line that
begins as a frame does and is none is an error.
"""

import re
from collections.abc import Iterable, Iterator

import can

from drivers.frame import EXTENDED_MASK, STANDARD_MASK
from hil.runs.candump_log import TraceError

_TIME = r"\s*(?P<time>-?\d+(?:\.\d+)?)\s+"
_ID = r"(?P<id>[0-9A-Fa-f]+)(?P<long>[xX]?)"
_CLASSIC = re.compile(_TIME + rf"(?P<channel>\d+)\s+{_ID}\s+(?P<way>Rx|Tx|TxRq)\s+(?P<kind>[dr])(?P<rest>(?:\s.*)?)")
_FD = re.compile(
    _TIME + rf"CANFD\s+(?P<channel>\d+)\s+(?P<way>Rx|Tx|TxRq)\s+{_ID}\s+(?:(?P<name>\S*[G-Zg-z_]\S*)\s+)?"
    r"(?P<brs>[01])\s+(?P<esi>[01])\s+(?P<dlc>[0-9A-Fa-f])\s+(?P<length>\d+)(?P<rest>(?:\s.*)?)"
)
_ERROR = re.compile(_TIME + r"(?:CANFD\s+)?(?P<channel>\d+)\s+(?:(?:Rx|Tx)\s+)?ErrorFrame\b.*")
_FRAME = re.compile(_TIME + r"(?:CANFD\s+\d+\s+(?:Rx|Tx)\b|\d+\s+[0-9A-Fa-f]+[xX]?\s+(?:Rx|Tx)\b).*")
_HEADER = re.compile(r"\s*base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<times>absolute|relative))?.*", re.I)
_TIMED = re.compile(_TIME)
_FACTS = "Length"  # what is told behind a classic frame begins with it; a remote frame may have no length before it
_REMOTE, _EDL = 0x10, 0x1000  # flags of a CANFD line
_FLAGS_AT = 2  # behind the data: duration, length in bits, flags


def read_asc(lines: Iterable[str]) -> Iterator[can.Message]:
    """The messages of a file's lines. Raises TraceError naming the line."""
    base, relative, now = 16, False, 0.0
    for number, line in enumerate(lines, 1):
        header = _HEADER.fullmatch(line.rstrip())
        if header is not None:
            base = 10 if header["base"].lower() == "dec" else 16
            relative = (header["times"] or "").lower() == "relative"
            continue
        timed = _TIMED.match(line)
        if timed is None:
            continue
        now = float(timed["time"]) + (now if relative else 0.0)
        try:
            message = _message(line.rstrip(), base)
        except ValueError as error:
            raise TraceError(f"line {number}: {error}: {line.strip()[:60]!r}") from None
        if message is not None:
            message.timestamp = now
            yield message


def _message(line: str, base: int) -> can.Message | None:
    """The frame of a line, None for another event. Raises ValueError."""
    if (found := _ERROR.fullmatch(line)) is not None:
        return can.Message(is_error_frame=True, is_extended_id=False, channel=int(found["channel"]) - 1)
    if (found := _CLASSIC.fullmatch(line)) is not None:
        return _classic(found, base)
    if (found := _FD.fullmatch(line)) is not None:
        return _flexible(found)
    if _FRAME.fullmatch(line):
        raise ValueError("this is no frame")
    return None


def _made(found: re.Match[str], base: int) -> can.Message:
    number, extended = int(found["id"], base), bool(found["long"])
    if number > (EXTENDED_MASK if extended else STANDARD_MASK):
        raise ValueError(f"identifier {found['id']} is too large")
    return can.Message(
        arbitration_id=number,
        is_extended_id=extended,
        channel=int(found["channel"]) - 1,
        is_rx=found["way"] == "Rx",
    )


def _classic(found: re.Match[str], base: int) -> can.Message:
    message, words = _made(found, base), found["rest"].split()
    message.is_remote_frame = found["kind"] == "r"
    message.dlc = int(words[0], 16) if words and words[0] != _FACTS else 0
    if message.is_remote_frame:
        return message
    message.dlc = min(message.dlc, 8)
    message.data = _bytes(words[1 : 1 + message.dlc], message.dlc, base)
    return message


def _flexible(found: re.Match[str]) -> can.Message:
    message, words = _made(found, 16), found["rest"].split()
    length = int(found["length"])
    behind = words[length:]
    flags = int(behind[_FLAGS_AT], 16) if len(behind) > _FLAGS_AT else _EDL
    message.is_fd = bool(flags & _EDL)
    if not message.is_fd and flags & _REMOTE:
        message.is_remote_frame, message.dlc = True, int(found["dlc"], 16)
        return message
    message.bitrate_switch = message.is_fd and found["brs"] == "1"
    message.error_state_indicator = message.is_fd and found["esi"] == "1"
    message.data, message.dlc = _bytes(words[:length], length, 16), length
    return message


def _bytes(words: list[str], length: int, base: int) -> bytearray:
    if len(words) != length:
        raise ValueError(f"{len(words)} of {length} bytes")
    return bytearray(int(word, base) for word in words)
