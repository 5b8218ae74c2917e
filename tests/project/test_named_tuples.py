"""The build pass that makes NamedTuples directly: what it rewrites computes the same, and it leaves the rest alone."""

from pathlib import Path
from typing import Any

import pytest

from deploy.compiled.build import PACKAGES
from deploy.compiled.named_tuples import find_named_tuples, rewrite
from tests.support.paths import ROOT

POINT = '''"""A module."""
from __future__ import annotations

from typing import NamedTuple


class Point(NamedTuple):
    x: int
    y: int = 0
    name: str = "ä"


class Single(NamedTuple):
    value: object


'''


def result(source: str) -> Any:
    namespace: dict[str, Any] = {"__name__": "sample"}
    exec(compile(source, "sample", "exec"), namespace)
    return namespace["made"]()


def rewritten(tmp_path: Path, source: str) -> str:
    package = tmp_path / "package"
    package.mkdir()
    (package / "sample.py").write_text(source)
    return rewrite(source, "package.sample", find_named_tuples(tmp_path, ("package",)))


@pytest.mark.parametrize(
    "call",
    [
        "Point(1)",
        "Point(1, 2)",
        "Point(1, 2, 'three')",
        "Point(1, (2))",
        "Single(4)",
        "Single((4))",
        "Single(Single(Point(5, 6,),),)",
        "Single('ä'), Point(1, 'ü' if Point(2) else 0)",
        "[Point(\n        1,  # a comment, with commas,\n    ), Point(\n        1,\n        2\n    )]",
    ],
)
def test_a_rewritten_call_makes_the_same_instance(tmp_path: Path, call: str) -> None:
    source = f"{POINT}def made():\n    return {call}\n"
    changed = rewritten(tmp_path, source)
    body = changed[changed.index("def made") :]
    assert "_tuple_new(_new_" in body
    assert " Point(" not in body
    assert "(Single(" not in body
    assert repr(result(changed)) == repr(result(source))


@pytest.mark.parametrize("call", ["Point(x=1)", "Point(*[1, 2])", "Point(1, name='x')"])
def test_any_other_call_stays_as_it_is(tmp_path: Path, call: str) -> None:
    source = f"{POINT}def made():\n    return {call}\n"
    assert rewritten(tmp_path, source) == source


def test_it_finds_the_classes_of_the_hot_path() -> None:
    found = find_named_tuples(ROOT, PACKAGES)
    assert {("drivers.frame", "Frame"), ("drivers.protocols.base", "Command")} <= set(found)
    text = rewrite((ROOT / "drivers/wire/wire.py").read_text(), "drivers.wire.wire", found)
    assert "_tuple_new(_new_Frame, (can_id, data, flags, end_ns, ))" in text
