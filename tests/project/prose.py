"""How we write, as far as a program can tell: sentences of at most 35 words, and none of the phrases given up.

    python -m tests.project.prose        # part of make lint: file, line, and what to say instead

It reads the README, the pages of docs/ (tables, code and reference pages left out), the texts of faults and events, and
every docstring of a public name.

No linter that is kept and installs from the package registry alone does this: Vale is a program of its own, which its
package downloads, and proselint has no rule for length.
"""

import ast
import re
import sys
from collections.abc import Iterator
from typing import NamedTuple

from hil.cycle.fault_table import ROWS
from hil.events.table import KINDS
from tests.support.paths import ROOT

MOST_WORDS = 35
PACKAGES = ("hil", "drivers", "sim_plant")
MADE = ("_pb2.py",)
# Pages in which people look something up: made from code, or records of measurements.
REFERENCE = {
    "rig-file.md",
    "python.md",
    "faults.md",
    "states.md",
    "answers.md",
    "laws-measured.md",
}
GIVEN_UP = {
    r"\bwhoever\b": "who, or the role: operator, reader, client",
    r"\bof (yours|mine|theirs)\b": "your",
    r"\bis otherwise\b": "differs",
    r"\bbut for\b": "except",
    r"\bnone that\b": "no ... that",
    r"\bin order to\b": "to",
    r"\b(utilise|utilize|leverage)[sd]?\b": "use",
    r"\b(please|simply|obviously|basically)\b": "nothing",
}
PHRASES = [(re.compile(pattern, re.IGNORECASE), instead) for pattern, instead in GIVEN_UP.items()]
_END = re.compile(r"(?<=[.!?])[\")*_]*\s+(?=[\"'`(*_\[]*(?:[A-Z0-9]|[a-z_]\w*(?:, \w+)*: ))")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_CODE = re.compile(r"`[^`]*`")
_WORD = re.compile(r"[^\W_][\w'’.,/-]*")
_ITEM = re.compile(r"^\s*([-*+]|\d+[.)])\s+")
_HEADING = re.compile(r"^\s*(#|\||<!--|!\[|:{3})")


class Sentence(NamedTuple):
    """file: below the root. line: where its paragraph begins. text: its words, code as one word."""

    file: str
    line: int
    text: str


class Finding(NamedTuple):
    """A sentence and what is wrong with it."""

    sentence: Sentence
    wrong: str

    def __str__(self) -> str:
        """As a line of a listing."""
        return f"{self.sentence.file}:{self.sentence.line}: {self.wrong}: {self.sentence.text}"


def sentences_of(paragraph: str) -> list[str]:
    """The sentences of one paragraph, code and links as their words."""
    plain = _CODE.sub("CODE", _LINK.sub(r"\1", " ".join(paragraph.split())))
    return [sentence for sentence in _END.split(plain) if sentence]


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """(line, text) of every paragraph and list item of a Markdown text; headings, tables and code left out."""
    begun, held, fenced = 0, "", False
    for number, line in enumerate([*text.splitlines(), ""], 1):
        fence = line.lstrip().startswith("```")
        fenced ^= fence
        code = fence or fenced or (line.startswith("    ") and not held)
        ends = not line.strip() or code or _HEADING.match(line) or _ITEM.match(line)
        if ends and held:
            yield begun, held
            held = ""
        if not (code or _HEADING.match(line)):
            begun, held = (begun, held) if held else (number, "")
            held += f" {_ITEM.sub('', line)}" if line.strip() else ""


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """(line, text) of the docstrings of a module's public names, and of its own."""
    nodes: list[ast.Module | ast.FunctionDef | ast.ClassDef] = [ast.parse(source)]
    while nodes:
        node = nodes.pop()
        text = ast.get_docstring(node)
        if text:
            yield getattr(node, "lineno", 1), text
        nodes += [
            inner
            for inner in node.body
            if isinstance(inner, ast.FunctionDef | ast.ClassDef) and not inner.name.startswith("_")
        ]


def pages() -> Iterator[tuple[str, int, str]]:
    """(file, line, paragraph) of the documents that are read from top to bottom."""
    folders = (ROOT / "docs", ROOT / "docs" / "adr", ROOT / "examples")
    for path in sorted([*ROOT.glob("*.md"), *(path for folder in folders for path in folder.glob("*.md"))]):
        if path.name not in REFERENCE:
            for line, text in paragraphs(path.read_text(encoding="utf-8")):
                yield path.relative_to(ROOT).as_posix(), line, text


def code() -> Iterator[tuple[str, int, str]]:
    """(file, line, paragraph) of the docstrings of what we ship."""
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        if not path.name.endswith(MADE):
            for line, text in docstrings(path.read_text(encoding="utf-8")):
                for offset, paragraph in paragraphs(text):
                    yield path.relative_to(ROOT).as_posix(), line + offset, paragraph


def messages() -> Iterator[tuple[str, int, str]]:
    """(table, number, text) of what faults and events say to people."""
    for fault, row in ROWS.items():
        for text in (row.seen_by, row.measured, row.cause, row.action):
            yield "hil/cycle/faults", fault.value, text
    for kind, event in KINDS.items():
        for text in (event.text, event.measured, event.cause, event.action):
            yield "hil/events/table.py", kind.value, text


def findings(texts: Iterator[tuple[str, int, str]]) -> Iterator[Finding]:
    """What is wrong with them."""
    for file, line, paragraph in texts:
        for text in sentences_of(paragraph):
            sentence = Sentence(file, line, text)
            count = len(_WORD.findall(text))
            if count > MOST_WORDS:
                yield Finding(sentence, f"{count} words, at most {MOST_WORDS}")
            for pattern, instead in PHRASES:
                if pattern.search(text):
                    yield Finding(sentence, f"say {instead}")


def main() -> None:
    """List what is wrong; exit status 1 where anything is."""
    found = [*findings(pages()), *findings(messages()), *findings(code())]
    sys.exit("\n".join(map(str, found)) or 0)


if __name__ == "__main__":
    main()
