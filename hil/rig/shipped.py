"""The files that come with hil (rig files, fault scenarios, systemd units), wherever it was installed from.

In a checkout they are in `deploy/` beside the packages; a wheel and the Debian package carry them in `hil/deploy/`.
"""

from pathlib import Path


class IncompleteError(Exception):
    """This copy of hil lacks the files that should have come with it."""


def shipped(kind: str) -> Path:
    """The folder of the files of one kind: "rigs", "scenarios" or "systemd". Raises IncompleteError."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "deploy" / kind, package.parent / "deploy" / kind):
        if candidate.is_dir():
            return candidate
    raise IncompleteError(f"no deploy/{kind} in or beside {package}: this copy of hil is not complete")


def by_name(kind: str, path: Path) -> Path:
    """`path`, or the shipped file that it names: `microscope` is deploy/rigs/microscope.toml. What exists as a path, or
    looks like one (with a folder or a suffix), is taken as it is.
    """
    if path.suffix or len(path.parts) != 1 or path.exists():
        return path
    try:
        named = shipped(kind) / f"{path}.toml"
    except IncompleteError:
        return path
    return named if named.exists() else path


def names(kind: str) -> list[str]:
    """What `by_name` knows of a kind, sorted. Raises IncompleteError."""
    return sorted(path.stem for path in shipped(kind).glob("*.toml"))
