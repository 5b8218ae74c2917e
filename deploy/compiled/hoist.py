"""What compiled code would otherwise do at every use, done once a module: a rewriting of the copied sources.

mypyc looks an enum's member up by its name, through two dictionaries, wherever it is written, and calls a NamedTuple's
constructor, which is a Python function, with its arguments packed. The sources write `State.ACTIVE` and
`Command(1, force, 0, reset)` all the same; this pass makes of them, inside functions only,

    _State_ACTIVE: Final = State.ACTIVE            once, behind the imports (a flag as a plain int: so are its uses)
    _tuple_new(_class_Command, (1, force, 0, reset))    what the constructor ends in

A member is hoisted where its enum is imported by name, or defined in the module; a NamedTuple is constructed directly
where the call names every field, by place or keyword, or leaves out fields with plain defaults.
"""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple


@dataclass
class Classes:
    """Enums and NamedTuples of the packages, by (module, name)."""

    enums: dict[tuple[str, str], list[str]] = field(default_factory=dict)  # members
    flags: set[tuple[str, str]] = field(default_factory=set)
    tuples: dict[tuple[str, str], dict[str, str | None]] = field(default_factory=dict)  # fields, their defaults


class Edit(NamedTuple):
    """Replace bytes [begin, end) of a source."""

    begin: int
    end: int
    text: str


def find_classes(root: Path, packages: tuple[str, ...]) -> Classes:
    """All enums and NamedTuples below root that are written with the class syntax."""
    found = Classes()
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            module = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef):
                    _note(found, module, node)
    return found


def _note(found: Classes, module: str, node: ast.ClassDef) -> None:
    bases = {base.id for base in node.bases if isinstance(base, ast.Name)}
    key = module, node.name
    if bases & {"Enum", "IntEnum", "IntFlag"}:
        assigned = [item.targets[0] for item in node.body if isinstance(item, ast.Assign)]
        found.enums[key] = [target.id for target in assigned if isinstance(target, ast.Name)]
        if "IntFlag" in bases:
            found.flags.add(key)
    elif "NamedTuple" in bases:
        fields = [item for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)]
        found.tuples[key] = {
            item.target.id: None if item.value is None else ast.unparse(item.value)
            for item in fields
            if isinstance(item.target, ast.Name)
        }


class Hoisting:
    """The rewriting of one module."""

    def __init__(self, source: str, module: str, classes: Classes) -> None:
        self._source = source.encode()
        self._tree = ast.parse(source)
        self._starts = [0]
        for line in self._source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        names = dict(_imported(self._tree)) | {
            node.name: (module, node.name) for node in self._tree.body if isinstance(node, ast.ClassDef)
        }
        self._enums = {name: key for name, key in names.items() if key in classes.enums}
        self._tuples = {name: classes.tuples[key] for name, key in names.items() if key in classes.tuples}
        self._classes = classes
        self._hoisted: dict[str, tuple[str, str]] = {}  # definition -> (name, class it needs)
        self._edits: list[Edit] = []

    def rewritten(self) -> str:
        """The module's new source; the old one where nothing is to be hoisted."""
        for node in self._tree.body:
            for function in _functions(node):
                self._visit_body(function)
        if not self._edits:
            return self._source.decode()
        text = self._source
        inserts = [Edit(at, at, lines) for at, lines in self._definitions().items()]
        for edit in sorted([*self._edits, *inserts], reverse=True):
            text = text[: edit.begin] + edit.text.encode() + text[edit.end :]
        return text.decode()

    def _definitions(self) -> Mapping[int, str]:
        """Source of the constants, by the place where it goes: behind the imports, or behind the class it needs."""
        places: dict[int, str] = {}
        imports = [node for node in self._tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
        own = {node.name: node for node in self._tree.body if isinstance(node, ast.ClassDef)}
        for definition, (_, needed) in self._hoisted.items():
            after = own.get(needed, imports[-1])
            at = self._starts[after.end_lineno or 0]
            places[at] = places.get(at, "") + definition + "\n"
        first = self._starts[imports[-1].end_lineno or 0]
        places[first] = "from typing import Final as _Final\n_tuple_new: _Final = tuple.__new__\n" + places.get(
            first, ""
        )
        return places

    def _visit_body(self, function: ast.FunctionDef) -> None:
        local = {
            name.id for name in ast.walk(function) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
        }
        local |= {argument.arg for argument in ast.walk(function) if isinstance(argument, ast.arg)}
        for statement in function.body:
            self._visit(statement, local)

    def _visit(self, node: ast.AST, local: set[str]) -> None:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id not in local:
            self._member(node, node.value.id)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id not in local:
            self._construct(node, node.func.id)
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.pattern):  # `case State.ACTIVE`: a plain name there would match anything
                self._visit(child, local)

    def _member(self, node: ast.Attribute, name: str) -> None:
        key = self._enums.get(name)
        if key is None or node.attr not in self._classes.enums[key] or not isinstance(node.ctx, ast.Load):
            return
        hoisted = f"_{name}_{node.attr}"
        value = f"int({name}.{node.attr})" if key in self._classes.flags else f"{name}.{node.attr}"
        self._hoisted[f"{hoisted}: _Final = {value}"] = hoisted, name
        self._replace(node, node, hoisted)

    def _construct(self, node: ast.Call, name: str) -> None:
        fields = self._tuples.get(name)
        arguments = [*node.args, *(keyword.value for keyword in node.keywords)]
        if fields is None or not arguments or any(isinstance(argument, ast.Starred) for argument in arguments):
            return
        given = [keyword.arg for keyword in node.keywords]
        rest = list(fields)[len(node.args) :]
        # By keyword only in the fields' own order: the arguments are evaluated in the order in which they are written.
        if given != [item for item in rest if item in given]:
            return
        missing = [item for item in rest if item not in given]
        if rest[: len(given)] != given or any(fields[item] is None for item in missing):
            return
        hoisted = f"_class_{name}"
        self._hoisted[f"{hoisted}: _Final = {name}"] = hoisted, name
        self._replace(node.func, node.func, f"_tuple_new({hoisted}, (")
        opening = self._source.index(b"(", self._at(node.func.end_lineno, node.func.end_col_offset))
        self._edits.append(Edit(opening, opening + 1, ""))
        for keyword in node.keywords:
            begin = self._at(keyword.lineno, keyword.col_offset)
            self._edits.append(Edit(begin, self._at(keyword.value.lineno, keyword.value.col_offset), ""))
        end = self._at(node.end_lineno, node.end_col_offset)
        defaults = "".join(f", {fields[item]}" for item in missing)
        comma = "," if len(fields) == 1 else ""
        last = max(self._at(argument.end_lineno, argument.end_col_offset) for argument in arguments)
        self._edits.append(Edit(last, end, f"{defaults}{comma}))"))

    def _replace(self, first: ast.expr, last: ast.expr, text: str) -> None:
        begin = self._at(first.lineno, first.col_offset)
        self._edits.append(Edit(begin, self._at(last.end_lineno, last.end_col_offset), text))

    def _at(self, line: int | None, column: int | None) -> int:
        return self._starts[(line or 1) - 1] + (column or 0)


def _imported(tree: ast.Module) -> Iterator[tuple[str, tuple[str, str]]]:
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                yield alias.asname or alias.name, (node.module, alias.name)


def _functions(node: ast.stmt) -> Iterator[ast.FunctionDef]:
    if isinstance(node, ast.FunctionDef):
        yield node
    elif isinstance(node, ast.ClassDef):
        for item in node.body:
            yield from _functions(item)


def hoist(path: Path, module: str, classes: Classes) -> None:
    """Rewrite one copied module in place."""
    path.write_text(Hoisting(path.read_text(), module, classes).rewritten())
