"""The rules of the house: small files, short signatures, plain words, no reference that leads nowhere."""

import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import hil
from tests.support.paths import ROOT

FOLDERS = ("hil", "examples", "drivers", "sim_plant", "tests", "deploy", "docs", ".ci")
KINDS = {".py", ".c", ".sh", ".md", ".toml", ".mk", ".proto", ".dbc"}
GENERATED = {"hil/telemetry/telemetry_pb2.py", "hil/telemetry/events_pb2.py", "docs/rig-file.md", "docs/python.md"}
MANY_LINES = 400  # more: a warning with a list, so that nobody has to split a file in the midst of another change
MOST_LINES = 600
MOST_ARGUMENTS = 7

# Words this project has given up -> what it says instead. Patterns are for names as well as for prose, and leave the
# same letters in ordinary English alone.
GLOSSARY = {
    r"(?<![a-z])voyages?(?![a-z])": "run",
    r"(?<![a-z])sail(s|ed|ing)?(?![a-z])": "plan, run",
    r"(?<![a-z])legs?(?![a-z])": "chunk",
    r"(?-i:\bMeans\b[\[\](),.:|]|_means\b|\bmeans(_| =|: [A-Z]))": "capabilities",
    r"(?<![a-z])beliefs?(?![a-z])": "nominal model",
    r"rehears": "candidate simulation",
    r"(?-i:\bPlaces\b|\bplaces\(|\bplaces_in\b|\brig_places\b|import .*\bplaces\b)": "runtime paths",
    r"(?<![a-z])doors?(?![a-z])": "listening socket",
    r"(?<![a-z])knock": "join notice",
    r"(?<![a-z])greet": "handshake",
    r"(?<![a-z])short[ _]way(?![a-z])": "fast path",
    r"(?<![a-z])long[ _]way(?![a-z])": "slow path",
    r"(?<![a-z])strangers?(?![a-z])": "unknown frame",
    r"(?<![a-z])(let|lets|letting)[ _]out(?![a-z])": "applied force",
    r"(\bdef |\.)see\(": "flag (a fault)",
}
WORDS = [(re.compile(pattern, re.IGNORECASE), instead) for pattern, instead in GLOSSARY.items()]
DOCUMENT = re.compile(r"[\w-]+\.md\b|\bFIELD_NOTES\b")
NAMED_FILE = re.compile(
    r"(?<![\w.-])(?<!etc/)(?<!share/)(?:hil|drivers|sim_plant|tests|deploy|docs)/[\w./@-]*\.(?:py|c|sh|toml|md|mk|eds|dbc|proto|png|svg)\b"
)
MODULE = re.compile(r"(?<![\w./@-])(?:hil|drivers|sim_plant)\.\w\w+")
MADE_BY_THE_BUILD = ("hil/floats/", "sim_plant/floats/")
NO_MODULES = {
    "hil.floats",
    "sim_plant.floats",
    "hil.estimators",
    "hil.laws",
    "hil.motions",
    "hil.detectors",
    "hil.sensors",
    "hil.layouts",
    "hil.tasks",
    "hil.stages",
    "hil.target",
}  # of the build; an entry point group; a systemd unit
HERE = Path(__file__).relative_to(ROOT).as_posix()


@cache
def sources() -> tuple[tuple[str, str], ...]:
    """(path, text) of every file that people of this project write, read once."""
    return tuple(_read())


def _read() -> Iterator[tuple[str, str]]:
    inside = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if "__pycache__" not in path.parts)
    for path in sorted([*inside, *ROOT.glob("*.md"), ROOT / "Makefile", ROOT / "pyproject.toml"]):
        name = path.relative_to(ROOT).as_posix()
        written = path.suffix in KINDS or path.name in ("Makefile", "run")
        if path.is_file() and written and name not in GENERATED | {HERE}:
            yield name, path.read_text(encoding="utf-8")


def found(pattern: re.Pattern[str]) -> list[tuple[str, int, str]]:
    """(file, line number, what matched) of a pattern, in all of them."""
    return [
        (name, text.count("\n", 0, match.start()) + 1, match[0])
        for name, text in sources()
        for match in pattern.finditer(text)
    ]


def listing(findings: list[tuple[str, int, str]]) -> str:
    return "\n".join(f"{name}:{number}: {what}" for name, number, what in findings)


def test_the_patterns_find_names_and_prose_and_spare_ordinary_english() -> None:
    for text in ("class Voyage:", "leg_cells", "Means.ROOM", "means = ", "it lets out a force", "fixed_means(p)"):
        assert any(pattern.search(text) for pattern, _ in WORDS), text
    for text in ("by means of", "what it means | this", "legal", "indoors", "decimal places", "see below", "judge by"):
        assert not any(pattern.search(text) for pattern, _ in WORDS), text


def test_no_merge_was_left_half_done() -> None:
    at = found(re.compile(r"^(?:<{7}|>{7}) .*", re.MULTILINE))
    assert not at, listing(at)


def test_no_file_is_long() -> None:
    counts = {name: len(text.splitlines()) for name, text in sources()}
    long = sorted(f"{name}: {count}" for name, count in counts.items() if count > MANY_LINES)
    if long:
        warnings.warn(f"files of more than {MANY_LINES} lines, to be split: {', '.join(long)}", stacklevel=1)
    assert {name: count for name, count in counts.items() if count > MOST_LINES} == {}


def too_many_arguments(*words: str, given: str = "") -> str:
    """What ruff says of functions that take many arguments by position, self or cls not counted."""
    limit = f"lint.pylint.max-positional-args={MOST_ARGUMENTS}"
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--no-cache", "--quiet", "--preview"]
    done = subprocess.run(
        [*command, "--select=PLR0917", "--config", limit, "--output-format=concise", *words],
        input=given, cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.stdout + done.stderr


def test_no_function_takes_many_arguments_by_position() -> None:
    assert "(8 > 7)" in too_many_arguments("-", given="class A:\n    def f(self, a, b, c, d, e, f, g, h): ...")
    assert too_many_arguments("-", given="class A:\n    def f(self, a, b, c, d, e, f, g, *, h): ...") == ""
    assert too_many_arguments(*FOLDERS) == ""


@pytest.mark.parametrize(("pattern", "instead"), WORDS, ids=GLOSSARY.values())
def test_no_word_that_was_given_up(pattern: re.Pattern[str], instead: str) -> None:
    findings = found(pattern)
    assert not findings, f"say {instead}:\n{listing(findings)}"


def exists(named: str, beside: str) -> bool:
    """Whether a document of that name is at the root, in docs/, or beside the file that names it."""
    return any((folder / named).exists() for folder in (ROOT, ROOT / "docs", ROOT / "docs/adr", (ROOT / beside).parent))


def test_every_document_that_is_cited_is_here() -> None:
    findings = [entry for entry in found(DOCUMENT) if not exists(entry[2], entry[0])]
    assert not findings, listing(findings)


def test_every_file_that_is_named_is_where_it_is_said_to_be() -> None:
    """In comments, docstrings, documents and scripts: moves leave no path behind."""
    findings = [
        entry
        for entry in found(NAMED_FILE)
        if not (ROOT / entry[2]).exists() and not entry[2].startswith(MADE_BY_THE_BUILD)
    ]
    assert not findings, listing(findings)


def test_every_module_that_is_named_exists() -> None:
    """Its first two parts, or what `hil` itself exports: in comments and documents, where no import would fail."""
    findings = [
        entry
        for entry in found(MODULE)
        if entry[2] not in NO_MODULES
        and not hasattr(hil, entry[2].partition(".")[2])
        and not (ROOT / entry[2].replace(".", "/")).is_dir()
        and not (ROOT / entry[2].replace(".", "/")).with_suffix(".py").exists()
    ]
    assert not findings, listing(findings)
