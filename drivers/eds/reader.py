"""Electronic data sheets (EDS) and device configuration files (DCF), CiA 306-1: what a device's own file says of it.

Rules. Files from the field are read as far as they can be. A value that is broken costs that value, an entry without
type or access that entry; both are warnings, and code that needs the entry is told why (`Eds.broken`). Read are
variables and the members of records and arrays, in compact storage too, with what its sections of names and values say.

A DCF was written for one node. For another one, the values that the file derives from $NODEID move with the node, and
so do identifiers of the predefined connection set (CiA 301, 7.3.5) that contain the file's own node. Both are told.

Why not the canopen package's reader, which knows the same format: it gives up a whole file for one missing key, a
miscounted comment or a section that comes twice. It gives up signed limits of 24 to 56 bits, and reads no octal number,
no values of compact arrays and no file that is not UTF-8. It hands on defaults that their type cannot hold.
"""

import re
from pathlib import Path
from typing import NamedTuple

from drivers.base.text_file import UnsuitableFileError, read_bounded
from drivers.eds.data_types import DATA_TYPES, DOMAIN, UNSIGNED8, DataType, Kind, Value, integer
from drivers.eds.own_node import moved_values
from drivers.eds.sections import Sections, read_sections

_LARGEST = 4 * 2**20  # bytes; the longest public EDS we know has 0.6 MB
_SECTION = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?")
_NULL, _DOMAIN_OBJECT, _DEFINITION, _STRUCTURE, _VARIABLE, _ARRAY, _RECORD = 0x0, 0x2, 0x5, 0x6, 0x7, 0x8, 0x9
_ACCESS = ("ro", "wo", "rw", "rwr", "rww", "const")
_MOST_MEMBERS = 0xFE


class EdsError(ValueError):
    """The file cannot be read as an EDS at all; the text says why."""


class Entry(NamedTuple):
    """One value of the object dictionary.

    data_type: number of CiA 301, table 44. access: ro, wo, rw, rwr, rww or const. value: of the file, a DCF's own value
    before the default; None where it has no usable one. low, high: limits of the file, None where it has none.
    """

    name: str
    data_type: int
    access: str
    value: Value | None
    low: int | float | None
    high: int | float | None
    mappable: bool

    @property
    def type(self) -> DataType:
        """Its data type."""
        return DATA_TYPES[self.data_type]

    @property
    def size(self) -> int:
        """Bytes of a number; 0 where it is something else (a string, a domain)."""
        return self.type.size

    def holds(self, value: int) -> bool:
        """Whether its data type has room for a number, signed or not."""
        return self.size > 0 and -(1 << 8 * self.size - 1) <= value < 1 << 8 * self.size

    @property
    def readable(self) -> bool:
        """Can be read over SDO."""
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        """Can be written over SDO."""
        return "w" in self.access


class Eds:
    """The object dictionary of one device.

    vendor, product: as [DeviceInfo] has them; name: both, for people. warnings: what was read over. broken: why an
    entry that the file has is not among the entries. dummies: data types it lets an RPDO map as dummies. bitrates:
    kbit/s it names, True where it can. own_node, own_bitrate: node and kbit/s that a DCF was written for, or None.
    """

    def __init__(self, text: str, node_id: int) -> None:
        """node_id: put in place of $NODEID. Raises EdsError where the text has no object at all."""
        self.warnings: list[str] = []
        self.broken: dict[tuple[int, int], str] = {}
        self.entries: dict[tuple[int, int], Entry] = {}
        self.node_id = node_id
        self._sections = sections = read_sections(text, self.warnings)
        info = sections.get("deviceinfo", {})
        self.vendor, self.product = info.get("vendorname", ""), info.get("productname", "")
        named = (
            self.product if self.product.lower().startswith(self.vendor.lower()) else f"{self.vendor} {self.product}"
        )
        self.name = named.strip() or self.vendor or "unnamed"
        rates = {key: value for key, value in info.items() if re.fullmatch(r"baudrate_\d+", key)}
        self.bitrates = {int(key[9:]): self._flag(key, value) for key, value in rates.items()}
        usage = sections.get("dummyusage", {})
        dummies = {key: value for key, value in usage.items() if re.fullmatch("dummy[0-9a-f]{4}", key)}
        self.dummies = {int(key[5:], 16) for key, value in dummies.items() if self._flag(key, value)}
        self._commission(sections.get("devicecomissioning") or sections.get("devicecommissioning") or {})
        for name, keys in sections.items():
            match = _SECTION.fullmatch(name)
            if match:
                self._read(int(match[1], 16), match[2], keys)
        if not self.entries:
            raise EdsError("no object in it: not an EDS or DCF file")
        self._move()

    def entry(self, index: int, subindex: int = 0) -> Entry | None:
        """The entry; None where the file has no usable one."""
        return self.entries.get((index, subindex))

    def value(self, index: int, subindex: int = 0) -> int | None:
        """The whole number that the file gives an entry; None where it gives none."""
        entry = self.entries.get((index, subindex))
        return entry.value if entry is not None and isinstance(entry.value, int) else None

    def bitrate_notes(self, bitrate: int | None = None) -> list[str]:
        """What is open about the bit rate of a bus, bit/s, None where that is not known."""
        rate = bitrate // 1000 if bitrate is not None else self.own_bitrate
        notes = []
        if not any(self.bitrates.values()) and self.own_bitrate is None:
            notes.append("the file names no bit rate: whether the drive has that of the bus is to be seen")
        if self.own_bitrate not in (None, rate):
            notes.append(f"the file was written for {self.own_bitrate} kbit/s; the bus has {rate} kbit/s")
        return notes

    def rules_out(self, bitrate: int) -> bool:
        """The file names bit rates, and this one (bit/s) is none of them."""
        rate = bitrate // 1000
        return self.bitrates.get(rate) is False and any(self.bitrates.values()) and self.own_bitrate != rate

    # parts of the file ------------------------------------------------------------------------------------------------

    def _flag(self, key: str, text: str) -> bool:
        """A key that is 0 or 1; broken, it is 0."""
        return bool(self._whole(text, key) or 0)

    def _whole(self, text: str | None, where: str) -> int | None:
        """A number of the file's own book-keeping; None where there is none, or none that can be read."""
        if not text:
            return None
        try:
            return integer(text, self.node_id)
        except ValueError as error:
            self.warnings.append(f"{where}: {error}")
            return None

    def _commission(self, keys: dict[str, str]) -> None:
        """[DeviceComissioning], as CiA 306 spells it: the node and the bit rate that a DCF was written for."""
        node = self._whole(keys.get("nodeid"), "DeviceComissioning: NodeID")
        self.own_node = node if node is not None and 1 <= node <= 127 else None
        if node is not None and self.own_node is None and node not in (0, 255):  # not configured
            self.warnings.append(f"DeviceComissioning: NodeID = {node} is none of 1 to 127")
        self.own_bitrate = self._whole(keys.get("baudrate"), "DeviceComissioning: Baudrate") or None

    def _read(self, index: int, sub: str | None, keys: dict[str, str]) -> None:
        """The entry, or entries, of one section."""
        subindex = int(sub, 16) if sub else 0
        where = object_name(index, subindex)
        kind = self._whole(keys.get("objecttype"), f"{where}: ObjectType")
        compact = self._whole(keys.get("compactsubobj"), f"{where}: CompactSubObj") if sub is None else None
        members = kind in (_ARRAY, _RECORD) or (kind is None and "datatype" not in keys and "subnumber" in keys)
        if kind in (_NULL, _DEFINITION, _STRUCTURE) or (sub is None and members and not compact):
            return
        try:
            if compact:
                self._read_compact(index, min(compact, _MOST_MEMBERS), keys)
            else:
                self.entries[index, subindex] = self._entry(where, keys, kind or _VARIABLE)
        except ValueError as error:
            self.broken[index, subindex] = str(error)
            self.warnings.append(f"{where}: {error}")

    def _read_compact(self, index: int, count: int, keys: dict[str, str]) -> None:
        """An array in compact storage (CiA 306-1, 4.6.3.2): one description for all, names and values in sections."""
        template = self._entry(object_name(index), keys, _VARIABLE)
        names, values = (self._members(index, suffix) for suffix in ("name", "value"))
        self.entries[index, 0] = Entry("entries", UNSIGNED8, "ro", count, None, None, False)
        for member in range(1, count + 1):
            value = template.value
            if member in values:
                value = self._value(object_name(index, member), template.type, values[member], "value")
            name = names.get(member, f"{template.name}_{member:x}")
            self.entries[index, member] = template._replace(name=name, value=value)

    def _members(self, index: int, suffix: str) -> dict[int, str]:
        """What the section of names or values of a compact array says, by sub-index."""
        found = {}
        for key, text in self._sections.get(f"{index:04x}{suffix}", {}).items():
            member = self._whole(key, f"[{index:04X}{suffix}]") if key != "nrofentries" else None
            if member is not None and text:
                found[member] = text
        return found

    def _entry(self, where: str, keys: dict[str, str], kind: int) -> Entry:
        data_type = self._data_type(where, keys.get("datatype"), kind)
        access = keys.get("accesstype", "rw" if kind == _DOMAIN_OBJECT else "").lower()
        if access not in _ACCESS:
            raise ValueError(f"AccessType = {access!r}, which is none of CiA 306's")
        stated = "ParameterValue" if keys.get("parametervalue") else "DefaultValue"
        low, high = self._limits(where, data_type, keys)
        return Entry(
            name=keys.get("parametername", ""),
            data_type=data_type.number,
            access=access,
            value=self._value(where, data_type, keys.get(stated.lower()), stated),
            low=low,
            high=high,
            mappable=bool(self._whole(keys.get("pdomapping"), f"{where}: PDOMapping")),
        )

    def _data_type(self, where: str, text: str | None, kind: int) -> DataType:
        if not text:
            if kind == _DOMAIN_OBJECT:
                return DATA_TYPES[DOMAIN]
            raise ValueError("has no DataType")
        number = integer(text)
        known = DATA_TYPES.get(number)
        if known is None:  # some editors define a type of its own with limits: its first member names the real one
            basis = self._sections.get(f"{number:x}sub1", {}).get("defaultvalue")
            known = DATA_TYPES.get(self._whole(basis, f"[{number:X}sub1]") or 0)
        if known is None:
            self.warnings.append(f"{where}: DataType = {text[:20]}, which CiA 301 does not have: taken as bytes")
            known = DATA_TYPES[DOMAIN]
        return known

    def _value(self, where: str, data_type: DataType, text: str | None, key: str) -> Value | None:
        """A value of the file; None, with a warning, where its type cannot be that."""
        if not text:
            return None
        try:
            return data_type.parse(text, self.node_id)
        except ValueError as error:
            self.warnings.append(f"{where}: {key}: {error}")
            return None

    def _limits(
        self, where: str, data_type: DataType, keys: dict[str, str]
    ) -> tuple[int | float | None, int | float | None]:
        if data_type.kind not in (Kind.INTEGER, Kind.REAL):
            return None, None
        found: list[int | float | None] = []
        for key in ("lowlimit", "highlimit"):
            value = self._value(where, data_type, keys.get(key), "LowLimit" if key == "lowlimit" else "HighLimit")
            found.append(value if isinstance(value, int | float) else None)
        low, high = found
        if low is not None and high is not None and low > high:
            self.warnings.append(f"{where}: LowLimit = {low} is above HighLimit = {high}: it counts as without limits")
            return None, None
        return low, high

    def _move(self) -> None:
        """A DCF for another node than the one asked for."""
        if self.own_node in (None, self.node_id):
            return
        assert self.own_node is not None
        moved = moved_values(self._sections, self.own_node, self.node_id)
        for place, value in moved.items():
            entry = self.entries.get(place)
            if entry is not None and isinstance(entry.value, int) and entry.value != value:
                self.entries[place] = entry._replace(value=value)
        named = ", ".join(object_name(*place) for place in sorted(moved)) or "nothing"
        text = f"the file was written for node {self.own_node}; read for node {self.node_id}, with the node moved in"
        self.warnings.insert(0, f"{text} {named}")


def read_eds(path: Path, node_id: int = 1) -> Eds:
    """Read an EDS or DCF file: UTF-8, UTF-16 with a byte order mark, or Latin-1.

    Raises EdsError naming the file, OSError where it cannot be read.
    """
    try:
        data = read_bounded(path, _LARGEST)
    except UnsuitableFileError as error:
        raise EdsError(f"{path}: not an EDS or DCF file: {error}") from None
    try:
        return Eds(_decoded(data), node_id)
    except EdsError as error:
        raise EdsError(f"{path}: {error}") from None


def _decoded(data: bytes) -> str:
    encodings = ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ()
    for encoding in (*encodings, "utf-8-sig"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1")


def object_name(index: int, subindex: int = 0) -> str:
    """An object as the standards write it: 1A00h:01."""
    return f"{index:04X}h:{subindex:02X}"


__all__ = ["Eds", "EdsError", "Entry", "Sections", "object_name", "read_eds"]
