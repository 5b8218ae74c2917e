"""A batch live: a running rig's cells followed tick by tick, and what the operator asks of it.

The ring that the control process writes shows it, and its goal page takes what is asked. The lease is held for that
moment alone, so that a second terminal may ask, too.
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from math import nan
from typing import Final

import numpy as np
from rich.console import Console

from hil.control.motion.contract import Request
from hil.control.motion.injection.verdict import Phase, Verdict
from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, GoalKind, MotionError, MotionWord
from hil.live.goal_page import GoalPage
from hil.live.ring import RingReader
from hil.live.runtime_paths import RuntimePaths
from hil.operate.demo_live import Demo, Interrupted, Scene, Signals
from hil.rig.schema import RigConfig, RigError
from hil.studies.inject.batch import Batch, Follower, Injected
from hil.studies.inject.requests import Script
from hil.telemetry.cell_watch import FIELDS, CellWatch
from hil.telemetry.client import RigClient

POLL_S: Final = 0.01
READ: Final = 2000  # ticks at once
VERDICT_S: Final = 1.0
KEYS: Final = {"p": Request.PAUSE, "r": Request.RESUME, "s": Request.SKIP, "a": Request.ABORT}


class LiveBatch:
    """Follows the batch of one control process. keys: what was pressed since it was called last. stops: how often
    the rig stopped; the batch goes on where somebody activates it again.
    """

    def __init__(
        self, paths: RuntimePaths, rig: RigConfig, followers: Sequence[Follower], script: Script,
        keys: Callable[[], str] = lambda: "",
    ) -> None:  # fmt: skip
        self.stops = 0
        self._stopped = False
        self.batch = Batch(planned=len(rig.motion.parameters["cells"]))
        self.batch.earlier = int(rig.motion.parameters.get("first", 1)) - 1
        self.troubles: list[str] = []
        self._followers, self._script, self._keys = followers, script, keys
        self._period = rig.period_ns * 1e-9
        self._watch = CellWatch(rig, keep=True)
        self._last = -1
        with contextlib.ExitStack() as undo:
            self._ring = undo.enter_context(RingReader(paths.ring))
            self._page = undo.enter_context(GoalPage(paths.goals))
            self._undo = undo.pop_all()
        self._aborted = False

    def close(self) -> None:
        """Let go of the files."""
        self._undo.close()

    def step(self) -> bool:
        """Look at the ticks since the last look; False once the batch is over."""
        read = self._ring.read(READ, (*FIELDS, "fault"))
        if read.lost:
            self.troubles.append(f"{read.lost} ticks were overwritten before they were read: a cell's figures may lack")
        records = read.records
        for told in self._watch.add(records):
            if told.over:
                self._over(Injected(told.result, "", Verdict.NONE, nan))
            else:
                self._tell(told.result.number + 1, told.phase)
        self.batch.traces = self._watch.traces or {}
        over = self._ended(records[-1]) if len(records) else not self._ring.writer_alive
        if not over:
            self._tell(self._watch.number, self._watch.phase)
            self._heed()
        return not over

    def _ended(self, record: np.void) -> bool:
        """Whether the motion has ended by the newest tick; where the rig has merely stopped it may begin again."""
        self._last, batch = int(record["index"]), self.batch
        word, stopped = MotionWord(int(record["motion"])), bool(record["fault"])
        self.stops += stopped and not self._stopped
        self._stopped = stopped
        batch.fault = Fault(int(record["fault"])).name if stopped else ""
        if self._watch.began < 0:
            return False
        batch.ticks = self._last - self._watch.began
        batch.seconds = batch.ticks * self._period
        return word not in (MotionWord.MOTION, MotionWord.NONE)

    def _heed(self) -> None:
        """The script and the operator."""
        for request in (
            self._script.due(self._watch.number, self._watch.phase, self._last * self._period),
            *(KEYS[key] for key in self._keys() if key in KEYS),
        ):
            if request:
                self.ask(request)

    def ask(self, request: Request) -> None:
        """Post it and wait for the tick that takes it; where it is refused, `troubles` says why."""
        try:
            self._page.take_lease()
            number = self._page.post(Goal(0, GoalKind.REQUEST, flags=int(request)))
            until = time.monotonic() + VERDICT_S
            while (refusal := self._page.verdict(number)) is None and time.monotonic() < until:
                time.sleep(self._period)
            self._page.give_back()
        except MotionError as error:
            self.troubles.append(f"{request.name.lower()}: {error}")
            return
        if refusal is None or refusal:
            why = "no tick took it" if refusal is None else refusal.text
            self.troubles.append(f"{request.name.lower()}: {why}")

    def abort(self, why: str) -> None:
        """Take the tip out of the cell and end, once; `why` is told."""
        if not self._aborted:
            self._aborted = True
            self.troubles.append(why)
            self.ask(Request.ABORT)

    def _over(self, cell: Injected) -> None:
        self.batch.cells.append(cell)
        self._call(lambda follower: follower.over(cell))

    def _tell(self, number: int, phase: int) -> None:
        if phase <= Phase.PAUSED:
            self._call(lambda follower: follower.at(number, phase, self._last * self._period))

    def _call(self, what: Callable[[Follower], None]) -> None:
        """A file that cannot be written ends the batch in good order."""
        for follower in self._followers:
            try:
                what(follower)
            except RigError as error:
                self.abort(str(error))


def follow(live: LiveBatch, signals: Signals, look: Callable[[], object] = lambda: None) -> None:
    """Until the batch is over. The first Ctrl-C aborts it in good order, the second raises Interrupted."""
    while live.step():
        try:
            signals.check()
            look()
        except Interrupted:
            if _INTERRUPTED in live.troubles:
                raise
            signals.seen = 0
            live.abort(_INTERRUPTED)
        time.sleep(POLL_S)


_INTERRUPTED: Final = "interrupted: the tip leaves the cell, and the batch ends"


class LiveInjection(Demo):
    """A batch on an emulated stage: its processes as those of `hil demo`, in real time."""

    def __init__(
        self, scene: Scene, console: Console, signals: Signals, followers: Sequence[Follower], script: Script,
        keys: Callable[[], str],
    ) -> None:  # fmt: skip
        super().__init__(scene, console, signals, insists=True, holds=False)
        self._follows = followers, script, keys
        self.live: LiveBatch | None = None

    def _watch(self, client: RigClient, seconds: float) -> None:
        self.live = LiveBatch(self.scene.paths, self.scene.rig, *self._follows)
        try:
            follow(self.live, self._signals, lambda: self._look(client))
        finally:
            self.live.close()
