"""The text of a class that was typed into a notebook: a rig carries it, so that its recordings replay anywhere."""

import ast
import inspect
import linecache
import sys
import textwrap
from types import ModuleType
from typing import Any

_PLAIN = (int, float, str, bool, bytes, tuple, type(None))


class ClassTextError(ValueError):
    """The class cannot stand in a file of its own; the text says why."""


def class_text(made: type) -> str:
    """A Python file with that class and what it uses of its module: imports, plain constants, functions, classes.

    Raises ClassTextError where there is no source, or it uses something that a file cannot say.
    """
    parts: dict[str, str] = {}
    _take(made, parts)
    return "\n\n".join(parts.values()) + "\n"


def _take(thing: Any, parts: dict[str, str]) -> None:
    """Put the source of a class or function into `parts`, after all that it uses."""
    try:
        source = textwrap.dedent(_class_in_its_cell(thing) or inspect.getsource(thing))
    except (OSError, TypeError):
        raise ClassTextError(f"{thing.__name__}: its source is not to be had; put it into a file") from None
    home = vars(sys.modules[thing.__module__])
    own = {thing.__name__}
    for name in sorted(_names(ast.parse(source)) - own):
        if name in home and name not in parts:
            _take_name(thing, name, home[name], parts)
    parts.setdefault(thing.__name__, source.rstrip())


def _class_in_its_cell(thing: Any) -> str:
    """The source of a class by the lines of its methods; "" of anything else.

    inspect asks the module of a class for its file. The module of a notebook has none, but each cell has a name.
    """
    for value in vars(thing).values() if isinstance(thing, type) else ():
        code = getattr(value, "__code__", None)
        if code is None or value.__qualname__ != f"{thing.__qualname__}.{value.__name__}":
            continue
        lines = linecache.getlines(code.co_filename)
        for node in ast.walk(ast.parse("".join(lines))):
            if isinstance(node, ast.ClassDef) and node.name == thing.__name__:
                first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
                if first <= code.co_firstlineno <= (node.end_lineno or first):
                    return "".join(lines[first - 1 : node.end_lineno])
    return ""


def _take_name(user: Any, name: str, value: Any, parts: dict[str, str]) -> None:
    if isinstance(value, ModuleType):
        parts[name] = f"import {value.__name__} as {name}"
    elif isinstance(value, _PLAIN):
        parts[name] = f"{name} = {value!r}"
    elif getattr(value, "__module__", None) == user.__module__ and hasattr(value, "__qualname__"):
        _take(value, parts)
    elif value is not None and _is_importable(value):
        parts[name] = f"from {value.__module__} import {value.__name__} as {name}"
    else:
        raise ClassTextError(
            f"{user.__name__} uses {name}, a {type(value).__name__}; put it into the class, or both into a file"
        )


def _is_importable(value: Any) -> bool:
    module = sys.modules.get(getattr(value, "__module__", None) or "")
    return getattr(module, getattr(value, "__name__", ""), None) is value


def _names(tree: ast.AST) -> set[str]:
    """Names that are read anywhere in it."""
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
