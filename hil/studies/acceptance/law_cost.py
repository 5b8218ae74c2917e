"""What a rig's law and its estimator cost by the tick: time of the slowest, and memory that is not given back."""

import gc
import math
import time
import tracemalloc
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.base import plugins
from hil.control.law_registry import law_class
from hil.cycle.state_machine import State
from hil.rig.schema import RigConfig
from hil.rig.tables import ESTIMATOR_KIND
from hil.virtual.lockstep import LockstepRun

REPEATS = 3  # of the same run: its ticks cost the same in each, what differs is the machine's doing
MOST_REPEATS = 12  # where a tick is still too slow: on a busy machine the law may have been held up in each of a few
MEASURED = 1000  # ticks after ACTIVE
MEMORY_TICKS = 600  # after ACTIVE; looked at half-way and at the end
START_TICKS = 2000  # at most, until ACTIVE
_FRAMES = 5


class Cost(NamedTuple):
    """Of one tick, all axes together. worst, median: s, of law and estimator alone. grows: bytes a tick that stay."""

    worst: float
    median: float
    grows: float


class _Timed:
    """The law with a clock around it: what the cycle calls, as it calls it."""

    def __init__(self, law: Any) -> None:
        self._law, self.spent = law, []  # type: tuple[Any, list[int]]

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """See AxisLaws."""
        self._law.reset(position, force)

    def force(self, axes: Sequence[Any]) -> list[float]:
        """See AxisLaws."""
        before = time.perf_counter_ns()
        asked: list[float] = self._law.force(axes)
        self.spent.append(time.perf_counter_ns() - before)
        return asked

    @property
    def failure(self) -> str:
        """See AxisLaws."""
        failure: str = self._law.failure
        return failure

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws."""
        floors: int = self._law.denominator_floors
        return floors


def law_cost(rig: RigConfig, folder: Path, wanted_s: float = math.inf) -> Cost:
    """Run the rig in lockstep and look at its law; more often while its slowest tick takes more than wanted_s. Raises
    ValueError where the rig does not become ACTIVE.
    """
    spent = np.array(_times(rig, folder))
    for repeats in range(1, MOST_REPEATS):
        if repeats >= REPEATS and spent.max() * 1e-9 <= wanted_s:
            break
        spent = np.minimum(spent, _times(rig, folder))
    return Cost(float(spent.max()) * 1e-9, float(np.median(spent)) * 1e-9, _growth(rig, folder))


def _times(rig: RigConfig, folder: Path) -> list[int]:
    run = LockstepRun(rig, folder)
    timed = _Timed(run.cycle.axes.law)
    run.cycle.axes.law = timed
    _until_active(run)
    timed.spent.clear()
    gc.collect()
    gc.disable()  # the control process does the same
    try:
        _go(run, MEASURED)
    finally:
        gc.enable()
    return timed.spent[:MEASURED]


def _growth(rig: RigConfig, folder: Path) -> float:
    """Bytes a tick that the files of the law and of a user's estimator take and keep."""
    made = [law_class(rig.law)]
    if rig.estimator.is_users:
        made.append(plugins.find(ESTIMATOR_KIND, rig.estimator.name, rig.estimator.source))
    own = [tracemalloc.Filter(True, plugins.code_file(each) or "-", all_frames=True) for each in made]
    run = LockstepRun(rig, folder)
    _until_active(run)
    half = MEMORY_TICKS // 2
    tracemalloc.start(_FRAMES)
    try:
        kept = []
        for _ in range(2):
            _go(run, half)
            gc.collect()
            kept.append(sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces(own).traces))
    finally:
        tracemalloc.stop()
    return max(0.0, (kept[1] - kept[0]) / half)


def _until_active(run: LockstepRun) -> None:
    for _ in range(START_TICKS):
        if run.cycle.state is State.ACTIVE:
            return
        run.tick()
    raise ValueError(f"the rig was not ACTIVE within {START_TICKS} ticks, it is {run.cycle.state.name}")


def _go(run: LockstepRun, ticks: int) -> None:
    for _ in range(ticks):
        run.tick()
