"""What `hil install` has put below a root: its manifest, what may be overwritten or removed, and what is masked."""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from drivers.base.named_file import write_text

MANIFEST = "etc/hil/installed.json"
RIGS = "etc/hil/rigs"
CACHE = "var/cache/hil"  # the units' CacheDirectory=: filter designs, computed again where they are missing
KEPT = "var/lib/hil"  # the units' StateDirectory=: recordings
_UNIT_FOLDERS = ("etc/systemd/system", "run/systemd/system")
_MASK = "/dev/null"
_NO_FILE = "no file"
_OURS: Final = re.compile(
    r"etc/(systemd/(system|network)|sysusers\.d|tmpfiles\.d|udev/rules\.d)/([^/]+\.wants/)?(\d\d-)?hil[-.@]"
)
_LONGEST_SHOWN: Final = 200  # letters of an entry

Files = dict[str, str]  # path relative to the root -> content
Links = dict[str, str]  # path relative to the root -> what the symbolic link says


class InstallError(Exception):
    """What cannot be installed, and what to do instead."""


def read_manifest(root: Path) -> dict[str, str]:
    """What was put where, by its path relative to the root. Raises InstallError for an entry that leads out of it, and
    for one that no installation ever made.
    """
    path = root / MANIFEST
    try:
        entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (OSError, ValueError, RecursionError) as error:
        raise InstallError(f"{path}: {error}") from None
    if not isinstance(entries, dict) or not all(isinstance(value, str) for value in entries.values()):
        raise InstallError(f"{path}: expected a JSON object of texts")
    for entry in entries:
        if wrong := _is_wrong(root, entry):
            raise InstallError(f"{path}: the entry {_short(entry)} {wrong}; nothing was removed or written")
    return entries


def _is_wrong(root: Path, entry: str) -> str:
    """Why nothing may be removed at this entry; empty: it may."""
    try:
        if ".." in Path(entry).parts or not (root / entry).parent.resolve().is_relative_to(root.resolve()):
            return f"leads out of {root}"
        (root / entry).is_symlink()
    except (OSError, RuntimeError, ValueError):  # a name or a loop of links that no file system has
        return "names no file"
    return "" if _OURS.match(entry) else "is no file of `hil install`"


def _short(entry: str) -> str:
    """For people: a name of any length and any letters."""
    return repr(entry) if len(entry) <= _LONGEST_SHOWN else f"{entry[:_LONGEST_SHOWN]!r}..."


def write_manifest(root: Path, manifest: dict[str, str]) -> None:
    """Raises OSError that names it."""
    place = root / MANIFEST
    place.parent.mkdir(parents=True, exist_ok=True)
    write_text(place, json.dumps(manifest, indent=1, sort_keys=True) + "\n")


def is_masked(path: Path) -> bool:
    """As `systemctl mask` leaves a unit."""
    return path.is_symlink() and os.readlink(path) == _MASK


def masked_units(root: Path, units: Iterable[str]) -> list[str]:
    """Where these units are masked, so that systemd starts none of them."""
    places = [root / folder / unit for unit in units for folder in _UNIT_FOLDERS]
    return [str(place) for place in places if is_masked(place)]


def refuse_foreign(root: Path, files: Files, links: Links, manifest: dict[str, str]) -> None:
    """Raise InstallError where something is in the way that neither is what we would write nor what we once wrote."""
    wanted = {name: _digest(text.encode()) for name, text in files.items()}
    wanted |= {name: f"-> {target}" for name, target in links.items()}
    foreign = [
        str(root / name)
        for name, value in wanted.items()
        if (found := _found(root / name)) and found not in (value, manifest.get(name)) and not is_masked(root / name)
    ]
    if foreign:
        raise InstallError(
            f"{', '.join(foreign)}: not written by `hil install`, or changed since; move it away, or use --replace"
        )


def put(root: Path, files: Files, links: Links, manifest: dict[str, str]) -> None:
    """Write files and links, and what they are into the manifest. A masked unit stays masked. Raises OSError."""
    for relative, content in files.items():
        path = root / relative
        if is_masked(path):
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink():
            path.unlink()  # what it points to is somebody else's
        write_text(path, content)
        manifest[relative] = _digest(content.encode())
    for relative, target in links.items():
        path = root / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        path.symlink_to(target)
        manifest[relative] = f"-> {target}"
    write_manifest(root, manifest)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _found(path: Path) -> str:
    """What is there, as the manifest would say it; empty: nothing."""
    if path.is_symlink():
        return f"-> {os.readlink(path)}"
    if path.is_file():
        return _digest(path.read_bytes())
    return _NO_FILE if path.exists() else ""  # a directory, a pipe, a device: never ours


def remove(root: Path, paths: list[str], manifest: dict[str, str]) -> list[str]:
    """Remove what was put there, but nothing that somebody has changed since; returns what was left."""
    left = []
    for relative in paths:
        path, expected = root / relative, manifest.pop(relative)
        found = _found(path)
        if found and (found != expected or found == _NO_FILE):
            left.append(relative)
        elif found:
            path.unlink()
            _prune(path.parent)
    return left


def _prune(directory: Path) -> None:
    """Remove the .wants and .d directories that have become empty; no other directory is ours."""
    if directory.name.endswith((".wants", ".service.d")) and not any(directory.iterdir()):
        directory.rmdir()


def remove_all(root: Path, *, purge: bool) -> tuple[int, list[str]]:
    """Remove what was put below the root and the service's cache, with `purge` the rig files too.

    Returns how many files were removed, and what was left and why. Raises InstallError, OSError.
    """
    manifest = read_manifest(root)
    entries = list(manifest)
    changed = remove(root, entries, manifest)
    left = [f"/{path}: changed since it was installed" for path in changed]
    (root / MANIFEST).unlink(missing_ok=True)
    shutil.rmtree(root / CACHE, ignore_errors=True)
    rigs = root / RIGS
    removed = len(entries) - len(changed)
    if purge and rigs.is_dir():
        removed += sum(path.is_file() for path in rigs.rglob("*"))
        shutil.rmtree(rigs)
    elif rigs.is_dir() and any(rigs.iterdir()):
        left.append(f"/{RIGS}: your rig files (--purge removes them)")
    return removed, left + (_left_by_purge(root) if purge else [])


def _left_by_purge(root: Path) -> list[str]:
    """Recordings are never removed, nor what others have put beside the rig files."""
    ours = root / Path(RIGS).parent
    if ours.is_dir() and not any(ours.iterdir()):
        ours.rmdir()
    left = [f"/{path.relative_to(root)}: not ours" for path in sorted(ours.glob("*"))] if ours.is_dir() else []
    if (kept := root / KEPT).is_dir() and any(kept.iterdir()):
        left.append(f"/{KEPT}: recordings, which are yours to remove")
    return left
