"""BUSMASTER's log files (.log), in either base, with absolute, system and relative times.

    ***HEX***
    ***SYSTEM MODE***
    11:49:12:9420 Rx 1 0x023 s 1 40                     a classic frame; four digits are tenths of a millisecond
    11:49:12:9440 Tx 1 0x18FEF200 x 2 01 02             29 bits
    11:49:12:9450 Rx 1 0x408 sr 8                       a remote frame; bytes behind it mean nothing
    11:49:12:9460 Rx 1 0x408 s-fd 12 01 02 ...          a CAN FD frame

Lines between three stars say what the log is like. SavvyCAN writes this format, too, with milliseconds in three digits.
A log that passes midnight goes on with the next day. A line that is no frame is an error.
"""

import re
from collections.abc import Iterable, Iterator

import can

from drivers.frame import EXTENDED_MASK, STANDARD_MASK
from hil.runs.candump_log import TraceError

HEAD = "***"
_DAY_S = 86_400.0
_LINE = re.compile(
    r"(?P<hours>\d+):(?P<minutes>\d+):(?P<seconds>\d+):(?P<part>\d+)\s+(?P<way>[TR]x)\s+(?P<channel>\d+)\s+"
    r"(?P<id>(?:0x)?[0-9A-Fa-f]+)\s+(?P<kind>[sx])(?P<what>r|-fd|)\s+(?P<length>\d+)(?P<data>(?:\s+[0-9A-Fa-f]+)*)\s*"
)


def read_busmaster(lines: Iterable[str]) -> Iterator[can.Message]:
    """The messages of a log's lines; times in seconds of the day, or since its start. Raises TraceError naming the
    line.
    """
    base, relative, days, now = 16, False, 0, 0.0
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if text.startswith("***"):
            base = {"***DEC***": 10, "***HEX***": 16}.get(text, base)
            relative = text == "***RELATIVE MODE***" or (relative and not text.endswith(" MODE***"))
            if text.startswith("***PROTOCOL") and text != "***PROTOCOL CAN***":
                raise TraceError(f"line {number}: a log of {text.strip('*')[9:]}: those of PROTOCOL CAN are read")
            continue
        if not text:
            continue
        try:
            message, at = _message(text, base)
        except ValueError as error:
            raise TraceError(f"line {number}: {error}: {text[:60]!r}") from None
        if relative:
            now += at
        else:
            days += at + days * _DAY_S < now - _DAY_S / 2
            now = at + days * _DAY_S
        message.timestamp = now
        yield message


def _message(text: str, base: int) -> tuple[can.Message, float]:
    """The frame of a line, and its time, s. Raises ValueError."""
    found = _LINE.fullmatch(text)
    if found is None:
        raise ValueError("this is no frame")
    number, extended = int(found["id"].removeprefix("0x"), base), found["kind"] == "x"
    if number > (EXTENDED_MASK if extended else STANDARD_MASK):
        raise ValueError(f"identifier {found['id']} is too large")
    length, words, remote = int(found["length"]), found["data"].split(), found["what"] == "r"
    words = [] if remote else words
    if len(words) != length and not remote:
        raise ValueError(f"{len(words)} of {length} bytes")
    message = can.Message(
        arbitration_id=number,
        is_extended_id=extended,
        is_remote_frame=remote,
        is_fd=found["what"] == "-fd",
        is_rx=found["way"] == "Rx",
        channel=int(found["channel"]),
        dlc=length,
        data=bytes(int(word, base) for word in words),
    )
    part = int(found["part"]) / 10 ** len(found["part"])
    return message, 3600.0 * int(found["hours"]) + 60.0 * int(found["minutes"]) + int(found["seconds"]) + part
