"""A rig's ring as the page reads it: what is new in each turn, copied once for all who watch."""

import contextlib
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from hil.live.mapped_file import Closing
from hil.live.ring import Batch, RingError, RingReader
from hil.live.runtime_paths import files_of_rigs
from hil.page.frames import Block, Fate, Pulse
from hil.page.signals import FIELDS, Signal, rows, signals_of

MOST: Final = 4096  # ticks a turn; who fell further behind goes on with the newest
SEARCH_NS: Final = 250_000_000  # between two looks for a ring


def running_rigs() -> list[str]:
    """Names of the rigs whose control process has left a ring in this user's runtime directory."""
    return sorted({path.parent.name for path in files_of_rigs("ring")})


class RingFeed(Closing):
    """Follows the control process of one rig, and whichever comes after it. rig: its name. fields: of the records,
    which are read; `turn` needs FIELDS.
    """

    def __init__(self, rig: str, fields: Sequence[str] = FIELDS) -> None:
        self.rig, self._fields = rig, fields
        self._reader: RingReader | None = None
        self._searched_ns = -SEARCH_NS
        self._newest: tuple[int, int, int] = (-1, -1, -1)
        self._tick_ns = 0
        self.run_id = 0
        self.metadata: Mapping[str, Any] = {}
        self.signals: list[Signal] = []

    def turn(self) -> Block | None:
        """The ticks since the last turn; None where there are none."""
        batch = self.read()
        if batch is None or self._reader is None:
            return None
        instants = batch.records["index"] * (self._reader.period_ns * 1e-9)
        rig = self.metadata["rig"]
        return Block(instants, rows(batch.records, len(rig["axes"]), len(rig.get("sensors", {}))), batch.lost)

    def read(self) -> Batch | None:
        """The records since the last turn, as they are in the ring; None where there are none."""
        now_ns = time.monotonic_ns()
        if now_ns - self._searched_ns >= SEARCH_NS:
            self._searched_ns = now_ns
            self._search()
        reader = self._reader
        if reader is None:
            return None
        behind = reader.written - reader.next - MOST
        reader.next += max(behind, 0)
        batch = reader.read(MOST, self._fields)
        if not len(batch.records):
            return None
        last = batch.records[-1]
        self._newest = int(last["state"]), int(last["fault"]), int(last["motion"])
        self._tick_ns = int(last["now_ns"])
        return batch._replace(lost=batch.lost + max(behind, 0))

    def skip(self) -> None:
        """Nobody watched: what was not read is not wanted."""
        if self._reader:
            self._reader.next = self._reader.written

    def pulse(self, word_age: float) -> Pulse:
        """What is alive. word_age: of the sidecar's last word, s."""
        age = (time.monotonic_ns() - self._tick_ns) * 1e-9 if self._tick_ns else math.nan
        return Pulse(*self._newest, age, self._fate(), word_age)

    def _fate(self) -> Fate:
        if self._reader is None:
            return Fate.NONE
        if self._reader.writer_alive:
            return Fate.ALIVE
        return Fate.ENDED if self._reader.ended else Fate.KILLED

    def _search(self) -> None:
        if self._reader and not self._reader.replaced and self._reader.writer_alive:
            return
        for path in files_of_rigs("ring", self.rig):
            with contextlib.suppress(RingError):
                reader = RingReader(path)
                if reader.run_id != self.run_id and (reader.writer_alive or self._reader is None):
                    self._follow(reader)
                    return
                reader.close()

    def _follow(self, reader: RingReader) -> None:
        self.close()
        self._reader, self.run_id, self.metadata = reader, reader.run_id, reader.metadata
        self.signals = signals_of(self.metadata["rig"])
        self._newest, self._tick_ns = (-1, -1, -1), 0
        reader.next = max(reader.written - 1, 0)

    def close(self) -> None:
        """Let go of the ring; idempotent."""
        if self._reader:
            self._reader.close()
            self._reader = None
