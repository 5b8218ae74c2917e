"""Where the members of a local bus find each other: the channel's directory, its lock, and the count of joins.

A channel is a directory below the runtime directory. Every member has a listening socket there; its name holds the
process, a number within it and the length of its queues. The lock file serialises joining and holds the number of joins
so far, which every member maps into its memory.
"""

import contextlib
import errno
import fcntl
import mmap
import os
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from drivers.base.named_file import naming
from drivers.base.runtime import make_private, open_private, runtime_dir
from drivers.base.shared_map import map_shared

JOIN_TIMEOUT_S = 2.0  # joining takes about a millisecond; a process that holds the lock for longer has been stopped
COUNT_BYTES = 8
NAME = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}"  # longer than Linux' interfaces: programs for other buses have such names
NAME_RULE = "1 to 64 letters, digits, '_', '.' or '-', not '.' first"
LISTENING_SOCKETS = "*-*-*.sock"  # process, number within it, depth of its queues

_LOCK_POLL_S = 0.002
_PATH_LIMIT = 107  # sun_path without its terminator, <sys/un.h>


def channel_dir(channel: str) -> Path:
    """The directory of a channel, made when missing. Raises ValueError for a name that no channel has."""
    if not re.fullmatch(NAME, channel):
        raise ValueError(f"channel {channel!a}: {NAME_RULE}")
    directory = runtime_dir() / "bus" / channel
    make_private(directory.parent)
    make_private(directory)
    return directory


def channels() -> list[str]:
    """Names of the channels that somebody has used on this machine."""
    try:
        return sorted(path.name for path in (runtime_dir() / "bus").iterdir())
    except OSError:
        return []


def packet_socket() -> socket.socket:
    """A socket for links, or to listen for them; it never blocks."""
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[int]:
    """Hold the channel's lock; raises TimeoutError when another process keeps it. It ends with its holder."""
    deadline = time.monotonic() + JOIN_TIMEOUT_S
    fd = open_private(directory / "lock", os.O_RDWR | os.O_CREAT)
    try:
        while True:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise TimeoutError(
                        errno.ETIMEDOUT,
                        f"another process has been joining this bus for {JOIN_TIMEOUT_S} s; is one stopped (state T)?",
                        str(directory),
                    ) from None
                time.sleep(_LOCK_POLL_S)
        yield fd
    finally:
        fcntl.flock(fd, fcntl.LOCK_UN)  # closing alone would not do: a mapping holds a duplicate of the descriptor
        os.close(fd)


@contextlib.contextmanager
def address(path: Path) -> Iterator[str]:
    """`path` in a form short enough for a socket address."""
    if len(os.fsencode(path)) <= _PATH_LIMIT:
        yield str(path)
        return
    fd = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{fd}/{path.name}"
    finally:
        os.close(fd)


def shared_count(lock: int, directory: Path) -> mmap.mmap:
    """The number in the channel's lock file, shared with every other member; `unmap` ends it.

    Its block is there: else a full file system would be a SIGBUS at the first frame. Raises OSError that names
    `directory`.
    """
    with naming(directory):
        os.posix_fallocate(lock, 0, COUNT_BYTES)
    return map_shared(lock, COUNT_BYTES)
