"""Wrong bindings, drawn by a seed: a rig of each family, and one mistake in how it is bound to its drives.

The drives stay as they are: emulated from their makers' documents, or bound as the right rig says. The mistake is in
the rig alone, as on the day when a rig meets its drives. `drawn(seed)` is the same on every machine.

Not drawn: two whole drives exchanged whose axes are alike. Every frame is then as it should be; only a person sees it.
"""

import copy
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from tests.support.bought_drives import EDS, cia402
from tests.support.foreign_drive import CST_DRIVE, eds_text
from tests.support.paths import RIGS

Document = dict[str, Any]
DBC = "example_drive.dbc"
UNITS = {"degrees": 180.0 / math.pi, "turns": 2.0 * math.pi, "thousandths": 1000.0, "tenths": 10.0}
MIT_KINDS = ("damiao", "cubemars", "robstride")
P_MAX = (3.14159, 6.28319, 25.0, 95.5)  # rad, of other drives of the MIT kind
T_MAX = (28.0, 40.0, 54.0, 120.0, 200.0)  # N m
_TORQUE, _POSITION = "TorqueDemand : 7|16@0- (0.01,0)", "ShaftPosition m0 : 7|32@0- (0.1,0)"


class Bound(NamedTuple):
    """A rig's document and the files that it names, by name. A mistake changes either."""

    rig: Document
    files: dict[str, str]


class WrongBinding(NamedTuple):
    """family: whose rig. what: the mistake, for people. right, wrong: the rig without it and with it."""

    family: str
    what: str
    right: Bound
    wrong: Bound


Mistake = Callable[[Bound, Random], str]


def write(bound: Bound, folder: Path) -> None:
    """The files that a rig names, into a folder, which is made."""
    folder.mkdir()
    for name, text in bound.files.items():
        (folder / name).write_text(text)


# rigs -----------------------------------------------------------------------------------------------------------------


def _mit(kind: str) -> Bound:
    return Bound(tomllib.loads((RIGS / f"{kind}.toml").read_text()), {})


def _dbc() -> Bound:
    """The paper's stage behind a supplier's DBC file whose answers have two pages: position, and a temperature."""
    rig = tomllib.loads((RIGS / "paper-dbc.toml").read_text())
    for name, force in (("x", 1.6), ("y", 0.4)):
        rig["axes"][name]["push"] = {"force": force, "distance": 4e-3}
    rig["bus"]["dbc"]["checksum"] = rig["bus"]["dbc"]["checksum"][:2]  # of the commands; a page stands in its place
    text = (RIGS / DBC).read_text()
    position, rest = _POSITION.replace(" m0", ""), '[-214748364.8|214748364.7] "um" Controller\n'
    pages = f" SG_ {_POSITION} {rest} SG_ Winding m1 : 7|32@0- (0.1,0) {rest}"
    text = text.replace(f" SG_ {position} {rest}", pages)
    text = text.replace(" SG_ Checksum : 63|8@0+ (1,0) [0|255] ", " SG_ Page M : 63|8@0+ (1,0) [0|1] ")
    return Bound(rig, {DBC: text})


def _cia402() -> Bound:
    return Bound(cia402(), {EDS: eds_text(CST_DRIVE)})


# mistakes of every rig ------------------------------------------------------------------------------------------------


def _axis(random: Random) -> int:
    return random.randrange(2)


def _table(bound: Bound, axis: int) -> Document:
    table: Document = list(bound.rig["axes"].values())[axis]
    return table


def _scaled(key: str) -> Mistake:
    """A key of one axis in another unit, or the other way round."""

    def change(bound: Bound, random: Random) -> str:
        unit, axis = random.choice(sorted(UNITS)), _axis(random)
        factor = UNITS[unit] ** random.choice((-1, 1))
        table = _table(bound, axis)
        table[key] = table.get(key, 1.0) * factor
        return f"axis {axis}: {key} times {factor:.4g} ({unit})"

    return change


# drives of the MIT kind -----------------------------------------------------------------------------------------------


def _another_number(table: str) -> Mistake:
    def change(bound: Bound, random: Random) -> str:
        nodes, axis = bound.rig["bus"][table]["nodes"], _axis(random)
        nodes[axis] = random.choice([number for number in range(1, 16) if number not in nodes])
        return f"axis {axis}: number {nodes[axis]}"

    return change


def _exchanged_numbers(table: str) -> Mistake:
    def change(bound: Bound, random: Random) -> str:
        bound.rig["bus"][table]["nodes"].reverse()
        return "drives exchanged"

    return change


def _range(key: str, others: tuple[float, ...], *, followed: bool) -> Mistake:
    """Another range than the drives are set to. followed: the axes' resolution is computed from it, too."""

    def change(bound: Bound, random: Random) -> str:
        value = random.choice(others)
        if followed:
            for table in bound.rig["axes"].values():
                table["encoder_resolution"] *= value / bound.rig["bus"]["mit"][key][0]
        bound.rig["bus"]["mit"][key] = [value]
        return f"{key} = {value:g}{', and the resolution with it' if followed else ''}"

    return change


def _another_maker(bound: Bound, random: Random) -> str:
    mit = bound.rig["bus"]["mit"]
    mit["kind"] = random.choice([kind for kind in MIT_KINDS if kind != mit["kind"]])
    return f"kind = {mit['kind']}"


def _another_answer(bound: Bound, random: Random) -> str:
    if bound.rig["bus"]["mit"]["kind"] == "robstride":
        bound.rig["bus"]["mit"]["host"] = number = random.randrange(0xFD)
        return f"host = {number}"
    axis, number = _axis(random), random.randrange(0x20, 0x7F0)
    answers = {"damiao": [0x11, 0x12], "cubemars": [1, 2]}[bound.rig["bus"]["mit"]["kind"]]
    bound.rig["bus"]["mit"]["answers"] = [number if at == axis else known for at, known in enumerate(answers)]
    return f"axis {axis}: answers in {number:#x}"


_OF_MIT: tuple[Mistake, ...] = (
    _another_number("mit"),
    _range("position", P_MAX, followed=False),
    _range("position", P_MAX, followed=True),
    _range("torque", T_MAX, followed=False),
    _another_maker,
    _another_answer,
    _scaled("encoder_resolution"),
    _scaled("gear"),
)

# drives of a DBC file -------------------------------------------------------------------------------------------------


def _in_file(old: str, new: str, what: str) -> Mistake:
    """Another text in the DBC file, of one drive."""

    def change(bound: Bound, random: Random) -> str:
        axis, text = _axis(random), bound.files[DBC]
        at = [place for place in range(len(text)) if text.startswith(old, place)][axis]
        bound.files[DBC] = text[:at] + new + text[at + len(old) :]
        return f"axis {axis}: {what}"

    return change


def _factor(signal: str, stated: str) -> Mistake:
    """Another factor or sign of a signal in the DBC file."""

    def change(bound: Bound, random: Random) -> str:
        factor = random.choice((-1.0, 10.0, 0.1, -10.0, 1000.0, 0.001))
        new = signal.replace(f"({stated},0)", f"({float(stated) * factor:g},0)")
        return _in_file(signal, new, f"{signal.split()[0]} times {factor:g}")(bound, random)

    return change


def _exchanged(key: str) -> Mistake:
    def change(bound: Bound, random: Random) -> str:
        bound.rig["bus"]["dbc"][key].reverse()
        return f"{key} of the axes exchanged"

    return change


def _entry(key: str, what: str, **values: Any) -> Mistake:
    """Other values in one entry of a list of [bus.dbc]."""

    def change(bound: Bound, random: Random) -> str:
        axis = _axis(random)
        bound.rig["bus"]["dbc"][key][axis].update(values)
        return f"axis {axis}: {what}"

    return change


def _another_scale(key: str) -> Mistake:
    def change(bound: Bound, random: Random) -> str:
        axis, factor = _axis(random), random.choice((0.001, 0.01, 0.1, 10.0, 100.0, 1000.0))
        bound.rig["bus"]["dbc"][key][axis]["scale"] *= factor
        return f"axis {axis}: scale of {key} times {factor:g}"

    return change


def _another_identifier(bound: Bound, random: Random) -> str:
    old = random.choice(("528", "529", "784", "785"))
    new = random.choice(("512", "530", "783", "786", "2047"))
    bound.files[DBC] = bound.files[DBC].replace(f"BO_ {old} ", f"BO_ {new} ")
    return f"identifier {new} for {old}"


_OF_DBC: tuple[Mistake, ...] = (
    _in_file(_TORQUE, "TorqueDemand : 0|16@1- (0.01,0)", "bytes of the torque swapped"),
    _in_file(_POSITION, "ShaftPosition m0 : 0|32@1- (0.1,0)", "bytes of the position swapped"),
    _in_file(_POSITION, "ShaftPosition m0 : 7|16@0- (0.1,0)", "half of the position"),
    _in_file(_TORQUE, "TorqueDemand : 7|16@0+ (0.01,0)", "torque without a sign"),
    _in_file(_POSITION, "ShaftPosition m0 : 7|32@0+ (0.1,0)", "position without a sign"),
    _in_file("PowerStage : 23|", "PowerStage : 21|", "enable in another bit"),
    _in_file("StateBits : 46|7", "StateBits : 45|7", "state a bit aside"),
    _in_file("AliveEcho : 35|4@0+", "AliveEcho : 39|4@0+", "counter read from another place"),
    _in_file("AliveCounter : 19|4@0+", "AliveCounter : 31|4@0+", "counter written to another place"),
    _factor(_TORQUE, "0.01"),
    _factor(_POSITION, "0.1"),
    _exchanged("torque"),
    _exchanged("position"),
    _exchanged("enable"),
    _exchanged("status"),
    _entry("enable", "enable and disable exchanged", on=0, off=1),
    _entry("position", "another page", signal="Winding"),
    _entry("position", "counter for position", signal="AliveEcho"),
    _entry("status", "counter for state", signal="AliveEcho"),
    _entry("enable", "reset for enable", signal="ClearFault"),
    _another_scale("torque"),
    _another_scale("position"),
    _another_identifier,
    _scaled("encoder_resolution"),
    _scaled("gear"),
)

# CiA 402 --------------------------------------------------------------------------------------------------------------


def _rated_torque(bound: Bound, random: Random) -> str:
    axis, factor = _axis(random), random.choice((0.001, 0.1, 10.0, 1000.0))
    bound.rig["bus"]["cia402"]["rated_torque"][axis] *= factor
    return f"axis {axis}: rated torque times {factor:g}"


def _another_mode(bound: Bound, random: Random) -> str:
    mode = random.choice((0, 1, 3, 4, 6, 8, 9))
    bound.rig["bus"]["cia402"]["write"] = [{"object": "6060h", "value": mode}]
    return f"mode {mode}"


def _another_mapping(bound: Bound, random: Random) -> str:
    place, other = random.choice((("1A00h:01", 0x606C0020), ("1A00h:02", 0x60610010), ("1600h:01", 0x60710010)))
    bound.rig["bus"]["cia402"]["write"] = [{"object": place, "value": other}]
    return f"{place} = {other:#x}"


def _setting(key: str, value: Any) -> Mistake:
    def change(bound: Bound, random: Random) -> str:
        bound.rig["bus"]["cia402"][key] = value
        return f"{key} = {value}"

    return change


_OF_CIA402: tuple[Mistake, ...] = (
    _another_number("cia402"),
    _exchanged_numbers("cia402"),
    _rated_torque,
    _another_mode,
    _another_mapping,
    _setting("rpdo", "shared"),
    _setting("sync_counter", "on"),
    _setting("start", "autostart"),
    _scaled("encoder_resolution"),
    _scaled("gear"),
)

RIGS_OF: dict[str, tuple[Callable[[], Bound], tuple[Mistake, ...]]] = {
    "damiao": (lambda: _mit("damiao"), _OF_MIT),
    "dbc": (_dbc, _OF_DBC),
    "cia402": (_cia402, _OF_CIA402),
    "robstride": (lambda: _mit("robstride"), _OF_MIT),
    "dbc, too": (_dbc, _OF_DBC),
    "cubemars": (lambda: _mit("cubemars"), _OF_MIT),
}


def drawn(seed: int) -> WrongBinding:
    """The wrong binding of this seed. Families follow each other, so that every six seeds have each."""
    random = Random(f"wrong binding {seed}")
    family = list(RIGS_OF)[seed % len(RIGS_OF)]
    made, mistakes = RIGS_OF[family]
    right = made()
    wrong = Bound(copy.deepcopy(right.rig), dict(right.files))
    return WrongBinding(family.partition(",")[0], random.choice(mistakes)(wrong, random), right, wrong)
