"""Goldens: what the product does, as text that a person can review. One story a file, tests/golden/ROOM/STORY.txt.

A room is a folder with a tell.py. Its `stories()` names every story, and `tell(story)` returns the lines of one: a line
an event, a figure with its unit. Whatever the lines leave out stands among them as a hash. A story is drawn from its
name alone, so a new story or a new kind of event moves no other file. `SLOW = True` marks a room that takes minutes.

Tests call `hold`. `python -m tests.golden` shows what differs, and accepts it room by room.
"""

import difflib
import hashlib
import importlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).parent
REASONS = "REASONS"


class Change(NamedTuple):
    """A golden that is not what its room tells now. kind: "changed", "new" or "gone". lines: of a diff, without
    headings. text: what the file should hold.
    """

    path: Path
    kind: str
    lines: tuple[str, ...] = ()
    text: str = ""


def rooms() -> list[str]:
    """Every folder here with a tell.py."""
    return sorted(path.parent.name for path in HERE.glob("*/tell.py"))


def teller(room: str) -> Any:
    """The room's module tell.py."""
    return importlib.import_module(f"tests.golden.{room}.tell")


def path_of(room: str, story: str) -> Path:
    """Where a story's golden is."""
    return HERE / room / (re.sub(r"[^\w.=+-]+", "-", story).strip("-") + ".txt")


def change(room: str, story: str, lines: Iterable[str]) -> Change | None:
    """How the golden of a story differs from these lines; None where it does not."""
    path, text = path_of(room, story), "\n".join([f"# {story}", *lines]) + "\n"
    known = path.read_text(encoding="utf-8") if path.exists() else ""
    if known == text:
        return None
    difference = list(difflib.unified_diff(known.splitlines(), text.splitlines(), lineterm="", n=1))[2:]
    return Change(path, "changed" if known else "new", tuple(difference), text)


def changes(room: str) -> Iterator[Change]:
    """Every golden of a room that differs, those that no story has any more included."""
    tell, stories = teller(room), list(teller(room).stories())
    for story in stories:
        if found := change(room, story, tell.tell(story)):
            yield found
    for path in stray(room):
        yield Change(path, "gone")


def stray(room: str) -> list[Path]:
    """Goldens of a room that belong to no story of it."""
    kept = {path_of(room, story) for story in teller(room).stories()}
    return [path for path in sorted((HERE / room).glob("*.txt")) if path not in kept]


def hold(room: str, story: str, lines: Sequence[str] | None = None) -> None:
    """Assert that a story is what its golden says. lines: what was told, where the caller has it already."""
    found = change(room, story, teller(room).tell(story) if lines is None else lines)
    assert found is None, "\n".join([f"{found.path}:", *found.lines, f"make review {room}"])


def accept(room: str, reason: str, today: str) -> list[Change]:
    """Write the goldens of one room anew, and the reason beside them; what was changed. Where nothing differs, nothing
    is written. Raises ValueError for a reason that says nothing.
    """
    if len(reason.split()) < 3:
        raise ValueError(f"reason = '{reason}': say in a sentence why these goldens change")
    found = list(changes(room))
    for each in found:
        if each.kind == "gone":
            each.path.unlink()
        else:
            each.path.write_text(each.text, encoding="utf-8")
    if found:
        names = ", ".join(f"{each.path.stem} ({each.kind})" for each in found[:5])
        more = f" and {len(found) - 5} more" if len(found) > 5 else ""
        with (HERE / room / REASONS).open("a", encoding="utf-8") as file:
            file.write(f"- {today}: {reason}\n  {len(found)} goldens: {names}{more}\n")
    return found


def sha256(*parts: str | bytes, digits: int = 16) -> str:
    """Hash of what a golden leaves out."""
    told = hashlib.sha256()
    for part in parts:
        told.update(part.encode() if isinstance(part, str) else part)
    return told.hexdigest()[:digits]


def outline(value: Any, name: str = "") -> Iterator[str]:
    """Nested tables as lines `path: value`. Plain values share a line; a text of several lines keeps them."""
    if isinstance(value, dict) and value and not all(map(_plain, value.values())):
        for key, item in value.items():
            yield from outline(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list) and not all(map(_plain, value)):
        for number, item in enumerate(value):
            yield from outline(item, f"{name}[{number}]")
    elif isinstance(value, str) and "\n" in value:
        yield f"{name}:"
        yield from ("    " + line for line in value.splitlines())
    elif isinstance(value, dict):
        yield f"{name}: " + ", ".join(f"{key} {_shown(item)}" for key, item in value.items())
    elif isinstance(value, list):
        yield f"{name}: [{', '.join(map(_shown, value))}]"
    else:
        yield f"{name}: {_shown(value)}"


def _plain(value: Any) -> bool:
    return not isinstance(value, dict | list) and not (isinstance(value, str) and len(value) > 40)


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
