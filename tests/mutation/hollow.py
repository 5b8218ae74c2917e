"""Tests that cannot fail: those that stay green while the product does nothing.

    python -m tests.mutation --hollow

While a test's own body runs (not its fixtures, not imports), every function of the product but the constructors returns
None at once. A test that passes all the same asserts nothing about what is done: it holds a table or a text (then
green.toml says so), or it is vacuous.
"""

import ast
import builtins
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutation.fork_server import ForkServer
from tests.mutation.rooms import python_files

PACKAGES = ("drivers", "sim_plant", "hil")
FOLDERS = tuple(f"tests/{name}" for name in ("cycle", "control", "drivers", "sim_plant", "live", "telemetry", "rig"))
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


def green_tests(server: ForkServer, folder: str) -> list[str]:
    """Tests below a folder that pass while the product does nothing."""
    tree = server.tree
    sources = [tree / path for package in PACKAGES for path in python_files(tree, package)]
    honest = {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in sources}
    try:
        for file, (text, _) in honest.items():
            file.write_text(hollowed(text.decode()), encoding="utf-8")
        tests = [path for path in python_files(tree, folder) if Path(path).name.startswith("test_")]
        return sorted(server.run(tests, everything=True, plugins=(Switch(),)).passed)
    finally:
        for file, (text, mtime_ns) in honest.items():
            file.write_bytes(text)
            os.utime(file, ns=(mtime_ns, mtime_ns))
