"""Locks that tell a living process from a dead one: the kernel drops them with the process, however that ends.

Of the open file description (fcntl(2), F_OFD_SETLK): unlike a process' own they survive another descriptor's closing.
"""

import fcntl
import os
import struct

_LOCK = struct.Struct("hhqqi0q")  # struct flock (fcntl.h)
_WHOLE_FILE = _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)


def try_lock(fd: int) -> bool:
    """Take the lock (the file must be open for writing); False where another process holds it."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _WHOLE_FILE)
    except (BlockingIOError, PermissionError):
        return False
    return True


def is_locked(fd: int) -> bool:
    """Another open file description holds the lock."""
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _WHOLE_FILE)
    return bool(_LOCK.unpack(answer)[0] != fcntl.F_UNLCK)
