"""Users' programs as their editors see them: `python -m tests.users`, part of `make lint`.

mypy --strict and pyright (strict, as basedpyright packages it) read examples/, the notebooks' code and right/ beside
this file and must find nothing; in wrong/ they must find, on each line that names a rule, that rule, and nothing
on the other lines. basedpyright has an environment of its own (build/types): it brings a whole node.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.paths import ROOT

HERE = Path(__file__).parent
PYRIGHT = ROOT / "build" / "types"
EXPECTED = re.compile(r"# mypy: (?P<mypy>\S+)\s+pyright: (?P<pyright>\S+)$")
TOLD_BY_MYPY = re.compile(r"^(?P<file>[^:]+):(?P<line>\d+): error: .*\[(?P<rule>[\w-]+)\]$")
# matplotlib's own types are unknown in part; the last expression of a cell is shown.
NOTEBOOK = "# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnusedExpression=false\n"

Finding = tuple[str, int, str]  # file, line, rule


def code_of(notebook: Path) -> str:
    """The cells of a notebook as one program."""
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    return NOTEBOOK + "\n\n".join("".join(cell["source"]) for cell in cells) + "\n"


def programs(folder: Path) -> list[Path]:
    """The sources to read; notebooks are written to `folder` first."""
    for notebook in sorted((ROOT / "examples").glob("*.ipynb")):
        (folder / f"notebook_{notebook.stem}.py").write_text(code_of(notebook), encoding="utf-8")
    return [*sorted((ROOT / "examples").rglob("*.py")), *sorted(HERE.rglob("[rw]*/*.py")), *sorted(folder.glob("*.py"))]


def by_mypy(files: list[Path]) -> set[Finding]:
    """What mypy finds; each file by itself, as names such as 01_simulate are no modules."""
    found = set()
    words = [sys.executable, "-m", "mypy", "--strict", "--scripts-are-modules", "--no-error-summary"]
    for group in _apart(files):
        done = subprocess.run([*words, *map(str, group)], cwd=ROOT, capture_output=True, text=True)
        lines = done.stdout.splitlines()
        told = [match for line in lines if (match := TOLD_BY_MYPY.match(line))]
        if done.stderr or (done.returncode and not told):
            raise SystemExit(f"mypy failed: {done.stdout}{done.stderr}")
        found |= {(Path(match["file"]).name, int(match["line"]), match["rule"]) for match in told}
        print(*(line for line in lines if "/wrong/" not in line), sep="\n", end="\n" if lines else "")
    return found


def _apart(files: list[Path]) -> list[list[Path]]:
    """mypy takes the name of a file as that of a module, and 01_simulate.py is none: those go alone."""
    named = [file for file in files if file.stem.isidentifier()]
    return [named, *([file] for file in files if file not in named)]


def by_pyright(files: list[Path], folder: Path) -> set[Finding]:
    """What pyright finds in strict mode."""
    settings = {
        "typeCheckingMode": "strict",
        "pythonVersion": "3.11",
        "include": [str(file) for file in files],
        "extraPaths": [str(ROOT), *map(str, PYRIGHT.glob("lib/python*/site-packages"))],
    }
    (folder / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    words = [PYRIGHT / "bin" / "basedpyright", "-p", folder, "--pythonpath", sys.executable, "--outputjson"]
    done = subprocess.run(list(map(str, words)), cwd=ROOT, capture_output=True, text=True)
    told = json.loads(done.stdout)["generalDiagnostics"]
    assert json.loads(done.stdout)["summary"]["filesAnalyzed"] >= len(files), done.stdout
    found = set()
    for one in told:
        file, line = Path(one["file"]), one["range"]["start"]["line"] + 1
        found.add((file.name, line, one.get("rule", one["message"])))
        if file.parent.name != "wrong":
            print(f"{file}:{line}: {one['message']} [{one.get('rule')}]")
    return found


def expected(checker: str) -> set[Finding]:
    """What the lines of wrong/ say that a checker tells."""
    return {
        (file.name, number, match[checker])
        for file in sorted((HERE / "wrong").glob("*.py"))
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if (match := EXPECTED.search(line))
    }


def main() -> int:
    """0: every right program is right, and every mistake is found."""
    with tempfile.TemporaryDirectory(prefix="hil-users-") as name:
        folder = Path(name)
        files = programs(folder)
        found = {"mypy": by_mypy(files), "pyright": by_pyright(files, folder)}
    wrong = 0
    for checker, findings in found.items():
        wanted = expected(checker)
        marked = {(file, line) for file, line, _ in wanted}  # one mistake may be told in several ways
        missing, more = wanted - findings, {one for one in findings if one[:2] not in marked}
        for text, rows in (("does not find", missing), ("finds", more)):
            wrong += len(rows)
            for file, line, rule in sorted(rows):
                print(f"{checker} {text} {rule}: {file}:{line}")
    print(f"{len(files)} programs of users read by mypy and pyright; {len(expected('mypy'))} mistakes to be found")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
