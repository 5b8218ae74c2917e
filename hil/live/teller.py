"""The journal: a child of the control process that prints every event of its ring to standard error, one line each.

The control process never prints while it ticks, as printing may wait. The sidecar may be down for hours. So its events
come from a process that does nothing else. It reads the ring as any reader does, costs the loop nothing, and outlives
the control process by the moment it takes to tell the last events. Under systemd its standard error is the journal of
hil-control@RIG.

Whatever ends this process ends the journal's lines alone; events on Zenoh and in recordings are the sidecar's.
"""

import contextlib
import os
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from hil.events.event import Event
from hil.events.sources import RingEvents
from hil.live.ring import RingError, RingReader
from hil.live.stop_page import NAME, Status

POLL_S = 0.05
_NICENESS = 5
_SHARED = ("ring", "mailbox", NAME)


def print_events(events: Iterable[Event]) -> None:
    """One line each to standard error, with the level that systemd reads where that is the journal."""
    journal = _is_journal(2)
    for event in events:
        print(f"<{int(event.severity)}>{event.line}" if journal else event.line, file=sys.stderr, flush=True)


def _is_journal(fd: int) -> bool:
    """As sd_journal_stream_fd(3) says it is found out."""
    found = os.fstat(fd)
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def _await_ring(path: Path, pid: int) -> RingReader | None:
    """The ring of that process; None where it ended without one."""
    while True:
        alive = os.getppid() == pid  # before the look: a process that has ended may have left one
        with contextlib.suppress(RingError):
            reader = RingReader(path)
            if reader.pid == pid:
                return reader
            reader.close()
        if not alive:
            return None
        time.sleep(POLL_S)


class _Files:
    """Watches the files that the control process shares: whether somebody has removed, replaced or cut one."""

    def __init__(self, directory: Path) -> None:
        self._paths = [directory / name for name in _SHARED]
        self._seen = [self._file(path) for path in self._paths]
        self._page = os.open(directory / NAME, os.O_RDONLY | os.O_CLOEXEC)
        self._mended = 0

    def look(self) -> None:
        """Say what has changed since the last look."""
        for place, path in enumerate(self._paths):
            now = self._file(path)
            if now != self._seen[place]:
                how = "removed" if now is None else "replaced"
                _say(f"{path} was {how}; the loop and the stop line go on, and keep the old one: restart hil run")
                self._seen[place] = now
        mended = Status(self._page).mended
        if mended != self._mended:
            _say(f"a file in {self._paths[0].parent} was cut short or overwritten; it was mended, and the loop goes on")
            self._mended = mended

    @staticmethod
    def _file(path: Path) -> tuple[int, int] | None:
        with contextlib.suppress(OSError):
            found = os.stat(path)
            return found.st_dev, found.st_ino
        return None


def _say(text: str) -> None:
    print(f"{'<4>' if _is_journal(2) else ''}hil run: {text}", file=sys.stderr, flush=True)


def _stay_away(pid: int) -> None:
    """Off the cores that the control process has for itself, and behind whoever has something to do."""
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
        everywhere = set(range(os.cpu_count() or 1))
        os.sched_setaffinity(0, everywhere - os.sched_getaffinity(pid) or everywhere)


def main(ring: str, notes: str, parent: str) -> None:
    """Tell until the control process is gone."""
    reader = _await_ring(Path(ring), int(parent))
    if reader is None:
        return
    with reader, contextlib.suppress(OSError):  # nobody listens any more
        _stay_away(int(parent))
        told, files = RingEvents(reader, Path(notes)), _Files(Path(ring).parent)
        alive = True
        while alive:
            alive = reader.writer_alive  # before the look at the ring: what was written last is then there
            while len((batch := reader.read()).records):
                print_events(told.tell(batch))
            if alive:
                files.look()
            time.sleep(POLL_S * alive)
        print_events(told.close())


if __name__ == "__main__":
    main(*sys.argv[1:])
