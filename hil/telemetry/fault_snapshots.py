"""The seconds around each fault that latches, and each emergency stop, as a recording of its own, out of the ring.

File: `fault-NAME-TICK-RUN.mcap`, the tick in which it latched and the control process' run. It is written under
another name first: what is there is whole. A sidecar that takes a killed one's place finds in the ring
what its predecessor left undone.
"""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.events.event import Event
from hil.events.stream import EventStream, stream_of
from hil.live.ring import RingReader
from hil.telemetry.codec import Records
from hil.telemetry.event_codec import encode
from hil.telemetry.recorder import Recorder, write_batch

BEFORE_S, AFTER_S = 10.0, 2.0
RETRY_NS = 1_000_000_000
MOST_PENDING = 32  # a fault is left by an operator's reset alone
_ROUND = 256  # ticks written at a time: the sidecar has commands to hand on
_LATCHES = ("fault", "state", "index")
_ESTOP = -1  # where no fault has latched
_KNOWN = {int(fault): fault.name for fault in Fault} | {_ESTOP: State.ESTOP.name}


class _Pending(NamedTuple):
    path: Path
    first: int  # ring indices: from here to before `last`
    last: int


class FaultSnapshots:
    """Of one control process. folder: where they go. seen: ring index up to which an earlier sidecar has looked."""

    def __init__(self, folder: Path, reader: RingReader, seen: int) -> None:
        self._folder, self._reader = folder, reader
        period_s = max(reader.period_ns, 1) * 1e-9
        self._before, self._after = round(BEFORE_S / period_s), round(AFTER_S / period_s)
        self._latched = 0
        self._pending: list[_Pending] = []
        self._writing: Recorder | None = None
        self._stream: EventStream | None = None  # of the one that is being written
        self._told = 0  # of its events
        self._next = 0
        self._retry_ns = 0
        self.failed = 0  # those that could not be written before the ring had nothing of them any more
        if seen:
            self._look_back(seen)

    def _look_back(self, seen: int) -> None:
        place = 0
        while place < seen:
            batch = self._reader.look(place, min(4096, seen - place), _LATCHES)
            if not len(batch.records):
                return
            self.watch(batch.records, batch.first)
            place = batch.first + len(batch.records)

    def watch(self, records: Records, first: int) -> None:
        """Note faults that latched in these ticks. first: ring index."""
        stopped = np.where(records["state"] == int(State.ESTOP), _ESTOP, 0)
        faults = np.where(records["fault"] != 0, records["fault"].astype(np.int64), stopped)
        changed = np.flatnonzero(np.diff(faults, prepend=self._latched))
        self._latched = int(faults[-1])
        for place in changed.tolist():
            if fault := int(faults[place]):
                self._note(_KNOWN.get(fault, str(fault)), int(records["index"][place]), first + place)

    def _note(self, name: str, tick: int, at: int) -> None:
        path = self._folder / f"fault-{name}-{tick}-{self._reader.run_id:016x}.mcap"
        if path.exists():
            return
        if len(self._pending) == MOST_PENDING:
            self.failed += 1
            return
        self._pending.append(_Pending(path, max(at - self._before, 0), at + self._after))

    def work(self, now_ns: int, *, over: bool = False) -> bool:
        """One round; False where nothing is to be done now. over: no more ticks come, what there is must do."""
        if not self._pending or now_ns < self._retry_ns:
            return False
        job = self._pending[0]
        end = min(job.last, self._reader.written)
        if end < job.last and not over:
            return False
        if self._writing is None:
            self._begin(job)
        recorder = self._writing
        if recorder is not None and recorder.ok:
            batch = self._reader.look(self._next, min(_ROUND, end - self._next))
            if len(batch.records):
                write_batch(recorder, batch.records, first=batch.first, lost=batch.lost)
                self._tell(recorder, self._stream.tell(batch.records, batch.lost) if self._stream else ())
                self._next = batch.first + len(batch.records)
            if recorder.ok and self._next < end and len(batch.records):
                return True
            self._tell(recorder, self._stream.close() if self._stream else ())
            recorder.close()
        self._end(job, now_ns, over)
        return True

    def _begin(self, job: _Pending) -> None:
        temporary = _temporary(job.path)
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)  # a killed sidecar's
        metadata: dict[str, Any] = {
            **self._reader.metadata,
            "run": f"{self._reader.run_id:016x}",
            "snapshot": job.path.name,
        }
        self._next = job.first
        known = self._reader.metadata
        self._stream = stream_of(known["rig"], max(self._reader.period_ns, 1), known.get("baseline"))
        self._told = 0
        self._writing = Recorder(temporary, metadata)
        self._writing.hurried = True

    def _tell(self, recorder: Recorder, events: Sequence[Event]) -> None:
        """A snapshot tells its own story: no replay can, as it begins in the middle of a run."""
        offset_ns = int(self._reader.metadata.get("wall_offset_ns", 0))
        for event in events:
            recorder.write("events", event.time_ns, encode(event, self._told, offset_ns).SerializeToString())
            self._told += 1

    def _end(self, job: _Pending, now_ns: int, over: bool) -> None:
        recorder, self._writing = self._writing, None
        temporary = _temporary(job.path)
        if recorder is not None and not recorder.errors:
            with contextlib.suppress(OSError):
                temporary.rename(job.path)
                self._pending.pop(0)
                return
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        self._retry_ns = now_ns + RETRY_NS  # the disk may have room again while the ring still has the ticks
        if over or self._reader.written - job.last > self._reader.slots:
            self._pending.pop(0)
            self.failed += 1

    def close(self, now_ns: int) -> None:
        """Write what is pending, with the ticks there are."""
        self._retry_ns = 0
        while self._pending and self.work(now_ns, over=True):
            self._retry_ns = 0


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.new")
