"""Which of our own classes a module knows by name, and from which line on: what both passes over the sources ask."""

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeVar

Key = tuple[str, str]  # module and class name
T = TypeVar("T")


def all_classes(root: Path, packages: tuple[str, ...]) -> Iterator[tuple[Key, ast.ClassDef]]:
    """Every class that a module of the packages below `root` defines."""
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            module = ".".join(path.relative_to(root).with_suffix("").parts)
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef):
                    yield (module, node.name), node


def bases(node: ast.ClassDef) -> set[str]:
    """What a class inherits from, as its source says it."""
    return {ast.unparse(base) for base in node.bases}


def classes_in(tree: ast.Module, module: str, known: Mapping[Key, T]) -> dict[str, tuple[T, int]]:
    """Those of the `known` classes that a module defines or imports by name: what is known of each, and the line after
    which the class is there."""
    found = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            names = [(alias.asname or alias.name, (node.module or "", alias.name)) for alias in node.names]
        elif isinstance(node, ast.ClassDef):
            names = [(node.name, (module, node.name))]
        else:
            continue
        found.update({name: (known[key], node.end_lineno or 0) for name, key in names if key in known})
    return found
