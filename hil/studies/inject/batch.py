"""One batch in virtual time: the motion's own account of each cell beside the emulated dish's truth."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isnan, nan
from pathlib import Path

import numpy as np

from drivers.frame import Frame
from drivers.protocols.base import HostProtocol
from hil.control.motion.injection.verdict import CellResult, Verdict
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.record import RECORD
from hil.cycle.tick import CycleResult, Tick
from hil.rig.schema import RigConfig
from hil.studies.inject.requests import Script
from hil.telemetry.cell_watch import FIELDS, CellWatch, Trace
from hil.virtual.lockstep import LockstepRun
from sim_plant.physics.dish import DishCell

PATIENCE_TICKS = 60_000  # for one cell; nothing takes a minute
BUFFERED = 500  # ticks whose records are looked at together

EXPECTED = {
    "": Verdict.OK, "no_cell": Verdict.NO_CELL, "rolled": Verdict.ROLLED, "not_pierced": Verdict.NOT_PIERCED,
    "double": Verdict.DOUBLE, "sensor_dead": Verdict.SENSOR_DEAD, "camera_frozen": Verdict.CAMERA_FROZEN,
    "clogged": Verdict.CLOGGED, "stuck": Verdict.STUCK, "broken": Verdict.BROKEN,
}  # fmt: skip

# What only a cell that is pierced can be: by `hold` none is.
PIERCED_FIRST = (Verdict.OK, Verdict.NOT_PIERCED, Verdict.DOUBLE, Verdict.CLOGGED, Verdict.STUCK)


@dataclass
class Injected:
    """A cell that is over. Its truth is the dish's; lengths in m, forces in N, times in s; NaN: it did not happen.

    expected: the verdict that its truth asks for. found_depth: below the true first touch where the touch was known.
    known_after: from the true puncture to its verdict. lurch: how far the tip went on behind it. wrong_pulses: into a
    cell that was whole, or into none. Of a cell that is real there is no truth, and nothing is expected.
    """

    result: CellResult
    anomaly: str
    expected: Verdict
    peak_force: float
    found_depth: float = nan
    known_after: float = nan
    lurch: float = nan
    wrong_pulses: int = 0

    @property
    def right(self) -> bool:
        """Whether the verdict is what the truth asks for."""
        return self.result.verdict is self.expected


@dataclass
class Batch:
    """cells: that are over, those of an earlier part included. fault, failure: how the run ended; empty where all is
    well. limited: ticks in which the motion asked for more than the axes may. seconds: that this part took. earlier:
    cells of earlier parts. traces: force over depth by number from 0 on, where they were kept.
    """

    cells: list[Injected] = field(default_factory=list)
    planned: int = 0
    ticks: int = 0
    seconds: float = 0.0
    fault: str = ""
    failure: str = ""
    limited: int = 0
    earlier: int = 0
    traces: dict[int, Trace] = field(default_factory=dict)

    @property
    def judged(self) -> list[Injected]:
        """The cells that nobody took out of the batch."""
        return [cell for cell in self.cells if not cell.result.left]


class Follower:
    """Who is told how a batch goes on; each does nothing unless it is overridden."""

    def at(self, number: int, phase: int, now_s: float) -> None:
        """Called in each tick, or as often as one looks. number: of the cell, from 1 on."""

    def over(self, cell: Injected) -> None:
        """A cell has its verdict."""


def inject(
    rig: RigConfig,
    base_dir: Path,
    followers: Sequence[Follower] = (),
    script: Script | None = None,
    layout: HostProtocol | None = None,
    *,
    keep: bool = False,
) -> Batch:
    """Run the rig's cells to the end, or to a fault. script: what an operator asks for meanwhile. layout: the rig's,
    where it has been built. keep: the traces.
    """
    return _Run(rig, base_dir, followers, script or Script([]), layout, keep=keep).whole()


class _Run:
    def __init__(
        self, rig: RigConfig, base_dir: Path, followers: Sequence[Follower], script: Script,
        layout: HostProtocol | None, *, keep: bool,
    ) -> None:  # fmt: skip
        self._watch = CellWatch(rig, keep=True) if keep else None
        self._rows = np.zeros(BUFFERED, [(name, RECORD[name]) for name in FIELDS])
        self._filled = 0
        observer = self._observe if keep else None
        self._run = LockstepRun(rig, base_dir, layout=layout, observer=observer)
        self._followers, self._script, self._period = followers, script, rig.period_ns * 1e-9
        desk = self._run.cycle.supervisor.goals
        assert desk.decided is not None
        self._desk, self._decided, self._motion = desk, desk.decided, desk.decided.motion
        self._began = -1
        self._asked = 0
        self._holds = rig.motion.parameters.get("z_law") == "hold"
        self.batch = Batch(planned=self._motion.total, earlier=self._motion.over)

    def whole(self) -> Batch:
        """Until it ends."""
        run, batch = self._run, self.batch
        since = 0
        while not run.cycle.fault and run.index - since < PATIENCE_TICKS:
            self._ask()
            run.tick()
            if self._began < 0 and self._desk.word is MotionWord.MOTION:
                self._began = run.index - 1
            if len(self._motion.results) > len(batch.cells):
                since = run.index
                self._over(self._motion.results[-1])
            for follower in self._followers:
                follower.at(self._decided.cell, self._decided.phase, run.index * self._period)
            if self._began >= 0 and not self._decided.runs:
                break
        batch.ticks, batch.seconds = run.index, run.index * self._period
        batch.fault = run.cycle.fault.name if run.cycle.fault else ""
        batch.failure, batch.limited = run.cycle.failure, self._decided.limited
        if self._watch is not None:
            self._watch.add(self._rows[: self._filled])
            batch.traces = self._watch.traces or {}
        return batch

    def _ask(self) -> None:
        request = self._script.due(self._decided.cell, self._decided.phase, self._run.index * self._period)
        if request:
            self._asked += 1
            self._run.goals.append(Goal(self._asked, GoalKind.REQUEST, flags=request))

    @staticmethod
    def _held(cell: DishCell) -> Verdict:
        """Under `hold` a membrane that stays whole is as it should be; a weak one gives way below that force."""
        expected = EXPECTED[cell.anomaly]
        if expected not in PIERCED_FIRST:
            return expected
        return Verdict.HELD if cell.pierced_ns is None else Verdict.BURST

    def _over(self, result: CellResult) -> None:
        dish = self._run.stage.dish
        assert dish is not None
        truth = dish.cells[result.number]
        cell = _beside(result, truth, self._began * self._period)
        if self._holds:
            cell.expected = self._held(truth)
        self.batch.cells.append(cell)
        for follower in self._followers:
            follower.over(cell)

    def _observe(self, tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        """Only what the traces are made of."""
        assert self._watch is not None
        row = self._rows[self._filled]
        for name in FIELDS:
            row[name] = result.record[name]
        self._filled += 1
        if self._filled == BUFFERED:
            self._watch.add(self._rows.copy())
            self._filled = 0


def _beside(result: CellResult, cell: DishCell, began_s: float) -> Injected:
    anomaly = cell.anomaly
    if anomaly == "double" and cell.doubled_ns is None:  # it never came so far
        anomaly = ""
    found = Injected(result, cell.anomaly, EXPECTED[anomaly], cell.peak_force)
    if cell.contact is not None and not isnan(result.found):
        found.found_depth = abs(result.found - cell.contact)
    if cell.puncture is not None and not isnan(result.pierced_s):
        found.known_after = began_s + result.pierced_s - cell.puncture.at_ns * 1e-9
        if not isnan(result.rested):
            found.lurch = abs(result.rested - cell.top) - cell.puncture.depth
    found.wrong_pulses = sum(not pulse.pierced for pulse in cell.pulses)
    return found
