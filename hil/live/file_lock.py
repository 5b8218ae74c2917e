"""Locks that tell a living process from a dead one: the kernel drops them with the process, however that ends.

Of the open file description (fcntl(2), F_OFD_SETLK): unlike a process' own they survive another descriptor's closing.
A forked child inherits the description, and with it the lock. So the descriptors that hold one become /dev/null there.
"""

import fcntl
import os
import struct

_LOCK = struct.Struct("hhqqi0q")  # struct flock (fcntl.h)
_WHOLE_FILE = _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)


_held: dict[int, tuple[int, int]] = {}  # descriptors with a lock: device and inode, in case one was closed elsewhere


def try_lock(fd: int) -> bool:
    """Take the lock (the file must be open for writing); False where another process holds it. End it by `unlock`."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _WHOLE_FILE)
    except (BlockingIOError, PermissionError):
        return False
    _held[fd] = _identity(fd)
    return True


def unlock(fd: int) -> None:
    """Close a descriptor that may hold a lock, and drop it."""
    _held.pop(fd, None)
    os.close(fd)


def _identity(fd: int) -> tuple[int, int]:
    found = os.fstat(fd)
    return found.st_dev, found.st_ino


def _let_go() -> None:
    """In a forked child."""
    nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
    for fd, identity in _held.items():
        try:  # contextlib.suppress would cost `hil estop` ten more modules
            if _identity(fd) == identity:
                os.dup2(nothing, fd, inheritable=False)
        except OSError:
            pass
    os.close(nothing)
    _held.clear()


os.register_at_fork(after_in_child=_let_go)


def is_locked(fd: int) -> bool:
    """Another open file description holds the lock."""
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _WHOLE_FILE)
    return bool(_LOCK.unpack(answer)[0] != fcntl.F_UNLCK)
