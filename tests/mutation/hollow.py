"""Tests that cannot fail: those of a room that stay green while its code does nothing.

    python -m tests.mutation --hollow [--room R ...]

While a test's own body runs (not its fixtures, not imports), every function of the room's sources but the constructors
returns None at once. A test that passes all the same asserts nothing about what the room does: it holds a table or a
constant (then it says so in explained.toml, as [[green]]), or it is vacuous.
"""

import ast
import builtins
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutation.fork_server import ForkServer
from tests.mutation.rooms import ROOMS, files_to_run, sources_of

SWITCH = "hollow_functions"
_GUARD = f"if getattr(__import__('builtins'), {SWITCH!r}, False): return None"


def hollowed(source: str) -> str:
    """The same source with a guard at the beginning of every function that has a body."""
    lines = source.splitlines(keepends=True)
    for function in sorted(_functions(ast.parse(source)), key=lambda f: -f.lineno):
        body = function.body[1:] if _is_text(function.body[0]) else function.body
        if not body or body[0].lineno == function.lineno or all(_is_text(statement) for statement in body):
            continue  # one line, or nothing but words
        first = min([body[0].lineno, *(d.lineno for d in getattr(body[0], "decorator_list", []))])
        lines.insert(first - 1, f"{' ' * body[0].col_offset}{_GUARD}\n")
    return "".join(lines)


def _functions(tree: ast.AST) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name not in ("__init__", "__post_init__"):
            yield node


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


class Switch:
    """A pytest plugin: code is hollow while a test's own body runs."""

    @pytest.hookimpl(wrapper=True)
    def pytest_pyfunc_call(self) -> Iterator[None]:
        """Around the call of the test function."""
        setattr(builtins, SWITCH, True)
        try:
            return (yield)
        finally:
            setattr(builtins, SWITCH, False)


def green_tests(server: ForkServer, room: str) -> list[str]:
    """Tests of the room that pass while its code does nothing."""
    tree = server.tree
    sources = {tree / path: (tree / path).read_bytes() for path in sources_of(tree, room)}
    tests = list(dict.fromkeys(t for path in sources_of(tree, room) for t in files_to_run(tree, ROOMS[room], path)))
    own = [test for test in tests if _is_own(tree, room, test)]
    try:
        for file, text in sources.items():
            file.write_text(hollowed(text.decode()), encoding="utf-8")
        return sorted(server.run(own, everything=True, plugins=(Switch(),)).passed)
    finally:
        for file, text in sources.items():
            file.write_bytes(text)


def _mirror(source: str) -> Path:
    """The folder of the tests that mirror a source: hil/cycle has tests/cycle, drivers/bus tests/drivers/bus."""
    folder = Path(source) if not source.endswith(".py") else Path(source).parent
    return Path("tests") / (folder.relative_to("hil") if folder.parts[0] == "hil" else folder)


def _is_own(tree: Path, room: str, test: str) -> bool:
    """Whether a test file mirrors the room, and is not of whole runs or neighbours that pass through it."""
    for source in ROOMS[room].sources:
        mirror = _mirror(source)
        while not (tree / mirror).is_dir():
            mirror = mirror.parent
        if mirror in Path(test).parents:
            return True
    return False
