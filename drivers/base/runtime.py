"""The private directory in which the processes of one user find each other: buses, rings, mailboxes.

Every process that can write there can move the stage. So the directory belongs to one user, and nobody else may enter
it.
"""

import contextlib
import errno
import os
import signal
import stat
from pathlib import Path

from drivers.base.runtime_path import runtime_path, trusted_owner

LARGEST = 2**20  # bytes of what one process leaves for others to read
_OTHERS_MAY_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class RuntimeDirectoryError(Exception):
    """The runtime directory cannot be trusted or made; the text says which one, why, and what to do."""


def runtime_dir() -> Path:
    """The runtime directory of this user, made when missing; mode 0700, owned by this user.

    Which one: drivers.base.runtime_path. Raises RuntimeDirectoryError.
    """
    path = Path(runtime_path())
    make_private(path)
    return path


def make_private(path: Path) -> None:
    """Make `path` (and its parents) where missing, and see to it that only this user can enter it.

    Whose it may be: drivers.base.runtime_path.trusted_owner. Raises RuntimeDirectoryError.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise RuntimeDirectoryError(f"runtime directory {path}: {error.strerror}; set HIL_RUNTIME_DIR") from None
    if not stat.S_ISDIR(found.st_mode):  # a symbolic link, planted before us in /tmp
        raise RuntimeDirectoryError(f"runtime directory {path}: is not a directory; remove it or set HIL_RUNTIME_DIR")
    if not trusted_owner(os.path.abspath(path), found.st_uid):
        raise RuntimeDirectoryError(
            f"runtime directory {path}: belongs to user {found.st_uid}, not to {os.geteuid()}; set HIL_RUNTIME_DIR"
        )
    if found.st_mode & _OTHERS_MAY_WRITE:
        raise RuntimeDirectoryError(
            f"runtime directory {path}: mode {stat.S_IMODE(found.st_mode):04o} lets others write; must be 0700"
        )
    if found.st_mode & _OTHERS:
        path.chmod(0o700)


def cache_folder() -> Path:
    """What may be thrown away: $CACHE_DIRECTORY (set by systemd), $XDG_CACHE_HOME/hil, ~/.cache/hil; not made here."""
    service = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0]
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(service) if service else Path(base) / "hil"


def state_folder() -> Path:
    """What is kept between runs: $STATE_DIRECTORY (set by systemd), $XDG_STATE_HOME/hil, ~/.local/state/hil; not made
    here.
    """
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    base = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return Path(service) if service else Path(base) / "hil"


def is_private(directory: Path) -> bool:
    """Whether it is a directory of this user that nobody else may write to. Raises OSError."""
    found = directory.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & _OTHERS_MAY_WRITE


def stop_signals() -> tuple[signal.Signals, ...]:
    """SIGTERM, SIGINT, and SIGHUP: the terminal is gone, as when the connection to the rig's machine breaks.

    A process started with nohup, which ignores SIGHUP, is to outlive its terminal.
    """
    asked = (signal.SIGTERM, signal.SIGINT)
    return asked if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (*asked, signal.SIGHUP)


def create_private(path: Path) -> int:
    """An open new file (read and write) that its owner alone can read, in place of one that was left there."""
    with contextlib.suppress(FileNotFoundError):  # of a process that had the same number and was killed
        path.unlink()
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def open_private(path: str | os.PathLike[str], flags: int) -> int:
    """An open file of a runtime directory: no link, pipe or device, and of nobody but this user, the directory's or
    root.

    flags: of open(2); with O_CREAT it is made where missing. Raises OSError that names it.
    """
    fd = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
    try:
        found, directory = os.fstat(fd), os.stat(os.path.dirname(os.path.abspath(path)))
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "is not a file", str(path))
        if found.st_uid not in (os.geteuid(), directory.st_uid, 0):
            raise OSError(errno.EPERM, f"belongs to user {found.st_uid}", str(path))
    except BaseException:
        os.close(fd)
        raise
    return fd


def read_private(path: str | os.PathLike[str]) -> bytes:
    """What such a file holds, up to LARGEST bytes. Raises OSError."""
    with os.fdopen(open_private(path, os.O_RDONLY), "rb") as file:
        return file.read(LARGEST)


def write_private(path: Path, content: str | bytes) -> None:
    """Write a file that its owner alone can read; readers see the old text or the new, nothing in between."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        with os.fdopen(create_private(temporary), "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise OSError(error.errno, error.strerror, str(path)) from None
