"""The digest of an installed plug-in's code: what the text is to a plug-in of a file (plugins.py).

Of all source files of the largest package around its module that stays within MOST_FILES and MOST_BYTES; of a module
outside packages, or where none does, of its own file. Nothing is imported to find it.
"""

import hashlib
import os
from collections.abc import Iterator
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path

MOST_FILES = 1000  # source files of a package
MOST_ENTRIES = 10_000  # files and folders of any kind that are looked at for them
MOST_BYTES = 2**25
SUFFIXES = (".py", ".so", ".pyd")


@cache
def digest_of(module: str) -> str:
    """SHA-256 of an installed module's code, once for every process; empty where it has no file, as in a notebook.

    Raises OSError where a file cannot be read.
    """
    places = list(_places(module))
    for place in places:
        files = _files(place) if place.is_dir() else [place]
        if files:
            return _digest(place, files)
    return _digest(places[-1], [places[-1] / "__init__.py"]) if places else ""


def _places(module: str) -> Iterator[Path]:
    """The folders of the packages around a module, the outermost first, and at last its own file."""
    names = module.split(".")
    try:
        spec = find_spec(names[0])
        for number in range(1, len(names) + 1):
            if spec is None:
                return
            inside = spec.submodule_search_locations
            file = Path(spec.origin) if spec.has_location and spec.origin else None
            if file and file.is_file():  # not of a namespace, nor in an archive
                yield file.parent if inside is not None else file
            if number < len(names):
                spec = PathFinder.find_spec(names[number], list(inside)) if inside is not None else None
    except (ImportError, ValueError, AttributeError):  # no name of a module, or one that was not found as others are
        return


def _files(folder: Path) -> list[Path]:
    """The source files below a folder; none where they are too many."""
    found, entries, size = [], 0, 0
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        entries += len(folders) + len(names)
        files = [path for path in (Path(place, name) for name in names if name.endswith(SUFFIXES)) if path.is_file()]
        found += files
        size += sum(path.stat().st_size for path in files)
        if entries > MOST_ENTRIES or len(found) > MOST_FILES or size > MOST_BYTES:
            return []
    return found


def _digest(place: Path, files: list[Path]) -> str:
    """Over names and contents, in the names' order."""
    folder = place if place.is_dir() else place.parent
    whole = hashlib.sha256()
    for name, path in sorted((path.relative_to(folder).as_posix(), path) for path in files):
        with path.open("rb") as stream:
            own = hashlib.file_digest(stream, "sha256").hexdigest()
        whole.update(f"{name}\0{own}\n".encode())
    return whole.hexdigest()
