"""Build pass: makes the flags that compiled code combines with & and | plain ints.

`status & DriveStatus.ENABLED` runs the operator of a flag, which is written in Python: 7600 instructions, and a tick
does so four times (callgrind's count; docs/what-costs-what.md). The sources say so all the same. This pass rewrites the
copies that are compiled: behind the imports (or the class, where it is the module's own) stands

    _DriveStatus_ENABLED: Final = int(DriveStatus.ENABLED)

and inside functions that name. Rewritten are members of an IntFlag that is defined in, or imported by name from, the
packages being built; not where a pattern is matched (`case DriveStatus.ENABLED`), where a name would match anything,
and not where the function has a variable of that name. Members of an IntEnum need no such thing: mypyc reads those of
a compiled enum without a look-up.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

from deploy.compiled.classes import Key, all_classes, bases, classes_in

Known = dict[Key, frozenset[str]]  # members of each flag


def find_flags(root: Path, packages: tuple[str, ...]) -> Known:
    """Every IntFlag defined in the packages below `root`."""
    found = {}
    for key, node in all_classes(root, packages):
        if "IntFlag" in bases(node):
            targets = [item.targets[0] for item in node.body if isinstance(item, ast.Assign)]
            found[key] = frozenset(item.id for item in targets if isinstance(item, ast.Name))
    return found


def hoist(text: str, module: str, known: Known) -> str:
    """The source of a module with its flags as plain ints."""
    tree = ast.parse(text)
    classes = classes_in(tree, module, known)
    flags = {name: members for name, (members, _) in classes.items()}
    behind = {name: line for name, (_, line) in classes.items()}
    lines = text.encode().splitlines(keepends=True)  # ast counts columns in bytes
    uses = [use for function in _functions(tree) for use in _uses(function, flags)]
    for use in sorted(uses, key=lambda use: (use.lineno, use.col_offset), reverse=True):
        line = lines[use.lineno - 1]
        lines[use.lineno - 1] = line[: use.col_offset] + _constant(use).encode() + line[use.end_col_offset :]
    definitions = {_constant(use): ast.unparse(use.value) for use in uses}
    members = {_constant(use): ast.unparse(use) for use in uses}
    for constant in sorted(definitions, key=lambda constant: behind[definitions[constant]], reverse=True):
        definition = f"{constant}: _Final = int({members[constant]})\n"
        lines.insert(behind[definitions[constant]], definition.encode())
    if uses:
        first = min(node.lineno for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom))
        lines.insert(first - 1, b"from typing import Final as _Final\n")
    return b"".join(lines).decode()


def _constant(use: ast.Attribute) -> str:
    return f"_{ast.unparse(use.value)}_{use.attr}"


def _functions(tree: ast.Module | ast.ClassDef) -> Iterator[ast.FunctionDef]:
    """Functions of a module and methods of its classes; what is nested in them is theirs."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            yield node
        elif isinstance(node, ast.ClassDef):
            yield from _functions(node)


def _uses(function: ast.FunctionDef, flags: dict[str, frozenset[str]]) -> Iterator[ast.Attribute]:
    inside = list(ast.walk(function))
    own = {node.id for node in inside if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    own |= {node.arg for node in inside if isinstance(node, ast.arg)}
    patterns = {id(node.value) for node in inside if isinstance(node, ast.MatchValue)}
    outside = {id(node) for part in _evaluated_outside(function) for node in ast.walk(part)}
    for node in inside:
        if not isinstance(node, ast.Attribute) or not isinstance(node.value, ast.Name):
            continue
        name = node.value.id
        member = name in flags and name not in own and node.attr in flags[name]
        if member and id(node) not in patterns and id(node) not in outside:
            yield node


def _evaluated_outside(function: ast.FunctionDef) -> list[ast.AST]:
    """What runs when the module is loaded, or never: decorators, defaults, annotations."""
    arguments = function.args
    defaults = [*arguments.defaults, *(default for default in arguments.kw_defaults if default)]
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    annotations = [argument.annotation for argument in every if argument.annotation]
    return [*function.decorator_list, *defaults, *annotations, *([function.returns] if function.returns else [])]
