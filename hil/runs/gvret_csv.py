"""Comma-separated logs of GVRET devices and of SavvyCAN (.csv): microseconds, and bytes in hexadecimal.

    Time Stamp,ID,Extended,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    166064000,0000021A,false,0,7,FE,36,12,FE,69,05,07,00,  bytes behind the length mean nothing
    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,...              the second version says who sent it

The format has no place for remote, error and FD frames; a frame of more than eight bytes is one of CAN FD. The devices'
clock begins anew after 2^32 microseconds: times go on. A line that is no frame is an error.
"""

from collections.abc import Iterable, Iterator

import can

from drivers.frame import EXTENDED_MASK, STANDARD_MASK
from hil.runs.candump_log import TraceError

HEAD = "Time Stamp,ID,Extended,"
_WRAP_US = 2**32
_TRUTH = {"true": True, "false": False}


def read_gvret(lines: Iterable[str]) -> Iterator[can.Message]:
    """The messages of a log's lines, its head among them. Raises TraceError naming the line."""
    directed, turns_us, last_us = False, 0, 0
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if text.startswith(HEAD):
            directed = text.startswith(HEAD + "Dir,")
            continue
        if not text:
            continue
        try:
            message, at_us = _message(text.rstrip(",").split(","), directed)
        except (ValueError, KeyError, IndexError) as error:
            raise TraceError(f"line {number} is no frame: {error}: {text[:60]!r}") from None
        if at_us < last_us - _WRAP_US // 2 and last_us < _WRAP_US:
            turns_us += _WRAP_US
        last_us = at_us
        message.timestamp = (at_us + turns_us) * 1e-6
        yield message


def _message(words: list[str], directed: bool) -> tuple[can.Message, int]:
    """The frame of a line, and its time, us. Raises ValueError, KeyError, IndexError."""
    at_us, number, extended = int(words[0]), int(words[1], 16), _TRUTH[words[2].lower()]
    if not 0 <= number <= (EXTENDED_MASK if extended else STANDARD_MASK):
        raise ValueError(f"identifier {words[1]} of {29 if extended else 11} bits")
    received = not directed or words[3].lower().startswith("r")
    channel, length, *data = words[4 if directed else 3 :]
    if not 0 <= int(length) <= len(data):
        raise ValueError(f"{len(data)} of {length} bytes")
    return can.Message(
        arbitration_id=number,
        is_extended_id=extended,
        is_fd=int(length) > 8,
        is_rx=received,
        channel=int(channel),
        data=bytes(int(word, 16) for word in data[: int(length)]),
    ), at_us
