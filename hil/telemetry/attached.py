"""One control process, as a sidecar follows it."""

import contextlib
import time
from pathlib import Path

from hil.live.goal_page import GoalPage, GoalPageError
from hil.live.mailbox import Mailbox
from hil.live.ring import RingReader
from hil.rig.file import build_rig
from hil.rig.schema import RigError
from hil.telemetry.cell_watch import CellWatch
from hil.telemetry.fault_snapshots import FaultSnapshots
from hil.telemetry.motion_watch import MotionWatch
from hil.telemetry.run_recorder import RunRecorder
from hil.telemetry.sidecar_progress import Progress
from hil.telemetry.tick_codec import TickEncoder
from hil.telemetry.tick_schema import TickSchema
from hil.telemetry.window import Window


class Attached:
    """One control process's ring and mailbox, followed from where an earlier sidecar came to, or from its first tick
    that is still there, to its end. recorder: None: nothing is recorded.
    """

    def __init__(
        self, reader: RingReader, mailbox: Mailbox | None, progress: Progress, recorder: RunRecorder | None
    ) -> None:
        self.reader = reader
        self.mailbox = mailbox
        self.goals: GoalPage | None = None  # opened where anybody asks who moves the rig
        self.progress = progress
        self.metadata = reader.metadata
        reader.next = progress.published
        self.recorder = recorder
        self.snapshots = FaultSnapshots(self.recorder.folder, reader, progress.published) if self.recorder else None
        if self.recorder:
            self.recorder.keep_up(progress.recorded, time.monotonic_ns())  # there is a file before the first tick
        rig = self.metadata["rig"]
        self.axes = list(rig["axes"])
        self.units = ["m" if axis["kind"] == "linear" else "rad" for axis in rig["axes"].values()]
        self.law = str(rig["law"]["name"])
        self.window = Window(max(1, round(1e9 / max(reader.period_ns, 1))), len(self.axes))
        self.encoder = TickEncoder(TickSchema(rig))
        self.motion: MotionWatch | None = None  # None: the rig is of another version of hil
        self.cells: CellWatch | None = None  # None: it injects none
        with contextlib.suppress(RigError):
            config = build_rig(dict(rig), carried=True)
            self.motion = MotionWatch(config)
            if config.motion.name == "cells":
                self.cells = CellWatch(config, run=reader.run_id)
        self.dropped = progress.published - progress.sent  # what a killed sidecar cannot be known to have sent, too
        self.caught_up = False  # the window is the present: the last round read the ring to its end
        self.over = False  # the control process is gone, and all it left is safe

    def holder(self, path: Path) -> str:
        """Who moves the rig, in words; empty: nobody. path: of the control process's goal page."""
        if self.goals is None or self.goals.replaced:
            with contextlib.suppress(GoalPageError):
                page = GoalPage(path)
                if self.goals:
                    self.goals.close()
                self.goals = page
        found = self.goals.holder() if self.goals else None
        return found.holder if found else ""

    def record(self, now_ns: int) -> None:
        """One round of what else is to be recorded than the ticks that were just read."""
        if self.recorder:
            self.recorder.keep_up(self.reader.next, now_ns)
        if self.snapshots:
            self.snapshots.work(now_ns)

    def end_recording(self, now_ns: int) -> None:
        """Record all there is; idempotent."""
        if self.snapshots:
            self.snapshots.close(now_ns)
        if self.recorder:
            self.recorder.close(self.reader.next, now_ns)

    def close(self) -> None:
        """Finish the recording and let go of the files: first what reads the ring, then the ring."""
        self.end_recording(time.monotonic_ns())
        if self.mailbox:
            self.mailbox.close()
        if self.goals:
            self.goals.close()
        self.reader.close()
