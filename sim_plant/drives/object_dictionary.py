"""A CANopen node's object dictionary: what the EDS declares, the values it holds, and the checks of CiA 301 on both."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from struct import Struct
from types import MappingProxyType
from typing import Any, NamedTuple

import canopen

from drivers.protocols.canopen.cia301 import BASIC_TYPES, EDS, Abort
from sim_plant.drives.quirks import NO_QUIRKS, Quirks

MAX_STRING = 256  # bytes
LAST_DUMMY = 0x0007  # indexes up to it stand for data types: bytes of a PDO that are not for this node


class SdoAbort(Exception):
    """An access that the node refuses; `code` goes into the abort frame."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort {code:#010x}")
        self.code = code


class Entry(NamedTuple):
    """One variable of the EDS. layout: None for a string. stated: the file gives it a value."""

    layout: Struct | None
    readable: bool
    writable: bool
    mappable: bool
    low: int | None
    high: int | None
    default: Any
    stated: bool = True


def key_of(index: int, subindex: int = 0) -> int:
    """Index and sub-index as one number."""
    return index << 8 | subindex


def _entry(variable: Any) -> Entry:
    code = BASIC_TYPES.get(variable.data_type)
    layout = Struct("<" + code) if code else None
    stated = variable.value if variable.value is not None else variable.default
    default = stated if stated is not None else 0
    if layout is None:
        default = str(stated or "").encode()
    low, high = variable.min, variable.max
    if low is not None and high is not None and low > high:
        low = high = None  # makers write the limits of unsigned objects as if they were signed
    return Entry(
        layout, variable.readable, variable.writable, variable.pdo_mappable, low, high, default, stated is not None
    )


@lru_cache(maxsize=256)
def load_entries(eds: Path, node_id: int) -> MappingProxyType[int, Entry]:
    """Every variable of an EDS or DCF file for a node, by `key_of` its index and sub-index; the dummy objects that it
    allows are among them. Raises ValueError naming a file that cannot be read.
    """
    try:
        dictionary = canopen.import_od(str(eds), node_id)
    except Exception as error:  # whatever the package's parser makes of a file from the field
        raise ValueError(f"{eds}: the emulated drive cannot read it: {type(error).__name__}: {error}") from None
    entries: dict[int, Entry] = {}
    for index in dictionary:
        item = dictionary[index]
        members = [item] if isinstance(item, canopen.objectdictionary.ODVariable) else item.values()
        for variable in members:
            entries[key_of(index, variable.subindex)] = _entry(variable)
    return MappingProxyType(entries)


class ObjectDictionary:
    """Values of one node.

    values: current value per key, for the node itself to read and set. getters: objects computed when read. setters:
    called with the new value before it is stored; may raise SdoAbort, then nothing is stored. dummies: data types that
    an RPDO may map in place of objects. Raises ValueError for an EDS that cannot be read.
    """

    def __init__(self, node_id: int, eds: Path = EDS, quirks: Quirks = NO_QUIRKS) -> None:
        entries = load_entries(eds, node_id)
        self.dummies = {key >> 8 for key in entries if 0x100 < key <= LAST_DUMMY << 8} if quirks.dummies else set()
        self.entries = {key: e for key, e in entries.items() if key > 0xFF << 8 and key not in quirks.missing}
        self._aborts = quirks.aborts
        self.values: dict[int, Any] = {}
        self.getters: dict[int, Callable[[], int]] = {}
        self.setters: dict[int, Callable[[int], None]] = {}
        self._indexes = {key >> 8 for key in self.entries}
        self.restore(0x0000, 0xFFFF)

    def restore(self, first: int, last: int) -> None:
        """Set the objects from index `first` to `last` to their defaults."""
        for key, entry in self.entries.items():
            if first <= key >> 8 <= last:
                self.values[key] = entry.default

    def fill_in(self, key: int, value: int) -> None:
        """Give an object that the drive has a value, where its file states none."""
        entry = self.entries.get(key)
        if entry is not None and not entry.stated:
            self.entries[key] = entry._replace(default=value)
            self.values[key] = value

    def entry(self, index: int, subindex: int) -> Entry:
        """Declaration of an object; SdoAbort where there is none."""
        key = key_of(index, subindex)
        if key in self._aborts:
            raise SdoAbort(self._aborts[key])
        entry = self.entries.get(key)
        if entry is None:
            raise SdoAbort(Abort.NO_SUBINDEX if index in self._indexes else Abort.NO_OBJECT)
        return entry

    def number(self, key: int, absent: int = 0) -> int:
        """Value of a number; `absent` where the drive has no such object."""
        return int(self.values.get(key, absent))

    def get(self, key: int) -> Any:
        """Current value, computed where it is a live one."""
        getter = self.getters.get(key)
        return getter() if getter else self.values[key]

    def read(self, index: int, subindex: int) -> bytes:
        """Value as an SDO client gets it."""
        entry = self.entry(index, subindex)
        if not entry.readable:
            raise SdoAbort(Abort.WRITE_ONLY)
        value = self.get(key_of(index, subindex))
        return entry.layout.pack(value) if entry.layout else bytes(value)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Take a value from an SDO client, within the EDS' type, access and limits."""
        entry = self.entry(index, subindex)
        if not entry.writable:
            raise SdoAbort(Abort.READ_ONLY)
        if entry.layout is None:
            self.values[key_of(index, subindex)] = data
            return
        if len(data) != entry.layout.size:
            raise SdoAbort(Abort.TOO_LONG if len(data) > entry.layout.size else Abort.TOO_SHORT)
        self.store(key_of(index, subindex), entry.layout.unpack(data)[0])

    def store(self, key: int, value: Any) -> None:
        """Set a numeric object to a value of its type, within its limits; SdoAbort else."""
        entry = self.entries[key]
        if entry.high is not None and value > entry.high:
            raise SdoAbort(Abort.VALUE_HIGH)
        if entry.low is not None and value < entry.low:
            raise SdoAbort(Abort.VALUE_LOW)
        setter = self.setters.get(key)
        if setter:
            setter(value)
        self.values[key] = value
