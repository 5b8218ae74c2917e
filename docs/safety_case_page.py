"""docs/safety-case.md: its requirements, and which faults and tests carry their names.

People write the page; the table between BEGIN and END is made from the rows in hil/cycle/faults/ and from the
marks `@pytest.mark.requirement(id=...)` of tests.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from hil.cycle.fault_table import ROWS

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "safety-case.md"
BEGIN = "<!-- trace: made by `make docs` -->"
END = "<!-- end of trace -->"
_REQUIREMENT = re.compile(r"^\| (SR-\d+\.\d+) \| ([^|]+) \|", re.MULTILINE)


def requirements(text: str) -> dict[str, str]:
    """What each requirement of that page demands, by its identifier, in the page's order."""
    return {name: demand.strip() for name, demand in _REQUIREMENT.findall(text.partition(BEGIN)[0])}


def served_by_faults() -> dict[str, list[str]]:
    """Names of faults by the requirement that their row names; "" holds those that name none."""
    carried: dict[str, list[str]] = {}
    for row in ROWS.values():
        carried.setdefault(row.requirement, []).append(row.name.lower())
    return carried


def _marks_in(source: str) -> Iterator[str]:
    """The identifiers of one file of tests, once a mark."""
    if "requirement" not in source:  # most files: they need not be parsed
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "requirement":
            yield from (keyword.value.value for keyword in node.keywords if isinstance(keyword.value, ast.Constant))


def held_by_tests(folder: Path = ROOT / "tests") -> dict[str, Counter[str]]:
    """How many tests of each file name a requirement, by its identifier."""
    carried: dict[str, Counter[str]] = {}
    for path in sorted(folder.rglob("test_*.py")):
        for name in _marks_in(path.read_text(encoding="utf-8")):
            carried.setdefault(name, Counter())[path.relative_to(folder.parent).as_posix()] += 1
    return carried


def trace_table(demanded: dict[str, str]) -> str:
    """A line for each requirement: its faults and the tests that hold it."""
    faults, tests = served_by_faults(), held_by_tests()
    lines = ["| requirement | faults | tests |", "|---|---|---|"]
    for name in demanded:
        files = ", ".join(f"{count} in `{path}`" for path, count in tests.get(name, Counter()).items())
        lines.append(f"| {name} | {', '.join(faults.get(name, []))} | {files} |")
    return "\n".join(lines)


def safety_case_page() -> str:
    """docs/safety-case.md with its table as it should be."""
    text = PAGE.read_text(encoding="utf-8")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    return f"{before}{BEGIN}\n\n{trace_table(requirements(text))}\n\n{END}{after}"
