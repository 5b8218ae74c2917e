"""The numbers of endpoints from an ODrive's flat_endpoints.json, in the place of those in a DBC file.

Source: ODrive's manual, page "CAN Protocol", RxSdo and TxSdo: a firmware numbers its endpoints anew, and its
flat_endpoints.json says {"endpoints": {PATH: {"id": NUMBER, "type": "float"}}}.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from struct import pack, unpack_from
from typing import Any, Final, NamedTuple

from cantools.database.can import Database

from drivers.base.text_file import UnsuitableFileError, read_bounded
from drivers.families.dbc.config import DbcBinding, ReadBackBinding
from drivers.protocols.base import LayoutError

LARGEST: Final = 4 << 20  # bytes
_MOST_ID: Final = 0xFFFF
_MOST_FLOAT: Final = 3.4e38  # of four bytes
_TYPES: Final[Mapping[str, tuple[int, str]]] = {  # bits, and how they are read
    "bool": (8, "unsigned"),
    "float": (32, "float"),
    **{f"uint{bits}": (bits, "unsigned") for bits in (8, 16, 32, 64)},
    **{f"int{bits}": (bits, "signed") for bits in (8, 16, 32, 64)},
}


class Endpoint(NamedTuple):
    """number: 0 to 65535. bits, form: of its value; form is unsigned, signed or float."""

    number: int
    bits: int
    form: str

    def packed(self, value: float) -> bytes:
        """A value as a frame carries it, the nearest that it can."""
        if self.form == "float":
            return pack("<f", max(-_MOST_FLOAT, min(_MOST_FLOAT, value)))
        return int(value).to_bytes(self.bits // 8, "little", signed=self.form == "signed")

    def value(self, data: bytes) -> float:
        """Of the bytes that a frame carries."""
        if self.form == "float":
            return float(unpack_from("<f", data)[0])
        return int.from_bytes(data[: self.bits // 8], "little", signed=self.form == "signed")


def known_endpoints(file: Path, paths: Iterable[str]) -> dict[str, Endpoint | None]:
    """Those of a flat_endpoints.json by their paths, None where it has none with a number and a type. Raises
    LayoutError.
    """
    known = _read(file)
    return {path: _endpoint(known.get(path)) for path in paths}


def number_pages(database: Database, binding: DbcBinding, folder: Path) -> None:
    """Give the signals that are read back the numbers of their endpoints. Raises LayoutError naming what does not fit:
    the file, a path that it has not, another type, two signals of a message with one number.
    """
    stated = [at for at, item in enumerate(binding.read_back) if item.endpoint]
    if bool(stated) != bool(binding.endpoints):
        raise LayoutError(
            "bus.dbc.endpoints names a file with the numbers of the `endpoint`s of bus.dbc.read_back: state both"
        )
    if not stated:
        return
    known = _read(folder / binding.endpoints)
    numbered: dict[tuple[str, str], int] = {}
    for at in stated:
        item = binding.read_back[at]
        numbered[item.message, item.signal] = _number(database, item, f"bus.dbc.read_back[{at}]", known, binding)
    _refuse_doubles(database, numbered)


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(read_bounded(path, LARGEST))
        known = document["endpoints"]
    except (OSError, UnsuitableFileError) as error:
        said = error.strerror if isinstance(error, OSError) else str(error)
        raise LayoutError(f"bus.dbc.endpoints: {path}: {said}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise LayoutError(f"bus.dbc.endpoints: {path} is no flat_endpoints.json: it has no table `endpoints`") from None
    if not isinstance(known, dict):
        raise LayoutError(f"bus.dbc.endpoints: {path} is no flat_endpoints.json: `endpoints` is no table")
    return known


def _number(database: Database, item: ReadBackBinding, key: str, known: Mapping[str, Any], binding: DbcBinding) -> int:
    """Put the number into the signal of an entry."""
    endpoint = _endpoint(known.get(item.endpoint))
    if endpoint is None:
        raise LayoutError(f"{key}.endpoint: {binding.endpoints} has no {item.endpoint!r} with a number and a type")
    message = next((one for one in database.messages if one.name == item.message), None)
    signal = next((one for one in message.signals if one.name == item.signal), None) if message else None
    if signal is None or signal.multiplexer_signal is None:
        raise LayoutError(f"{key}.endpoint: {item.message}.{item.signal} is no signal of a page with a number")
    form = "float" if signal.is_float else "signed" if signal.is_signed else "unsigned"
    if (signal.length, form) != (endpoint.bits, endpoint.form):
        raise LayoutError(
            f"{key}.endpoint: {item.endpoint} has {endpoint.bits} bits, {endpoint.form}; "
            f"{item.message}.{item.signal} has {signal.length}, {form}"
        )
    signal.multiplexer_ids = [endpoint.number]
    return endpoint.number


def _endpoint(entry: Any) -> Endpoint | None:
    number, name = (entry.get("id"), entry.get("type")) if isinstance(entry, dict) else (None, None)
    if type(number) is not int or not 0 <= number <= _MOST_ID or not isinstance(name, str) or name not in _TYPES:
        return None
    return Endpoint(number, *_TYPES[name])


def _refuse_doubles(database: Database, numbered: Mapping[tuple[str, str], int]) -> None:
    """Two signals of one page would be one behind the other."""
    for message in database.messages:
        seen: dict[int, str] = {}
        for signal in message.signals:
            for number in signal.multiplexer_ids or ():
                other = seen.setdefault(number, str(signal.name))
                if other != signal.name and numbered.keys() & {(message.name, other), (message.name, signal.name)}:
                    raise LayoutError(
                        f"bus.dbc.endpoints: {message.name}.{other} and {signal.name} both have number {number}; "
                        "give the one that is not read back another number in the DBC file"
                    )
