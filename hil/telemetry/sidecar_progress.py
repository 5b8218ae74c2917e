"""How far a sidecar has come with a control process's ring, for the sidecar that takes its place.

A file of one line in the rig's runtime directory, rewritten in every round with one pwrite(2): what it says outlives a
killed sidecar. The successor publishes nothing a second time, counts nothing twice, and records on where the recording
on the disk ends.
"""

import contextlib
import dataclasses
import json
import os
import zlib
from pathlib import Path

from drivers.base.runtime import open_private
from hil.live.mapped_file import Closing

SIZE = 2048  # less than a page: a write of it is whole or not there


@dataclasses.dataclass
class Progress:
    """With one control process's ring. run: its run_id. published, recorded: ring index after the last tick that was
    handed to Zenoh, and that is in a file. sent: of the published, those that Zenoh took. file: the newest recording,
    an absolute path; part: its number; size: bytes of it, up to `recorded` and not a tick beyond.
    """

    run: int
    published: int = 0
    sent: int = 0
    recorded: int = 0
    file: str = ""
    part: int = 0
    size: int = 0


class ProgressFile(Closing):
    """The file, for a sidecar to write in every round. Raises OSError."""

    def __init__(self, path: Path) -> None:
        self._fd = open_private(path, os.O_RDWR | os.O_CREAT)

    def read(self, run: int) -> Progress:
        """What an earlier sidecar left of that run; a new one where it left nothing, or nothing that makes sense."""
        line, _, checksum = os.pread(self._fd, SIZE, 0).rstrip(b"\0").rpartition(b" ")
        with contextlib.suppress(ValueError, TypeError):
            if zlib.crc32(line) == int(checksum):
                found = Progress(**json.loads(line))
                if found.run == run:
                    return found
        return Progress(run)

    def write(self, progress: Progress) -> None:
        """Replace what it says; where there is no room, it keeps saying what it said."""
        line = json.dumps(dataclasses.asdict(progress)).encode()
        text = b"%b %d" % (line, zlib.crc32(line))
        if len(text) <= SIZE:
            with contextlib.suppress(OSError):
                os.pwrite(self._fd, text.ljust(SIZE, b"\0"), 0)

    def close(self) -> None:
        """Close; the file stays."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
