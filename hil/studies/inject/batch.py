"""One batch in virtual time: the motion's own account of each cell beside the emulated dish's truth."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isnan, nan
from pathlib import Path

from drivers.protocols.base import HostProtocol
from hil.control.motion.injection.verdict import CellResult, Verdict
from hil.cycle.goal import MotionWord
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from sim_plant.physics.dish import DishCell

PATIENCE_TICKS = 60_000  # for one cell; nothing takes a minute

EXPECTED = {
    "": Verdict.OK, "no_cell": Verdict.NO_CELL, "rolled": Verdict.ROLLED, "not_pierced": Verdict.NOT_PIERCED,
    "double": Verdict.DOUBLE, "sensor_dead": Verdict.SENSOR_DEAD, "camera_frozen": Verdict.CAMERA_FROZEN,
    "clogged": Verdict.CLOGGED, "stuck": Verdict.STUCK, "broken": Verdict.BROKEN,
}  # fmt: skip


@dataclass
class Injected:
    """A cell that is over. Its truth is the dish's; lengths in m, forces in N, times in s; NaN: it did not happen.

    expected: the verdict that its truth asks for. found_depth: below the true first touch where the touch was known.
    known_after: from the true puncture to its verdict. lurch: how far the tip went on behind it. wrong_pulses: into a
    cell that was whole, or into none.
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
    """fault, state, failure: how the run ended; empty words where all is well. limited: ticks in which the motion asked
    for more than the axes may.
    """

    cells: list[Injected] = field(default_factory=list)
    planned: int = 0
    ticks: int = 0
    seconds: float = 0.0
    fault: str = ""
    failure: str = ""
    limited: int = 0


def inject(
    rig: RigConfig,
    base_dir: Path,
    progress: Callable[[int, int], None] = lambda done, of: None,
    layout: HostProtocol | None = None,
) -> Batch:
    """Run the rig's cells to the end, or to a fault. progress: told of cells that are over, and of all. layout: the
    rig's, where it has been built.
    """
    run = LockstepRun(rig, base_dir, layout=layout)
    desk = run.cycle.supervisor.goals
    decided = desk.decided
    assert decided is not None
    motion, done, since, began = decided.motion, 0, 0, -1
    batch = Batch(planned=motion.total)
    while not run.cycle.fault and run.index - since < PATIENCE_TICKS:
        run.tick()
        if began < 0 and desk.word is MotionWord.MOTION:
            began = run.index - 1
        if len(motion.results) > done:
            done, since = len(motion.results), run.index
            progress(done, motion.total)
        if began >= 0 and not decided.runs:
            break
    run.stage.advance(run.index * rig.period_ns)
    batch.ticks, batch.seconds = run.index, run.index * rig.period_ns * 1e-9
    batch.fault = run.cycle.fault.name if run.cycle.fault else ""
    batch.failure, batch.limited = run.cycle.failure, decided.limited
    dish = run.stage.dish
    assert dish is not None
    period = rig.period_ns * 1e-9
    batch.cells = [
        _beside(result, cell, began * period) for result, cell in zip(motion.results, dish.cells, strict=False)
    ]
    return batch


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
