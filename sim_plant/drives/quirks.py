"""What makes one maker's CiA 402 drive another than the next: chosen for the emulated drive, beside its EDS."""

from collections.abc import Mapping
from typing import NamedTuple


class Quirks(NamedTuple):
    """missing: objects (key_of) that the file has and the drive has not. aborts: SDO abort code by object written or
    read. answer_delay_ns: of every SDO answer. enable_delay_ns: from the command to OPERATION ENABLED. status_bits:
    manufacturer's bits of the statusword, always set (8, 14, 15). dummies: RPDOs may map dummy objects where the file
    says so.
    """

    missing: frozenset[int] = frozenset()
    aborts: Mapping[int, int] = {}
    answer_delay_ns: int = 0
    enable_delay_ns: int = 0
    status_bits: int = 0
    dummies: bool = True


NO_QUIRKS = Quirks()
