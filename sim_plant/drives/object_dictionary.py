"""A CANopen node's object dictionary: what the EDS declares, the values it holds, and the checks of CiA 301 on both.

Every object is served as its file types it. Where a file gives an object another type than CiA 402 does, it is stored
and read like any other, and the drive behind it does not act by it.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from drivers.base.text_file import words_of
from drivers.eds.data_types import LARGEST_DATA, DataType, Kind, Value
from drivers.eds.reader import Eds, EdsError, read_eds
from drivers.families.cia402.cia301 import EDS, Abort
from sim_plant.drives.quirks import NO_QUIRKS, Quirks

LAST_DUMMY = 0x0007  # indexes up to it stand for data types: bytes of a PDO that are not for this node
_STORE = 8 * 2**20  # bytes of strings and domains that a node keeps, all together
_FIRST_OBJECT = 0x1000


class SdoAbort(Exception):
    """An access that the node refuses; `code` goes into the abort frame."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort {code:#010x}")
        self.code = code


class Entry(NamedTuple):
    """One variable of the EDS. default: a number, or the bytes of what is none. stated: the file gives it a value."""

    type: DataType
    readable: bool
    writable: bool
    mappable: bool
    low: int | float | None
    high: int | float | None
    default: int | float | bytes
    stated: bool = True

    @property
    def size(self) -> int:
        """Bytes of a number; 0 for a string or a domain."""
        return self.type.size


def key_of(index: int, subindex: int = 0) -> int:
    """Index and sub-index as one number."""
    return index << 8 | subindex


def _default(value: Value | None, kind: DataType) -> int | float | bytes:
    if value is None:
        return 0 if kind.size else b""
    return kind.pack(value) if isinstance(value, str) else value


class Described(NamedTuple):
    """What a file says of a node: its entries by `key_of`, its dummies, and whose device it is."""

    entries: dict[int, Entry]
    dummies: frozenset[int]
    vendor: str
    product: str


def described(eds: Path, node_id: int) -> Described:
    """The file for a node. Raises ValueError naming a file that cannot be read."""
    try:
        found = eds.stat()
        return _described(eds, node_id, found.st_mtime_ns, found.st_size)
    except EdsError as error:
        raise ValueError(str(error)) from None
    except OSError as error:
        raise ValueError(f"{eds}: {words_of(error)}") from None


@lru_cache(maxsize=64)
def _described(eds: Path, node_id: int, _changed_ns: int, _size: int) -> Described:
    file: Eds = read_eds(eds, node_id)
    entries = {}
    for place, entry in file.entries.items():
        default = _default(entry.value, entry.type)
        bounds = entry.readable, entry.writable, entry.mappable, entry.low, entry.high
        entries[key_of(*place)] = Entry(entry.type, *bounds, default, entry.value is not None)
    dummies = frozenset(dummy for dummy in file.dummies if 0 < dummy <= LAST_DUMMY)
    return Described(entries, dummies, file.vendor, file.product)


class ObjectDictionary:
    """Values of one node.

    values: current value per key, for the node itself to read and set. getters: objects computed when read. setters:
    called with the new value before it is stored; may raise SdoAbort, then nothing is stored. Both act on whole numbers
    alone. dummies: data types that an RPDO may map in place of objects. own: the file is that of the project's own
    drive. Raises ValueError for an EDS that cannot be read.
    """

    def __init__(self, node_id: int, eds: Path = EDS, quirks: Quirks = NO_QUIRKS) -> None:
        file = described(eds, node_id)
        ours = described(EDS, node_id)
        self.own = (file.vendor, file.product) == (ours.vendor, ours.product)
        self.dummies = set(file.dummies) if quirks.dummies else set()
        missing = quirks.missing
        self.entries = {k: e for k, e in file.entries.items() if k >= key_of(_FIRST_OBJECT) and k not in missing}
        self._aborts = quirks.aborts
        self._instead = quirks.instead
        self.values: dict[int, int | float | bytes] = {}
        self.getters: dict[int, Callable[[], int]] = {}
        self.setters: dict[int, Callable[[int], None]] = {}
        self._indexes = {key >> 8 for key in self.entries}
        self._stored = 0  # bytes of strings and domains
        self.restore(0x0000, 0xFFFF)

    def restore(self, first: int, last: int) -> None:
        """Set the objects from index `first` to `last` to their defaults."""
        for key, entry in self.entries.items():
            if first <= key >> 8 <= last:
                self._keep(key, entry.default)

    def fill_in(self, key: int, value: int) -> None:
        """Give an object that the drive has a value, where its file states none and its type can be that."""
        entry = self.entries.get(key)
        if entry is not None and not entry.stated and entry.type.kind is Kind.INTEGER:
            self.entries[key] = entry._replace(default=_wrapped(value, entry.type))
            self.values[key] = self.entries[key].default

    def entry(self, index: int, subindex: int) -> Entry:
        """Declaration of an object; SdoAbort where there is none."""
        key = key_of(index, subindex)
        if key in self._aborts:
            raise SdoAbort(self._aborts[key])
        entry = self.entries.get(key)
        if entry is None:
            raise SdoAbort(Abort.NO_SUBINDEX if index in self._indexes else Abort.NO_OBJECT)
        return entry

    def has(self, index: int, subindex: int) -> bool:
        """Whether there is such an object."""
        return key_of(index, subindex) in self.entries

    def number(self, key: int, absent: int = 0) -> int:
        """Value of a whole number; `absent` where the drive has no such object, or has something else there."""
        value = self.values.get(key, absent)
        return value if isinstance(value, int) else absent

    def set(self, key: int, value: int) -> None:
        """The node changes a number of its own, where it has that object."""
        entry = self.entries.get(key)
        if entry is not None and entry.type.kind is Kind.INTEGER:
            self.values[key] = _wrapped(value, entry.type)

    def get(self, key: int) -> int | float | bytes:
        """Current value, computed where it is a live one."""
        getter = self.getters.get(key)
        if getter is not None:
            data_type = self.entries[key].type
            if data_type.kind is Kind.INTEGER:
                return _wrapped(getter(), data_type)
        return self.values[key]

    def read(self, index: int, subindex: int) -> bytes:
        """Value as an SDO client gets it."""
        entry = self.entry(index, subindex)
        if not entry.readable:
            raise SdoAbort(Abort.WRITE_ONLY)
        key = key_of(index, subindex)
        value = self._instead.get(key, self.get(key))
        return value if isinstance(value, bytes) else entry.type.pack(value)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Take a value from an SDO client, within the EDS' type, access and limits."""
        entry = self.entry(index, subindex)
        if not entry.writable:
            raise SdoAbort(Abort.READ_ONLY)
        if not entry.size:
            self._take_data(key_of(index, subindex), data)
            return
        if len(data) != entry.size:
            raise SdoAbort(Abort.TOO_LONG if len(data) > entry.size else Abort.TOO_SHORT)
        value = entry.type.unpack(data)
        assert not isinstance(value, bytes)
        self.store(key_of(index, subindex), value)

    def store(self, key: int, value: int | float) -> None:
        """Set a numeric object to a value of its type, within its limits; SdoAbort else. What it holds already can
        always be written: a master that restores what it read meets no refusal.
        """
        try:
            self._check(self.entries[key], value)
            setter = self.setters.get(key)
            if setter is not None and isinstance(value, int):
                setter(value)
        except SdoAbort:
            if value != self.values[key]:
                raise
        self.values[key] = value

    def _check(self, entry: Entry, value: int | float) -> None:
        low, high = entry.type.range if entry.type.bits == 1 else (entry.low, entry.high)
        if high is not None and value > high:
            raise SdoAbort(Abort.VALUE_HIGH)
        if low is not None and value < low:
            raise SdoAbort(Abort.VALUE_LOW)

    def _take_data(self, key: int, data: bytes) -> None:
        """A string or a domain, as long as there is room for it."""
        if len(data) > LARGEST_DATA or self._stored + len(data) - self._length(key) > _STORE:
            raise SdoAbort(Abort.OUT_OF_MEMORY)
        self._keep(key, bytes(data))

    def _length(self, key: int) -> int:
        value = self.values.get(key)
        return len(value) if isinstance(value, bytes) else 0

    def _keep(self, key: int, value: int | float | bytes) -> None:
        self._stored += (len(value) if isinstance(value, bytes) else 0) - self._length(key)
        self.values[key] = value


def _wrapped(value: int, data_type: DataType) -> int:
    """A whole number in as many bits as its type has: what the node computes may be wider than the file's type."""
    low, high = data_type.range
    return value if low <= value <= high else (value - low) % (high - low + 1) + low
