"""What makes one maker's CiA 402 drive another than the next: chosen for the emulated drive, beside its EDS."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drivers.families.cia402.config import ObjectValue
from sim_plant.config import EmulatedDriveConfig

_GENERAL_ERROR = 0x08000000  # SDO abort code


class Quirks(NamedTuple):
    """missing: objects (key_of) that the file has and the drive has not. aborts: SDO abort code by object written or
    read. answer_delay_ns: of every SDO answer. enable_delay_ns: from the command to OPERATION ENABLED. status_bits:
    manufacturer's bits of the statusword, always set (8, 14, 15). dummies: RPDOs may map dummy objects where the file
    says so. answers: how numbers are uploaded: expedited, unsized (expedited, without telling their size) or segmented;
    CiA 301 leaves that to the drive. block: expedited, and what is longer than four bytes by blocks alone. instead:
    value by object that an SDO client reads, whatever was written and acknowledged.
    """

    missing: frozenset[int] = frozenset()
    aborts: Mapping[int, int] = {}
    answer_delay_ns: int = 0
    enable_delay_ns: int = 0
    status_bits: int = 0
    dummies: bool = True
    answers: str = "expedited"
    instead: Mapping[int, int] = {}


NO_QUIRKS = Quirks()


def stated_quirks(config: EmulatedDriveConfig | None) -> Quirks:
    """Of a [plant.drive] table; none without one."""
    if config is None:
        return NO_QUIRKS
    return Quirks(
        frozenset(_keys(config.missing)),
        dict.fromkeys(_keys(config.aborts), _GENERAL_ERROR),
        round(config.answer_delay_s * 1e9),
        round(config.enable_delay_s * 1e9),
        config.status_bits,
        config.dummy_mapping,
        config.answers,
        {_keys([place])[0]: round(value) for place, value in config.instead.items()},
    )


def _keys(places: Sequence[str]) -> list[int]:
    """Dictionary keys of objects as a table names them: index and sub-index as one number."""
    stated = [ObjectValue(object=place, value=0).place for place in places]
    return [index << 8 | subindex for index, subindex in stated]
