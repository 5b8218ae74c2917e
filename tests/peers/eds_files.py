"""EDS and DCF files: our reader against canopen's, and every object through `hil drive`'s SDO server.

Differences that a rule of CiA 306-1 explains stand in rows of their own, named after the rule; deviations.toml has the
rules. Any other difference in the same file is unexplained.
"""

import random
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import canopen
from canopen import objectdictionary

from drivers.eds.data_types import Kind
from drivers.eds.reader import Eds, Entry, object_name, read_eds
from drivers.families.cia402.cia301 import EDS
from drivers.frame import Frame
from tests.peers.files import Tried, in_folder, in_source
from tests.peers.table import DIFFERS, PASSED, Row
from tests.sim_plant.test_drive_by_its_file import NODE, WHOLE, SdoClient, drawn
from tests.support.foreign_drive import CST_DRIVE, FULL_DRIVE, MOTION_DRIVE, eds_text

PEER = "canopen's EDS reader"
GIVEN_UP, COMPACT = "given up by them", "compact storage"
_COMPACT = re.compile(r"^\[([0-9A-Fa-f]{4})\][^\[]*?^CompactSubObj[ \t]*=[ \t]*(?:0x)?0*[1-9A-Fa-f]", re.M | re.I)
_SHOWN = 3


class Difference(NamedTuple):
    """Of one object: its place, theirs, ours; the rule that explains it, or nothing."""

    place: tuple[int, int]
    theirs: object
    ours: object
    rule: str = ""


def rows(work: Path, files: Path | None, *, few: bool) -> Iterator[Row]:
    """A row a file and property, one for its objects through SDO, one for drawn requests."""
    named = {"cst": CST_DRIVE, "full": FULL_DRIVE, "motion": MOTION_DRIVE}
    texts = {name: eds_text(facts) for name, facts in named.items()} | {"every_type": WHOLE}
    tried = [Tried(EDS, EDS.name)]
    for name, text in texts.items():
        path = work / f"{name}.eds"
        path.write_text(text)
        tried.append(Tried(path, f"generated/{path.name}"))
    for found, missing in (in_source("canopen", "test", (".eds",)), in_folder(files, (".eds", ".dcf"), PEER)):
        tried += found
        yield from missing
    for file in tried:
        yield from _of_file(file, 2_000 if few else 100_000, work)


def _of_file(file: Tried, requests: int, work: Path) -> Iterator[Row]:
    try:
        ours = read_eds(file.path, NODE)
    except ValueError as error:
        yield Row(PEER, f"{file.name}: read", DIFFERS, f"we: {error}", file.own)
        return
    theirs, refused = _read_by_them(file.path)
    if refused:
        yield Row(PEER, f"{file.name}: {GIVEN_UP}", DIFFERS, refused, file.own)
        (work / "mended.eds").write_text(_mended(file.path))
        theirs, refused = _read_by_them(work / "mended.eds")
    if refused:
        yield Row(PEER, f"{file.name}: read", DIFFERS, refused, file.own)
    else:
        yield from _compared(file, theirs, ours)
    client = SdoClient(file.path)
    yield _row(file, "SDO", _through_sdo(client))
    yield _row(file, f"{requests} drawn requests", _drawn(client, requests))


def _read_by_them(path: Path) -> tuple[Any, str]:
    try:
        return canopen.import_od(str(path), NODE), ""
    except Exception as error:  # of any kind: the reader is not ours
        return None, f"they: {type(error).__name__}: {error}"[:200]


def _mended(path: Path) -> str:
    """The file without what they give up a whole file for: comments, dummies, keys without a value."""
    text = path.read_text(encoding="utf-8", errors="replace")
    text = re.sub(r"^\[(?:Comments|DummyUsage)\][^\[]*", "", text, flags=re.M | re.I)
    return re.sub(r"^[^=\n\[;]+=[ \t]*\r?\n", "", text, flags=re.M)


def _compared(file: Tried, theirs: Any, ours: Eds) -> Iterator[Row]:
    """A row a property, and one for each rule that explains differences."""
    variables = dict(_variables(theirs))
    text = file.path.read_text(encoding="utf-8", errors="replace")
    compact = {int(index, 16) for index in _COMPACT.findall(text)}
    yield from _rows(file, "objects", compact, _objects(set(variables), ours.entries.keys() | ours.broken.keys()))
    for what, both in _PROPERTIES.items():
        pairs = [(place, variables[place], entry) for place, entry in ours.entries.items() if place in variables]
        found = [
            Difference(place, *pair, _rule(what, their, entry, pair))
            for place, their, entry in pairs
            if (pair := both(their, entry)) and pair[0] != pair[1]
        ]
        yield from _rows(file, what, compact, found)


def _rows(file: Tried, what: str, compact: set[int], found: Sequence[Difference]) -> Iterator[Row]:
    ruled = [d._replace(rule=d.rule or (COMPACT if d.place[0] in compact else "")) for d in found]
    yield _row(file, what, [d for d in ruled if not d.rule])
    for rule in dict.fromkeys(d.rule for d in ruled if d.rule):
        yield _row(file, f"{what}: {rule}", [d for d in ruled if d.rule == rule])


def _rule(what: str, theirs: Any, ours: Entry, pair: tuple[Any, Any]) -> str:
    """The rule that explains a difference in one object, or nothing."""
    if what == "limits" and ours.type.kind is Kind.REAL and pair[0] == (None, None):
        return "limits of REAL"
    if what == "limits" and pair[1] == (None, None) and None not in pair[0] and pair[0][0] > pair[0][1]:
        return "limits that exclude everything"
    if what == "value" and ours.type.kind is Kind.TEXT and ours.value is None and not str(pair[0]).isascii():
        return "text that is no VISIBLE_STRING"
    if what == "value" and theirs.value in ("", b"") and ours.value == theirs.default:
        return "ParameterValue without a value"
    return ""


def _row(file: Tried, what: str, found: Sequence[Difference]) -> Row:
    told = "; ".join(f"{object_name(*d.place)}: they {d.theirs!r}, we {d.ours!r}" for d in found[:_SHOWN])
    told += f"; and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
    return Row(PEER, f"{file.name}: {what}", DIFFERS if found else PASSED, told, file.own)


def _variables(od: Any) -> Iterator[tuple[tuple[int, int], Any]]:
    for index, entry in od.items():
        if isinstance(entry, objectdictionary.ODVariable):
            yield (index, 0), entry
        else:
            yield from (((index, subindex), member) for subindex, member in entry.subindices.items())


def _objects(theirs: set[tuple[int, int]], ours: set[tuple[int, int]]) -> list[Difference]:
    """Dummies are no objects of the device."""
    apart = [place for place in sorted(theirs ^ ours) if place[0] > 0xFF]
    return [Difference(place, place in theirs, place in ours) for place in apart]


def _value(theirs: Any, ours: Entry) -> tuple[object, object]:
    """A DCF's own value before the default, as ours has it. A string without a value is an empty one to them."""
    value = theirs.default if theirs.value is None else theirs.value
    if value in (None, "", b"") or ours.value is None:
        return value or None, ours.value
    if ours.type.kind is Kind.REAL:
        return round(float(value), 6), round(float(str(ours.value)), 6)
    return _plain(value), _plain(ours.value)


def _plain(value: object) -> object:
    return value.rstrip(b"\0").hex() if isinstance(value, bytes) else value


_PROPERTIES = {
    "type": lambda theirs, ours: (theirs.data_type, ours.data_type),
    "access": lambda theirs, ours: (theirs.access_type.lower(), ours.access),
    "value": _value,
    "limits": lambda theirs, ours: ((theirs.min, theirs.max), (ours.low, ours.high)),
    "mappable": lambda theirs, ours: (bool(theirs.pdo_mappable), ours.mappable),
}


def _through_sdo(client: SdoClient) -> list[Difference]:
    """Every readable object read; every one that is writable too written back as it was read, and read again."""
    found = []
    for key, entry in client.drive.dictionary.entries.items():
        index, subindex = key >> 8, key & 0xFF
        if not entry.readable:
            continue
        before = client.read(index, subindex)
        code = client.write(index, subindex, before) if entry.writable else 0
        after = client.read(index, subindex)
        if code or after != before:
            told = f"abort {code:#x}" if code else after.hex()
            found.append(Difference((index, subindex), before.hex(), told))
    return found


def _drawn(client: SdoClient, requests: int) -> list[Difference]:
    """No sequence of requests ends it: whoever asks afterwards is answered."""
    draw, objects = random.Random(requests), list(client.drive.dictionary.entries)
    for number in range(requests):
        client.ask(drawn(draw, objects), draw.choice((0, 0, 1_000_000)))
        if number % 1000 == 999 and not _answers(client, objects[0]):
            return [Difference((0, 0), f"request {number} answered", "silent")]
    return []


def _answers(client: SdoClient, key: int) -> bool:
    client.drive.on_frame(Frame(0x000, b"\x82\0", 0, client.now_ns))  # reset communication
    request = bytes((0x40, key >> 8 & 0xFF, key >> 16, key & 0xFF))
    return any(client.ask(request) for _ in range(2))
