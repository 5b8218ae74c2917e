"""Electronic data sheets (EDS) and device configuration files (DCF), CiA 306-1: what a drive's own file says of it.

Rules. Files from the field are read as far as they can be: duplicate sections, stray lines and broken entries are
warnings, and a broken entry counts as absent. Whoever needs that entry is told why it is (`Eds.broken`).

Read are variables and the members of records and arrays, compact storage included: data type, access, limits, whether
it can be mapped into a PDO, and its value (ParameterValue of a DCF, else DefaultValue), with $NODEID filled in.
"""

import re
from pathlib import Path
from struct import calcsize
from typing import NamedTuple

from drivers.protocols.canopen.cia301 import BASIC_TYPES
from drivers.text_file import UnsuitableFileError, read_bounded

_LARGEST = 4 * 2**20  # bytes; the longest public EDS we know has 0.6 MB
_SECTION = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?")
_VARIABLE, _ARRAY, _RECORD = 0x7, 0x8, 0x9
_UNSIGNED8 = 0x05


class EdsError(ValueError):
    """The file cannot be read as an EDS at all; the text says why."""


class Entry(NamedTuple):
    """One value of the object dictionary.

    data_type: number of CiA 301, table 44. access: ro, wo, rw, rwr, rww or const. value: of the file, None where it has
    none (or one that is no integer). low, high: limits of the file, None where it has none.
    """

    name: str
    data_type: int
    access: str
    value: int | None
    low: int | None
    high: int | None
    mappable: bool

    @property
    def size(self) -> int:
        """Bytes of a number; 0 where it is something else (a string, a domain)."""
        code = BASIC_TYPES.get(self.data_type)
        return calcsize(f"<{code}") if code else 0

    def holds(self, value: int) -> bool:
        """Whether its data type has room for a number, signed or not."""
        return self.size > 0 and -(1 << 8 * self.size - 1) <= value < 1 << 8 * self.size

    @property
    def writable(self) -> bool:
        """Can be written over SDO."""
        return "w" in self.access


class Eds:
    """The object dictionary of one drive. name: vendor and product, for people. warnings: what was read over.

    broken: why an entry that the file has is not among the entries. dummies: data types it lets an RPDO map as dummies.
    bitrates: kbit/s it names, True where it can.
    """

    def __init__(self, text: str, node_id: int) -> None:
        """node_id: put in place of $NODEID. Raises EdsError where the text has no object at all."""
        self.warnings: list[str] = []
        self.broken: dict[tuple[int, int], str] = {}
        self.entries: dict[tuple[int, int], Entry] = {}
        self._node_id = node_id
        sections = self._sections(text)
        info = sections.get("deviceinfo", {})
        vendor, product = info.get("vendorname", ""), info.get("productname", "")
        named = product if product.lower().startswith(vendor.lower()) else f"{vendor} {product}"
        self.name = named.strip() or vendor or "unnamed"
        self.bitrates = {int(k[9:]): v.strip() == "1" for k, v in info.items() if re.fullmatch(r"baudrate_\d+", k)}
        usage = sections.get("dummyusage", {})
        self.dummies = {int(k[5:], 16) for k, v in usage.items() if re.fullmatch("dummy[0-9a-f]{4}", k) and v == "1"}
        for name, keys in sections.items():
            match = _SECTION.fullmatch(name)
            if match:
                self._read(int(match[1], 16), match[2], keys)
        if not self.entries:
            raise EdsError("no object in it: not an EDS or DCF file")

    def entry(self, index: int, subindex: int = 0) -> Entry | None:
        """The entry, or None where the file has none that can be used."""
        return self.entries.get((index, subindex))

    def value(self, index: int, subindex: int = 0) -> int | None:
        """The value that the file gives an entry; None where it gives none."""
        entry = self.entries.get((index, subindex))
        return None if entry is None else entry.value

    def _sections(self, text: str) -> dict[str, dict[str, str]]:
        """Keys and values by section, all names in lower case."""
        sections: dict[str, dict[str, str]] = {}
        keys: dict[str, str] = {}
        for number, raw in enumerate(text.splitlines(), 1):
            line = raw.strip()
            if not line or line[0] in ";#":
                continue
            if line[0] == "[" and "]" in line:
                name = line[1 : line.index("]")].strip().lower()
                if name in sections:
                    self.warnings.append(f"line {number}: section [{name}] again; its keys replace the earlier ones")
                keys = sections.setdefault(name, {})
            elif "=" in line:
                key, _, value = line.partition("=")
                keys[key.strip().lower()] = value.strip()
            else:
                self.warnings.append(f"line {number}: neither a section nor key=value: {line[:40]!r}")
        return sections

    def _read(self, index: int, sub: str | None, keys: dict[str, str]) -> None:
        """The entry, or entries, of one section."""
        subindex = int(sub, 16) if sub else 0
        try:
            kind = self._integer(keys.get("objecttype")) or _VARIABLE
            compact = self._integer(keys.get("compactsubobj")) or 0
            if sub is None and kind in (_ARRAY, _RECORD) and not compact:
                return
            if compact:
                self.entries[index, 0] = Entry("entries", _UNSIGNED8, "ro", compact, None, None, False)
                for member in range(1, min(compact, 0xFE) + 1):
                    self.entries[index, member] = self._entry(keys)
            else:
                self.entries[index, subindex] = self._entry(keys)
        except ValueError as error:
            self.broken[index, subindex] = str(error)
            self.warnings.append(f"{object_name(index, subindex)}: {error}")

    def _entry(self, keys: dict[str, str]) -> Entry:
        data_type = self._integer(keys.get("datatype"))
        if data_type is None:
            raise ValueError("has no DataType")
        access = keys.get("accesstype", "").lower()
        if access not in ("ro", "wo", "rw", "rwr", "rww", "const"):
            raise ValueError(f"AccessType = {access!r}, which is none of CiA 306's")
        number = data_type in BASIC_TYPES and BASIC_TYPES[data_type] not in "fd"
        value = keys.get("parametervalue") or keys.get("defaultvalue")
        return Entry(
            name=keys.get("parametername", ""),
            data_type=data_type,
            access=access,
            value=self._integer(value) if number else None,
            low=self._integer(keys.get("lowlimit")) if number else None,
            high=self._integer(keys.get("highlimit")) if number else None,
            mappable=keys.get("pdomapping", "0").strip() not in ("0", ""),
        )

    def _integer(self, text: str | None) -> int | None:
        """A number of the file; None for nothing. Raises ValueError."""
        if not text:
            return None
        terms = text.upper().replace("$NODEID", str(self._node_id)).split("+")
        try:
            return sum(
                int(term.strip(), 0 if term.strip().lstrip("-").upper().startswith("0X") else 10) for term in terms
            )
        except ValueError:
            raise ValueError(f"{text[:40]!r} is no number") from None


def read_eds(path: Path, node_id: int = 1) -> Eds:
    """Read an EDS or DCF file, UTF-8 or Latin-1. Raises EdsError naming the file, OSError where it cannot be read."""
    try:
        data = read_bounded(path, _LARGEST)
    except UnsuitableFileError as error:
        raise EdsError(f"{path}: not an EDS or DCF file: {error}") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    try:
        return Eds(text, node_id)
    except EdsError as error:
        raise EdsError(f"{path}: {error}") from None


def object_name(index: int, subindex: int = 0) -> str:
    """An object as the standards write it: 1A00h:01."""
    return f"{index:04X}h:{subindex:02X}"
