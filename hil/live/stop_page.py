"""The page of memory through which a rig is stopped: its layout, and the side that presses stop.

A control process maps the file `stop` in its rig's runtime directory for as long as it lives, and holds a lock on it.
The one who presses stop writes the time into one word of it. The loop reads that word in every tick; any change is a
press, which latches ESTOP, and the loop then writes beside it what it recorded. Nothing else is needed: no rig file,
sidecar, network or disk space (the page is allocated before the loop begins).

This module loads nothing that takes time, and writes with pwrite(2) instead of mapping the file: a file that is cut
short under a mapping would be a SIGBUS.
"""

import os
import stat
import struct
import time

from drivers.base.runtime_path import named_directory, runtime_path, trusted_owner
from hil.live.file_lock import is_locked

NAME = "stop"
SIZE = 4096
MAGIC = 0x31304F54534C4948  # "HILSTO01"

# u64 words; those of the control process and those of the pressers lie on separate cache lines
MAGIC_WORD, PID = 0, 1
MENDED = 3  # how often a shared file of the rig was cut short or overwritten, and mended
ALIVE_AT, INDEX, STATE = 8, 9, 10  # a few times a second: monotonic ns, tick, state's name (16 bytes)
LATCHED_AT, LATCHED_INDEX, LATCHED_STATE = 16, 17, 18  # of the newest press: monotonic ns, tick, state after it
PRESSED, PRESSER_UID, PRESSER_PID = 32, 33, 34  # monotonic ns of the newest press, 0: never; who says to have pressed
NAME_BYTES = 16

_DEMOS = "demo-"  # private runtime directories below the ordinary one (hil/live/runtime_paths.py)
_POLL_S = 0.0005


class Status:
    """What a page says. alive: a control process holds it."""

    def __init__(self, fd: int) -> None:
        raw = os.pread(fd, SIZE, 0).ljust(SIZE, b"\0")
        words = struct.unpack_from(f"<{SIZE // 8}Q", raw)
        self.valid = words[MAGIC_WORD] == MAGIC
        cut = struct.pack("<Q", MAGIC).startswith(raw[:8].rstrip(b"\0"))  # short: the loop will write its head anew
        self.alive = (self.valid or cut) and is_locked(fd)
        self.mended = words[MENDED]
        self.pid, self.alive_at, self.index = words[PID], words[ALIVE_AT], words[INDEX]
        self.state = _text(words[STATE : STATE + 2])
        self.latched_at, self.latched_index = words[LATCHED_AT], words[LATCHED_INDEX]
        self.latched_state = _text(words[LATCHED_STATE : LATCHED_STATE + 2])
        self.pressed, self.presser_uid, self.presser_pid = words[PRESSED], words[PRESSER_UID], words[PRESSER_PID]


def _text(words: "tuple[int, ...]") -> str:
    raw = struct.pack("<2Q", *words).rstrip(b"\0")
    return "".join(letter for letter in raw.decode("ascii", "replace") if letter.isprintable())


class Page:
    """A live control process' page, opened by somebody else. path: for people."""

    def __init__(self, fd: int, path: str) -> None:
        self.fd, self.path = fd, path

    def status(self) -> Status:
        """As it is now."""
        return Status(self.fd)

    def press(self) -> int:
        """Stop. Returns when, monotonic ns; never waits. Pressing again does no harm."""
        pressed_ns = time.monotonic_ns()
        os.pwrite(self.fd, struct.pack("<2Q", os.getuid(), os.getpid()), 8 * PRESSER_UID)
        os.pwrite(self.fd, struct.pack("<Q", pressed_ns), 8 * PRESSED)
        return pressed_ns

    def await_latch(self, pressed_ns: int, timeout_s: float) -> Status:
        """The page once the loop has taken a press at or after `pressed_ns`, or as it is after `timeout_s`."""
        until = time.monotonic() + timeout_s
        while (status := self.status()).latched_at < pressed_ns and status.alive and time.monotonic() < until:
            time.sleep(_POLL_S)
        return status

    def close(self) -> None:
        """Close; idempotent."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def open_page(path: str) -> "Page | None":
    """The page at that path where a living control process holds it, and nobody else could have put it there."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)  # a planted pipe must not hold us up
    except OSError:
        return None
    found = os.fstat(fd)
    ours = found.st_uid == os.geteuid() or os.geteuid() == 0
    if stat.S_ISREG(found.st_mode) and ours and Status(fd).alive:
        return Page(fd, path)
    os.close(fd)
    return None


def live_pages(rig: str) -> "list[Page]":
    """Pages of every living control process of that name: in this user's runtime directory and those of demos in it.

    Where there is none, those that a process which this user may look into holds open, because the directory may have
    been removed, or the process was given another one (systemd). Only where the environment names a runtime directory,
    no other counts: naming one means the rigs in it, and not their namesakes elsewhere.
    """
    if not rig or rig.startswith(".") or "/" in rig:
        return []
    pages = [page for path in _paths(rig) if (page := open_page(path))]
    return pages or _held_pages(rig)


def _paths(rig: str) -> "list[str]":
    base = runtime_path()
    try:
        demos = sorted(name for name in os.listdir(base) if name.startswith(_DEMOS))
    except OSError:
        return []
    directories = [os.path.join(base, *parts, rig) for parts in ((), *((demo,) for demo in demos))]
    return [os.path.join(directory, NAME) for directory in directories if _trusted(base) and _trusted(directory)]


def _trusted(directory: str) -> bool:
    try:
        found = os.lstat(directory)
    except OSError:
        return False
    private = stat.S_ISDIR(found.st_mode) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return private and trusted_owner(directory, found.st_uid)


def _held_pages(rig: str) -> "list[Page]":
    """As above; those that were in our own runtime directory, or, where there is none, those of any that counts."""
    ending, ours = f"/{rig}/{NAME}", f"{runtime_path()}/"
    pages: dict[tuple[int, int], Page] = {}
    own: dict[tuple[int, int], Page] = {}
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            descriptors = os.listdir(f"/proc/{pid}/fd")
        except OSError:  # another user's, or gone
            continue
        for number in descriptors:
            link = f"/proc/{pid}/fd/{number}"
            try:
                target = os.readlink(link).removesuffix(" (deleted)")
            except OSError:
                continue
            inside = target.startswith(ours)
            counts = target.endswith(ending) and (inside or not named_directory())
            if counts and (page := open_page(link)):
                found = os.fstat(page.fd)
                (own if inside else pages).setdefault((found.st_dev, found.st_ino), page)
    return list((own or pages).values())
