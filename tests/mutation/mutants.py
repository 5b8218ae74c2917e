"""All mutants of a source file: one small change each, spliced into the text, so that everything else stays as written.

Operators are those of the literature (Offutt et al., "An experimental determination of sufficient mutant operators",
1996; Delamaro and Offutt on statement deletion): relational, arithmetic and logical operators, constants, negated
conditions, deleted statements and returned values, swapped arguments. Not mutated: annotations, decorators, docstrings
and other strings, imports, the text of an error, assignments outside of functions (without one nothing imports).
"""

import ast
import re
from collections.abc import Iterator
from typing import NamedTuple

_COMPARISONS = {
    ast.Lt: ("<", ["<=", ">="]),
    ast.LtE: ("<=", ["<", ">"]),
    ast.Gt: (">", [">=", "<="]),
    ast.GtE: (">=", [">", "<"]),
    ast.Eq: ("==", ["!="]),
    ast.NotEq: ("!=", ["=="]),
    ast.Is: (r"is", ["is not"]),
    ast.IsNot: (r"is\s+not", ["is"]),
    ast.In: ("in", ["not in"]),
    ast.NotIn: (r"not\s+in", ["in"]),
}
_ARITHMETIC = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.BitXor: ("^", "|"),
}
_SWAPPED_NAMES = {"min": "max", "max": "min", "any": "all", "all": "any"}
_ORDERLESS = {
    "isinstance",
    "getattr",
    "hasattr",
    "zip",
    "min",
    "max",
    "minimum",
    "maximum",
}  # arguments whose order is no fact of ours
_UNMUTATED = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.Assert, ast.Global, ast.Nonlocal)
_DELETED = (ast.Expr, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Raise, ast.Delete, ast.Assert)


class Mutant(NamedTuple):
    """begin, end: what is replaced, in bytes of the file. line: where, from 1."""

    path: str
    line: int
    kind: str
    begin: int
    end: int
    text: bytes

    def apply(self, source: bytes) -> bytes:
        """The file with the change in it."""
        return source[: self.begin] + self.text + source[self.end :]

    def lines(self, source: bytes) -> tuple[str, str]:
        """The changed lines before and after, stripped; of a deleted statement the first one."""
        start = source.rfind(b"\n", 0, self.begin) + 1
        stop = source.find(b"\n", self.end)
        stop = len(source) if stop < 0 else stop
        before = source[start:stop].decode()
        after = (source[start : self.begin] + self.text + source[self.end : stop]).decode()
        return " ".join(before.split()), " ".join(after.split())


class _Finder:
    """Walks one module; `found` collects (node line, kind, begin, end, replacement)."""

    def __init__(self, path: str, source: bytes) -> None:
        self._path, self._source = path, source
        self._offsets = [0]
        for line in source.splitlines(keepends=True):
            self._offsets.append(self._offsets[-1] + len(line))
        self.found: list[Mutant] = []

    def begin(self, node: ast.AST) -> int:
        return self._offsets[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]

    def end(self, node: ast.AST) -> int:
        return self._offsets[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]

    def text(self, node: ast.AST) -> str:
        return self._source[self.begin(node) : self.end(node)].decode()

    def add(self, node: ast.AST, kind: str, begin: int, end: int, text: str) -> None:
        self.found.append(Mutant(self._path, node.lineno, kind, begin, end, text.encode()))  # type: ignore[attr-defined]

    def replace(self, node: ast.AST, kind: str, text: str) -> None:
        self.add(node, kind, self.begin(node), self.end(node), text)

    def between(self, kind: str, left: ast.AST, right: ast.AST, pattern: str, text: str) -> None:
        """Replace the operator between two operands."""
        gap_begin = self.end(left)
        match = re.search(pattern, self._source[gap_begin : self.begin(right)].decode())
        if match:
            self.add(left, kind, gap_begin + match.start(), gap_begin + match.end(), text)

    def walk(self, node: ast.AST, *, in_function: bool) -> None:
        inside = in_function or isinstance(node, ast.FunctionDef)
        if isinstance(node, ast.stmt):
            self.statement(node, in_function=in_function)
        if isinstance(node, _UNMUTATED) or _is_names_list(node) or _is_for_types(node):
            return
        self.expression(node)
        for child in _children(node):
            self.walk(child, in_function=inside)

    def statement(self, node: ast.stmt, *, in_function: bool) -> None:
        text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)  # a docstring, or ...
        declared = isinstance(node, ast.AnnAssign) and node.value is None
        if in_function and isinstance(node, _DELETED) and not text and not declared:
            self.replace(node, "delete statement", "pass")
        elif isinstance(node, ast.Return) and node.value is not None and not _is_untrue(node.value):
            self.replace(node, "return nothing", "return None")
        elif isinstance(node, ast.Break | ast.Continue):
            self.replace(node, "leave loop", "continue" if isinstance(node, ast.Break) else "break")

    def expression(self, node: ast.AST) -> None:
        match node:
            case ast.Compare():
                self.comparison(node)
            case ast.BinOp() | ast.AugAssign():
                self.arithmetic(node)
            case ast.BoolOp():
                written, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
                for left, right in zip(node.values, node.values[1:], strict=False):
                    self.between("logic", left, right, rf"\b{written}\b", other)
            case ast.UnaryOp():
                self.replace(
                    node, "drop sign" if isinstance(node.op, ast.USub) else "drop not", self.text(node.operand)
                )
            case ast.Constant():
                self.constant(node)
            case ast.If() | ast.While() | ast.IfExp():
                self.negate(node.test)
            case ast.comprehension():
                for test in node.ifs:
                    self.negate(test)
            case ast.Call():
                self.call(node)

    def negate(self, test: ast.expr) -> None:
        self.replace(test, "negate condition", f"(not ({self.text(test)}))")

    def arithmetic(self, node: ast.BinOp | ast.AugAssign) -> None:
        written, other = _ARITHMETIC.get(type(node.op), ("", ""))
        if isinstance(node, ast.AugAssign):
            self.between("arithmetic", node.target, node.value, re.escape(written) + "=", other + "=")
        elif written:
            self.between("arithmetic", node.left, node.right, re.escape(written), other)

    def comparison(self, node: ast.Compare) -> None:
        left: ast.expr = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            pattern, others = _COMPARISONS[type(operator)]
            for other in others:
                self.between("comparison", left, right, pattern, other)
            left = right

    def constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self.replace(node, "constant", str(not value))
        elif isinstance(value, int):
            self.replace(node, "constant", str(value + 1))
            self.replace(node, "constant", f"({value - 1})" if value < 1 else str(value - 1))
        elif isinstance(value, float):
            self.replace(node, "constant", repr(2.0 * value if value else 1.0))

    def call(self, node: ast.Call) -> None:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name in _SWAPPED_NAMES:
            self.replace(node.func, "other function", _SWAPPED_NAMES[name])
        if (
            len(node.args) < 2
            or self.text(node.func).rpartition(".")[2] in _ORDERLESS
            or any(isinstance(a, ast.Starred) for a in node.args[:2])
        ):
            return
        first, second = node.args[:2]
        for_people = all(isinstance(a, ast.Constant) and isinstance(a.value, str) for a in (first, second))
        if self.text(first) != self.text(second) and not for_people:
            gap = self._source[self.end(first) : self.begin(second)].decode()
            text = f"{self.text(second)}{gap}{self.text(first)}"
            self.add(node, "swap arguments", self.begin(first), self.end(second), text)


def _is_untrue(node: ast.expr) -> bool:
    """None, and False: no caller of ours tells it from None; another mutant makes True of it."""
    return isinstance(node, ast.Constant) and (node.value is None or node.value is False)


def _is_assertion(node: ast.AST, child: ast.AST) -> bool:
    """zip's `strict`, which like an assert acts on our own mistakes alone."""
    called = node.func if isinstance(node, ast.Call) else None
    return isinstance(called, ast.Name) and called.id == "zip" and isinstance(child, ast.keyword)


def _is_names_list(node: ast.AST) -> bool:
    return isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _children(node: ast.AST) -> Iterator[ast.AST]:
    unmutated = {"annotation", "returns", "decorator_list", "bases", "keywords"} if _declares(node) else set()
    for name, value in ast.iter_fields(node):
        if name in unmutated:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_assertion(node, child):
                yield child


def _declares(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AnnAssign | ast.arg)


def mutants_of(path: str, source: bytes) -> list[Mutant]:
    """Every mutant of a file; `differs` says of one whether it counts."""
    finder = _Finder(path, source)
    for node in ast.parse(source).body:
        finder.walk(node, in_function=False)
    return sorted(set(finder.found))


def differs(mutant: Mutant, source: bytes) -> bool:
    """Whether the mutant parses, and differs from the file in more than its layout."""
    try:
        return ast.dump(ast.parse(mutant.apply(source))) != ast.dump(ast.parse(source))
    except SyntaxError:
        return False
