"""How another task or law reaches the control process: planned elsewhere, taken in by small pieces between ticks.

Rules:
- The sidecar plans; the control process only reads numbers, PIECES segments a tick, while no axis moves under torque.
- Nothing in the file, whatever its bytes, can raise in the control process: what is damaged is not taken.

Layout: a header (magic, number of task or law, length of the head, segments, columns), the head (JSON), the segments
(duration, phase, six coefficients a column), a CRC-32 of all of it.
"""

import json
import os
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from drivers.base.runtime import open_private
from hil.control.trajectories import plan_task
from hil.control.trajectories.injection import OverCells
from hil.control.trajectories.paths import AlongPath
from hil.control.trajectories.segments import Segment, Segments, segment
from hil.cycle.tick import LoadedLaw, LoadedTask
from hil.rig.schema import LawConfig, RigConfig, TaskConfig

MAGIC = b"HILTASK1"
PIECES = 16  # segments a tick: some tens of microseconds
_HEADER = struct.Struct("<8sQIII")
_CRC = struct.Struct("<I")
_MOST_HEAD, _MOST_SEGMENTS, _MOST_COLUMNS = 2**16, 2**20, 16


def task_bytes(number: int, task: LoadedTask, rig: RigConfig) -> bytes:
    """The file of a task that was planned here. number: by which its sender knows it. rig: whose task it is."""
    head, segments = _taken_apart(task, rig)
    head["ranges"] = [list(ends) for ends in task.start_ranges]
    return _packed(number, head, segments)


def law_bytes(number: int, law: LoadedLaw) -> bytes:
    """The file of a law that was made here. number: by which its sender knows it."""
    return _packed(number, {"law": json.loads(law.document), "designed": law.designed}, [])


def _packed(number: int, head: dict[str, Any], segments: Sequence[Segment]) -> bytes:
    text = json.dumps(head).encode()
    columns = len(segments[0].rows) if segments else 0
    row = _row(columns)
    parts = [_HEADER.pack(MAGIC, number, len(text), len(segments), columns), text]
    parts += [row.pack(s.duration_ns, s.phase, *(value for axis in s.rows for value in axis[:6])) for s in segments]
    data = b"".join(parts)
    return data + _CRC.pack(zlib.crc32(data))


def _taken_apart(task: LoadedTask, rig: RigConfig) -> tuple[dict[str, Any], Sequence[Segment]]:
    """What a plan is made of: a few words, and the segments that were made beforehand."""
    plan = task.plan
    if isinstance(plan, AlongPath):
        words = {"columns": plan.columns, "approach_ns": plan.approach_ns, "settle_ns": plan.settle_ns}
        return {"along": {**words, "repeat": plan.body.repeat_ns is not None}}, plan.body.segments
    if isinstance(plan, OverCells):
        words = {"approach_ns": plan.approach_ns, "settle_ns": plan.settle_ns}
        return {"over": {**words, "home": list(plan.home), "focal": list(plan.focal)}}, plan.cells
    return {"task": rig.task.model_dump(mode="json", exclude_defaults=True)}, []  # planned at once: it has no points


def _row(columns: int) -> struct.Struct:
    return struct.Struct(f"<qq{6 * columns}d")


def _made_by_the_tick(_law: LoadedLaw) -> bool:
    return True


class TaskIntake:
    """Takes a task's or a law's file in, a piece at every `work`. make: a piece of making the law; says whether it is
    made. done: nothing is left to do; task, law: what came of it, None where the file was none.
    """

    def __init__(
        self, path: Path, number: int, rig: RigConfig, make: Callable[[LoadedLaw], bool] = _made_by_the_tick
    ) -> None:
        self.number = number
        self.done = False
        self.task: LoadedTask | None = None
        self.law: LoadedLaw | None = None
        self._make = make
        self._path, self._rig = path, rig
        self._fd = -1
        self._head: dict[str, Any] = {}
        self._segments: list[Segment] = []
        self._starts = [0]  # of each, and the end: a sum over all of them at once would hold a tick up
        self._count = self._columns = self._at = self._crc = 0
        self._row = _row(0)

    def work(self) -> None:
        """One piece. Never raises."""
        if self.done:
            return
        try:
            if self._fd < 0:
                self._open()
            elif len(self._segments) < self._count:
                self._take()
            elif self.law is None:
                self._finish()
            elif self._make(self.law):
                self._end()
        except Exception:  # of many kinds, for bytes of any kind
            self.law = None
            self._end()

    def _read(self, length: int) -> bytes:
        data = os.pread(self._fd, length, self._at)
        if len(data) != length:
            raise ValueError("the file ends early")
        self._at += length
        return data

    def _open(self) -> None:
        self._fd = open_private(self._path, os.O_RDONLY)
        header = self._read(_HEADER.size)
        magic, number, length, self._count, self._columns = _HEADER.unpack(header)
        if (magic, number) != (MAGIC, self.number) or length > _MOST_HEAD:
            raise ValueError("no task, or another one")
        if self._count > _MOST_SEGMENTS or self._columns > _MOST_COLUMNS:
            raise ValueError("more than a task can have")
        text = self._read(length)
        self._crc = zlib.crc32(text, zlib.crc32(header))
        self._head = json.loads(text)
        self._row = _row(self._columns)

    def _take(self) -> None:
        data = self._read(self._row.size * min(PIECES, self._count - len(self._segments)))
        self._crc = zlib.crc32(data, self._crc)
        for duration_ns, phase, *values in self._row.iter_unpack(data):
            axes = [(*values[i : i + 6],) for i in range(0, len(values), 6)]
            self._segments.append(segment(duration_ns, axes, phase))
            self._starts.append(self._starts[-1] + duration_ns)

    def _finish(self) -> None:
        (crc,) = _CRC.unpack(self._read(_CRC.size))
        if crc != self._crc:
            raise ValueError("damaged")
        if "law" in self._head:
            document, designed = json.dumps(self._head["law"]), self._head["designed"]
            self.law = LoadedLaw(LawConfig.model_validate(self._head["law"]), designed, document)
            return
        ranges = [(float(low), float(high)) for low, high in self._head["ranges"]]
        if len(ranges) != len(self._rig.axes):
            raise ValueError("of another rig")
        self.task = LoadedTask(self._plan(), ranges, "")
        self._end()

    def _plan(self) -> Any:
        if "along" in self._head:
            words = self._head["along"]
            repeat, starts = bool(words["repeat"]), self._starts
            body = Segments(self._segments, repeat=repeat, phase_names=("path",), starts=starts)
            return AlongPath(body, words["columns"], words["approach_ns"], words["settle_ns"])
        if "over" in self._head:
            words = self._head["over"]
            return OverCells(words["home"], words["focal"], words["approach_ns"], words["settle_ns"], self._segments)
        task = TaskConfig.model_validate(self._head["task"])
        return plan_task(task, self._rig.axis_names, self._rig.period_ns, self._rig.counts)

    def _end(self) -> None:
        self.done = True
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
