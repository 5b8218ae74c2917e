"""Build pass: makes instances of NamedTuples without the detour through Python that their constructors take.

`Frame(a, b)` runs a Python function that ends in `tuple.__new__(Frame, (a, b, 0, 0))`: 3280 instructions (callgrind,
compiled, Python 3.11), and half of them where compiled code calls the latter itself. `drivers.native.tuple_as` does the
same without the detour through keywords and checks that `tuple.__new__` takes. A tick makes three or more of them. So
the sources say `Frame(a, b)`, and this pass rewrites the copies that are compiled.

Rewritten are calls with positional arguments only, of classes that are defined in, or imported by name from, the
packages being built. Left-out arguments get their default where it is a literal. All other calls stay as they are.
"""

import ast
import io
import tokenize
from pathlib import Path

from deploy.compiled.classes import Key, all_classes, bases, classes_in

Fields = list[ast.expr | None]  # default of each field, None where it has none

_NEW = "_tuple_new"


def find_named_tuples(root: Path, packages: tuple[str, ...]) -> dict[Key, Fields]:
    """Fields of every NamedTuple defined in the packages below `root`, by module and class name."""
    classes = all_classes(root, packages)
    tuples = ((key, node.body) for key, node in classes if "NamedTuple" in bases(node))
    return {key: [item.value for item in body if isinstance(item, ast.AnnAssign)] for key, body in tuples}


def rewrite(text: str, module: str, known: dict[Key, Fields]) -> str:
    """The source of a module with its NamedTuples made directly."""
    tree = ast.parse(text)
    classes = classes_in(tree, module, known)
    behind = {name: line for name, (_, line) in classes.items()}
    lines = text.splitlines(keepends=True)
    used = _rewrite_calls(tree, lines, {name: fields for name, (fields, _) in classes.items()})
    for name in sorted(used, key=lambda name: (-behind[name], name)):
        lines.insert(behind[name], f"_new_{name}: _Final = {name}\n")
    if used:
        last = max(node.end_lineno or 0 for node in tree.body if _goes_first(node))
        first = "from typing import Final as _Final\nfrom drivers.native import tuple_as as _native_tuple_as\n"
        lines.insert(last, f"{first}{_NEW}: _Final = _native_tuple_as\n")
    return "".join(lines)


def _goes_first(node: ast.stmt) -> bool:
    """The docstring, and imports from __future__."""
    is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and node.lineno == 1
    return is_docstring or (isinstance(node, ast.ImportFrom) and node.module == "__future__")


def _rewrite_calls(tree: ast.Module, lines: list[str], classes: dict[str, Fields]) -> set[str]:
    """Rewrite the calls in `lines`; the names of the classes rewritten."""
    trailing = _trailing_commas(lines)
    edits: list[tuple[int, int, int, str]] = []  # line, character from, character to, new text
    used = set()
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in classes):
            continue
        name, fields = node.func.id, classes[node.func.id]
        left_out = fields[len(node.args) :]
        starred = any(isinstance(argument, ast.Starred) for argument in node.args)
        if not node.args or node.keywords or starred or not all(isinstance(value, ast.Constant) for value in left_out):
            continue
        used.add(name)
        line, start = _place(lines, node.func.lineno, node.func.col_offset)
        edits.append((line, start, start + len(name), f"{_NEW}(_new_{name}, "))  # its parenthesis now begins the tuple
        line, end = _place(lines, node.end_lineno or 0, node.end_col_offset or 0)
        comma = "" if (line, end) in trailing else ", "
        edits.append((line, end - 1, end, comma + ", ".join(ast.unparse(value) for value in left_out if value) + "))"))
    for line, start, end, new in sorted(edits, reverse=True):
        lines[line] = lines[line][:start] + new + lines[line][end:]
    return used


def _place(lines: list[str], line: int, byte: int) -> tuple[int, int]:
    """Index of a line and of a character in it, of what ast tells in lines from 1 and bytes."""
    return line - 1, len(lines[line - 1].encode()[:byte].decode())


def _trailing_commas(lines: list[str]) -> set[tuple[int, int]]:
    """Where a closing parenthesis with a comma before it ends: index of its line, and of the character behind it."""
    found = set()
    before = ""
    for token in tokenize.generate_tokens(io.StringIO("".join(lines)).readline):
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            if token.string == ")" and before == ",":
                found.add((token.end[0] - 1, token.end[1]))
            before = token.string
    return found
