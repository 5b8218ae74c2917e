"""The notebooks of examples/ with what their cells print and draw: `python -m docs.notebooks`.

A reader on a web page sees the pictures without running anything. Jupyter is not needed: a cell is a piece of a
module, its last expression is shown, and each figure is stored as a PNG file. Runs in virtual time have the same bytes
on every machine, so a test runs the cells again and holds the printed text to what is stored.
"""

import ast
import base64
import contextlib
import io
import json
import linecache
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from pprint import pformat
from types import CodeType, ModuleType
from typing import Any

import matplotlib

FOLDER = Path(__file__).parent.parent / "examples"
_NAME = "notebook"


def outputs_of(document: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """What each code cell of a notebook shows, as nbformat 4.5 stores it; run in an empty folder, in one module."""
    module = ModuleType(_NAME)  # without __file__, as a notebook's is
    sys.modules[_NAME] = module
    cells = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), _drawn_in_memory():
        try:
            return [_shown("".join(cell["source"]), number, module) for number, cell in enumerate(cells, 1)]
        finally:
            del sys.modules[_NAME]


@contextlib.contextmanager
def _drawn_in_memory() -> Iterator[None]:
    with matplotlib.rc_context({"figure.dpi": 80, "figure.figsize": (7, 4), "figure.constrained_layout.use": True}):
        matplotlib.use("Agg")
        yield


def _shown(source: str, number: int, module: ModuleType) -> list[dict[str, Any]]:
    """Run one cell: what it printed, its last expression, its figures."""
    name = f"<cell {number}>"
    linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
    body, last = _split(source, name)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(body, vars(module))
        value = eval(last, vars(module)) if last else None
    shown: list[dict[str, Any]] = []
    if printed.getvalue():
        shown.append({"output_type": "stream", "name": "stdout", "text": _lines(printed.getvalue())})
    if value is not None:
        data = {"text/plain": _lines(pformat(value, width=100))}
        shown.append({"output_type": "execute_result", "execution_count": number, "data": data, "metadata": {}})
    return shown + _figures()


def _split(source: str, name: str) -> tuple[CodeType, CodeType | None]:
    """The statements of a cell, and its last expression unless a semicolon ends it."""
    tree = ast.parse(source)
    last = tree.body[-1] if tree.body else None
    if not isinstance(last, ast.Expr) or source.rstrip().endswith(";"):
        return compile(tree, name, "exec"), None
    tree.body.pop()
    return compile(tree, name, "exec"), compile(ast.Expression(last.value), name, "eval")


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def _figures() -> list[dict[str, Any]]:
    """Every figure that is open, as PNG; closes them."""
    from matplotlib import pyplot

    found = []
    for number in pyplot.get_fignums():
        file = io.BytesIO()
        pyplot.figure(number).savefig(file, format="png", metadata={"Software": None})
        data = {"image/png": base64.b64encode(file.getvalue()).decode()}
        found.append({"output_type": "display_data", "data": data, "metadata": {}})
    pyplot.close("all")
    return found


def main() -> None:
    """Store what the cells of every notebook show."""
    os.environ["MPLBACKEND"] = "Agg"
    for path in sorted(FOLDER.glob("*.ipynb")):
        document = json.loads(path.read_text(encoding="utf-8"))
        cells = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
        for number, (cell, shown) in enumerate(zip(cells, outputs_of(document), strict=True), 1):
            cell["outputs"], cell["execution_count"] = shown, number
        path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(path.name)


if __name__ == "__main__":
    main()
