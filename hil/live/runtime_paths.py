"""Where the processes of one rig find each other's files."""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

from drivers.base.runtime import make_private, open_private, read_private, runtime_dir
from hil.live.file_lock import try_lock, unlock

Attached = TypeVar("Attached")
DEMO_PREFIX = "demo-"  # of the private runtime directories that demos make


class RuntimePaths(NamedTuple):
    """Files in the rig's part of the runtime directory."""

    directory: Path
    ring: Path
    mailbox: Path
    commands: Path  # the Unix socket on which the sidecar takes commands
    endpoint: Path  # where the sidecar listens
    access: Path  # what of the sidecar is open to whom, as JSON, for `hil doctor`
    timing: Path  # what hil/live/timing_record.py keeps of the loop
    emulator: Path  # what the drives of an emulated stage are at, as JSON (sim_plant/process.py)
    notes: Path  # what the cycle says in words (hil/events/notes.py)
    task: Path  # another task for the control process (hil/live/task_file.py)
    goals: Path  # goals for the control process (hil/live/goal_page.py)
    scene: Path  # what an emulated camera sees (sim_plant/scene_page.py)


def runtime_paths_in(runtime: Path, rig_name: str) -> RuntimePaths:
    """The rig's files below that runtime directory; makes nothing."""
    directory = runtime / rig_name
    ends = (
        "ring",
        "mailbox",
        "commands",
        "endpoint",
        "access.json",
        "timing",
        "emulator.json",
        "notes",
        "task",
        "goals",
        "scene",
    )
    return RuntimePaths(directory, *(directory / name for name in ends))


class AlreadyServedError(Exception):
    """The rig has such a process already; the text names it."""


def runtime_paths(rig_name: str) -> RuntimePaths:
    """The rig's files below this user's runtime directory; makes the rig's (private) part of it."""
    found = runtime_paths_in(runtime_dir(), rig_name)
    make_private(found.directory)
    return found


@contextlib.contextmanager
def sole(paths: RuntimePaths, kind: str) -> Iterator[None]:
    """While open, this process alone is the rig's `kind` (sidecar, emulator); the kernel drops the lock with the
    process. Raises AlreadyServedError.
    """
    path = paths.directory / f"{kind}.lock"
    fd = open_private(path, os.O_RDWR | os.O_CREAT)
    try:
        if not try_lock(fd):
            raise AlreadyServedError(f"another {kind} serves this rig already (it holds {path})")
        yield
    finally:
        unlock(fd)


class Known(NamedTuple):
    """A sidecar that left word of itself."""

    rig: str
    endpoint: str
    directory: Path


def files_of_rigs(name: str, rig: str = "*") -> list[Path]:
    """The files of that name in the directories of a rig, or of all; those of demos first."""
    base = runtime_dir()
    return [*sorted(base.glob(f"{DEMO_PREFIX}*/{rig}/{name}")), *sorted(base.glob(f"{rig}/{name}"))]


def known_sidecars(rig: str | None = None) -> list[Known]:
    """Every sidecar (of one rig, or all) that left word, those of demos in a directory of their own first."""
    known = []
    for path in files_of_rigs("endpoint"):
        if rig in (None, path.parent.name):
            with contextlib.suppress(OSError):  # it ended meanwhile
                endpoint = read_private(path).decode(errors="replace").strip()
                known.append(Known(path.parent.name, endpoint, path.parent))
    return known


def nearest(rig: str, attach: Callable[[Path], Attached], absent: type[Exception]) -> Attached:
    """What `attach` makes of the first directory in which it does not raise `absent`: of those in which the sidecar of
    a demo of that rig takes commands, and at last of the rig's own.
    """
    base = runtime_dir()
    for directory in sorted(base.glob(f"{DEMO_PREFIX}*/{rig}")):
        if (directory / "commands").exists():
            with contextlib.suppress(absent):
                return attach(directory)
    return attach(base / rig)
