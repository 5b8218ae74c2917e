"""Where the processes of one rig find each other's files."""

import contextlib
import fcntl
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from drivers.runtime import make_private, runtime_dir, write_private

DEMO_PREFIX = "demo-"  # of the private runtime directories that demos make


class RuntimePaths(NamedTuple):
    """Files in the rig's part of the runtime directory."""

    directory: Path
    ring: Path
    mailbox: Path
    token: Path  # whoever can read it may command the rig
    endpoint: Path  # where the sidecar listens
    timing: Path  # what hil/live/timing_record.py keeps of the loop
    emulator: Path  # what the drives of an emulated stage are at, as JSON (sim_plant/process.py)


def runtime_paths_in(runtime: Path, rig_name: str) -> RuntimePaths:
    """The rig's files below that runtime directory; makes nothing."""
    directory = runtime / rig_name
    names = ("ring", "mailbox", "token", "endpoint", "timing", "emulator.json")
    return RuntimePaths(directory, *(directory / name for name in names))


class AlreadyServedError(Exception):
    """The rig has a sidecar already; the text names the rig's directory."""


def runtime_paths(rig_name: str) -> RuntimePaths:
    """The rig's files below this user's runtime directory; makes the rig's (private) part of it."""
    found = runtime_paths_in(runtime_dir(), rig_name)
    make_private(found.directory)
    return found


@contextlib.contextmanager
def sole_sidecar(paths: RuntimePaths) -> Iterator[None]:
    """While open, this process alone may serve the rig; the kernel lets go with the process, however that ends.

    A second one would put its own token in the place of the first one's, whose operators could then command nothing,
    not even an emergency stop. Raises AlreadyServedError.
    """
    fd = os.open(paths.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)  # a file could be another user's
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise AlreadyServedError(f"another sidecar serves this rig already (it holds {paths.directory})") from None
        yield
    finally:
        os.close(fd)


def renew_token(path: Path) -> str:
    """A new secret, readable by its owner only."""
    token = secrets.token_hex(32)
    write_private(path, token)
    return token


class Known(NamedTuple):
    """A sidecar that left word of itself."""

    rig: str
    endpoint: str
    token: Path


def known_sidecars(rig: str | None = None) -> list[Known]:
    """Every sidecar (of one rig, or all) that left word, those of demos in a directory of their own first."""
    base = runtime_dir()
    files = [*sorted(base.glob(f"{DEMO_PREFIX}*/*/endpoint")), *sorted(base.glob("*/endpoint"))]
    known = []
    for path in files:
        if rig in (None, path.parent.name):
            with contextlib.suppress(OSError):  # it ended meanwhile
                known.append(Known(path.parent.name, path.read_text(encoding="utf-8").strip(), path.with_name("token")))
    return known
