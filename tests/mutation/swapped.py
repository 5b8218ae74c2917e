"""Tests collected once, then run in a fork for each mutant, in which only the changed function's code is swapped.

A mutant costs no import and no collection: hundredths of a second instead of seconds. What the test modules made when
they were imported was made by the honest code, so that only a kill counts; what survives is tried again in full.
"""

import ast
import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

from tests.mutation.reporting import Reporter, Verdict, die_with_parent, listen

_Function = ast.FunctionDef | ast.AsyncFunctionDef


class Collected:
    """A pytest plugin: instead of running the tests it waits for mutants, as (path, honest, mutated), or for None, the
    honest code, and says what became of each: a Verdict, or None where the change is not in the body of a function.
    """

    def __init__(self, requests: Connection) -> None:
        self._requests = requests

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Serve until the other end is closed."""
        gc.freeze()  # a fork copies no page only to look for garbage in it
        while True:
            try:
                mutant = self._requests.recv()
            except EOFError:
                return True
            swap = swapping(*mutant) if mutant else _nothing
            self._requests.send(_run(session, swap) if swap else None)


def _run(session: pytest.Session, swap: Callable[[], None]) -> Verdict:
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            die_with_parent()
            os.setsid()
            reporter = Reporter(writer)
            session.config.pluginmanager.register(reporter)
            swap()
            for item, following in zip(session.items, [*session.items[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if reporter.failed:
                    break
            reporter.say("end", "")
        finally:
            os._exit(0)
    os.close(writer)
    return listen(reader, child)


def _nothing() -> None:
    pass


def swapping(path: str, honest: bytes, mutated: bytes) -> Callable[[], None] | None:
    """What makes the mutant of a file; None where it is more than the body of one function."""
    module = sys.modules.get(path.removesuffix(".py").replace("/", "."))
    before, after = ast.parse(honest), ast.parse(mutated)
    old, new = dict(_functions(before)), dict(_functions(after))
    changed = [name for name in old if name in new and ast.dump(old[name]) != ast.dump(new[name])]
    places = {(name, _first_line(new[name])) for name in changed}
    for node in [*old.values(), *new.values()]:
        node.body = []
    if module is None or len(changed) != 1 or ast.dump(before) != ast.dump(after):
        return None
    found = _function(module, changed[0])
    code = [code for code in _codes(compile(mutated, str(module.__file__), "exec")) if _place(code) in places]
    if found is None or len(code) != 1 or found.__code__.co_freevars != code[0].co_freevars:
        return None
    return lambda: setattr(found, "__code__", code[0])


def _functions(node: ast.AST, prefix: str = "") -> Iterator[tuple[str, _Function]]:
    """The functions of a module and of its classes, by qualified name; one that stands there twice is left out."""
    found: list[tuple[str, _Function]] = []
    for child in ast.iter_child_nodes(node):
        if isinstance(child, _Function):
            found.append((prefix + child.name, child))
        elif isinstance(child, ast.ClassDef):
            found += _functions(child, f"{prefix}{child.name}.")
    names = [name for name, _ in found]
    yield from (one for one in found if names.count(one[0]) == 1)


def _first_line(node: _Function) -> int:
    return min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _place(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno


def _function(module: ModuleType, name: str) -> FunctionType | None:
    """What the name stands for, below a property, a class method or a cache."""
    found: Any = module
    for part in name.split("."):
        found = vars(found).get(part)
        if found is None:
            return None
    for layer in ("fget", "__func__", "__wrapped__"):
        found = getattr(found, layer, None) or found
    same = isinstance(found, FunctionType) and found.__code__.co_qualname == name
    return found if same else None


def serve(requests: Connection, options: Sequence[str], tests: Sequence[str]) -> None:
    """Collect the tests, and serve; never returns."""
    try:
        null = os.open(os.devnull, os.O_RDWR)
        for descriptor in range(3):
            os.dup2(null, descriptor)
        pytest.main([*options, *tests], plugins=[Collected(requests)])
    finally:
        os._exit(0)
