"""The build pass that makes flags plain ints: what it rewrites does the same."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from deploy.compiled.build import FOR_BOTH, ONE_RIG, OTHERS, PACKAGES, listed
from deploy.compiled.flag_members import find_flags, hoist
from tests.support.paths import ROOT

KINDS = """
from enum import IntEnum, IntFlag

class Plain(IntEnum):
    ONE = 1

class Colour(IntFlag):
    RED = 1
    BLUE = 2

class Bits(IntFlag):
    LOW = 1
    HIGH = 8
"""
USES = """
from enum import IntFlag
from kinds import Bits, Colour, Plain

class Own(IntFlag):
    HERE = 3

class Holder:
    def method(self): return Colour.BLUE, "ä", Colour.BLUE

def members():
    return Colour.RED == Colour(1), Plain.ONE is Plain(1), [c for c in (Colour.BLUE,)], Own.HERE, Holder().method()
def flags(status): return status & Bits.HIGH, Bits.LOW | 2, not 6 & Bits.HIGH
def matched(colour):
    match colour:
        case Colour.RED:
            return "red"
        case _:
            return "other"
def shadowed(Colour): return Colour.RED
def defaulted(colour=Colour.RED): return colour.name, Colour.RED
"""


def results(source: str, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    kinds = ModuleType("kinds")
    exec(KINDS, vars(kinds))
    monkeypatch.setitem(sys.modules, "kinds", kinds)
    here: dict[str, Any] = {"__name__": "uses"}
    exec(source, here)
    calls = [here["members"](), here["flags"](9), here["defaulted"]()]
    matched = [here["matched"](kinds.Colour.RED), here["matched"](kinds.Colour.BLUE)]
    return [*calls, *matched, here["shadowed"](SimpleNamespace(RED="mine"))]


def test_a_module_rewritten_does_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    for name, source in (("kinds", KINDS), ("uses", USES)):
        (tmp_path / "here" / f"{name}.py").write_text(source)
    known = {
        (key[0].removeprefix("here."), key[1]): members for key, members in find_flags(tmp_path, ("here",)).items()
    }
    rewritten = hoist(USES, "uses", known)
    assert results(rewritten, monkeypatch) == results(USES, monkeypatch)
    for definition in ("_Colour_RED: _Final = int(Colour.RED)", "_Own_HERE: _Final", "_Bits_HIGH: _Final"):
        assert rewritten.count(definition) == 1
    body = rewritten[rewritten.index("class Holder") :]
    assert body.count("Colour.RED") == 3, "the pattern, the variable of that name and the default stay"
    assert "Colour.BLUE" not in body
    assert "Bits.HIGH" not in body
    assert "Plain.ONE" in body


def test_a_module_without_any_is_left_alone() -> None:
    assert hoist("import os\n\ndef f(): return os.O_RDONLY\n", "m", {}) == "import os\n\ndef f(): return os.O_RDONLY\n"


def test_every_compiled_module_is_still_a_module() -> None:
    known = find_flags(ROOT, PACKAGES)
    assert "ENABLED" in known["drivers.protocols.base", "DriveStatus"]
    changed = 0
    for name in (*listed(FOR_BOTH), *listed(ONE_RIG), *listed(OTHERS)):
        source = (ROOT / name).read_text()
        rewritten = hoist(source, name.removesuffix(".py").replace("/", "."), known)
        compile(rewritten, name, "exec")
        changed += rewritten != source
    assert changed >= 2
