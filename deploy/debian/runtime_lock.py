#!/usr/bin/env python3
"""Print the part of requirements.lock that the installed service needs: no linters, no test tools.

usage: runtime_lock.py requirements.lock [EXTRA ...]   (run by the project's .venv, whose metadata it walks)
"""

import re
import sys
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement


def normal(name: str) -> str:
    """A distribution's name as lock files spell it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def closure(name: str, extras: frozenset[str]) -> set[str]:
    """Names of all distributions that `name` with `extras` needs on this Python, itself included."""
    seen: set[tuple[str, frozenset[str]]] = set()
    todo = [(name, extras)]
    while todo:
        current = todo.pop()
        if current in seen:
            continue
        seen.add(current)
        for text in metadata.distribution(current[0]).requires or []:
            requirement = Requirement(text)
            wanted = requirement.marker is None or any(
                requirement.marker.evaluate({"extra": extra}) for extra in (current[1] or {""})
            )
            if wanted:
                todo.append((normal(requirement.name), frozenset(requirement.extras)))
    return {found for found, _ in seen}


def blocks(lock: str) -> dict[str, str]:
    """Name -> its lines (pin and hashes) in a lock file."""
    found: dict[str, str] = {}
    name = ""
    for line in lock.splitlines(keepends=True):
        pin = re.match(r"([A-Za-z0-9._-]+)==", line)
        if pin:
            name = normal(pin[1])
        if name and not line.startswith("#"):
            found[name] = found.get(name, "") + line
    return found


def main(lock: Path, extras: list[str]) -> None:
    """Print the blocks, or fail naming what the lock file lacks."""
    pinned = blocks(lock.read_text())
    needed = sorted(closure("hil", frozenset(["", *extras])) - {"hil"})
    missing = [name for name in needed if name not in pinned]
    if missing:
        sys.exit(f"{lock} lacks {', '.join(missing)}: run `make lock`")
    print("".join(pinned[name] for name in needed), end="")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
