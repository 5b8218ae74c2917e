"""Force and position of an axis, evenly spaced, from a run whose ticks were not.

Rules:
- A position is taken, and a force begins, when the drive says so: by its stamp where the run has it, else by when the
  tick woke. On a moving axis that matters: at 10 mm/s a tick that is 0.1 ms late is seen 1 um further on.
- The instants of `Signals` follow each other by the rig's period, at the usual distance from the ticks' starts.
- A drive keeps its force while a tick is late or lost; over an instant's period its mean counts.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from drivers.protocols import device_protocol
from hil.identify.estimate import Array, Refused
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from hil.runs.api import Run

MOST_LOST = 5e-3  # of a live run's ticks
BRIDGED = 2.5  # periods between samples, at most, where a response is to be seen
HERE = Path()

Ticks = NDArray[np.int64]


@dataclass(frozen=True)
class Signals:
    """Of one axis of a run, (n,) each. seconds: task time at each instant; position: there; force: its mean from there
    to the next. step: what was sent last, and late: by how many s after the instant it began to act. stalled: instants
    in a gap of the samples that nothing bridges. period: s between instants; count: of the encoder, m (rad); rounding:
    N, by which frames may change a force.
    """

    force: Array
    step: Array
    late: Array
    position: Array
    seconds: Array
    stalled: NDArray[np.bool_]
    period: float
    count: float
    rounding: float

    def cut(self, begin: float, end: float) -> slice:
        """Of that task time."""
        first, last = np.searchsorted(self.seconds, [begin - 1e-9, end - 1e-9])
        return slice(int(first), int(last))


def signals(run: Run, axis: str, folder: Path = HERE) -> Signals:
    """Of the task's ticks. folder: where the rig's files are. Raises Refused where more than MOST_LOST of the ticks are
    missing.
    """
    if missing := too_many_lost(run):
        raise Refused(missing)
    at, config, period, index = run.axes.index(axis), run.rig.axes[axis], run.rig.period_ns, run.columns["index"]
    taken, fresh = _samples(run, at)
    due = run.columns["scheduled_ns"][:-1]
    usual = int(np.median((taken - due)[fresh])) if fresh.any() else 0
    every = np.arange(index[0], index[-1]) if len(index) else index
    grid = run.columns["scheduled_ns"][:1] + (every - index[:1]) * period + usual
    stalled = _far_from(taken[fresh], grid, period)
    position = _between(taken[fresh], run.columns["position"][1:, at][fresh], grid, stalled)
    begins = _begins(run, at, taken, fresh, folder)
    last = np.searchsorted(index, every, side="right") - 1
    task_ns = run.columns["task_ns"][last]
    seconds = np.where(task_ns >= 0, task_ns + (every - index[last]) * period, task_ns) * 1e-9
    during = seconds >= 0.0
    sent = run.columns["force"][:-1, at]
    late = np.where(index[last] == every, begins[last] - grid, 0) * 1e-9
    return Signals(
        force=_mean(begins, sent, grid, period)[during],
        step=sent[last][during],
        late=late[during],
        position=position[during],
        seconds=seconds[during],
        stalled=stalled[during],
        period=period * 1e-9,
        count=config.encoder_resolution,
        rounding=config.rated_force * _force_resolution(run.rig, folder),
    )


def too_many_lost(run: Run) -> str:
    """In words, where more than MOST_LOST of the run's ticks are missing; else ""."""
    index = run.columns["index"]
    every = int(index[-1] - index[0]) + 1 if len(index) else 0
    lost = every - len(index)
    return f"{lost} of {every} ticks are missing; limit {MOST_LOST * 100:g} %" if lost > MOST_LOST * every else ""


def _samples(run: Run, at: int) -> tuple[Ticks, NDArray[np.bool_]]:
    """When the samples were taken that each tick but the first received, ns; whether it received one."""
    fresh = run.columns["age_ticks"][1:, at] == 0
    woke = run.columns["now_ns"][:-1]
    if "stamp_ns" not in run.columns:
        return woke, fresh
    stamp = run.columns["stamp_ns"][1:, at]
    later = stamp > np.maximum.accumulate(np.concatenate([[np.iinfo(np.int64).min], stamp[:-1]]))
    return stamp, fresh & later


def _begins(run: Run, at: int, taken: Ticks, fresh: NDArray[np.bool_], folder: Path) -> Ticks:
    """When the force of each tick but the last began to act, ns."""
    woke, after = run.columns["now_ns"][:-1], run.columns["now_ns"][1:]
    try:
        acts_ns = host_layout(run.rig, folder).acts_ns
    except (ValueError, OSError):  # of a recording whose files are not here
        acts_ns = ()
    if acts_ns:
        return woke + acts_ns[at]
    usual = int(np.median((taken - woke)[fresh])) if fresh.any() else 0
    begins = np.where(fresh & (taken >= woke) & (taken <= after), taken, woke + usual)
    return np.maximum.accumulate(begins)


def _force_resolution(rig: RigConfig, folder: Path) -> float:
    """Half of a step of the force, as a share of the rated one."""
    rated = [axis.rated_force for axis in rig.axes.values()]
    try:
        device = device_protocol(rig.bus, len(rated), rated, folder, rig.mountings)
    except (ValueError, OSError):
        return 0.0
    return float(getattr(device, "force_resolution", 0.0))


def _between(when: Ticks, position: Array, grid: Ticks, straight: NDArray[np.bool_]) -> Array:
    """Positions at the instants of a grid, ns; some on a straight line between the samples."""
    if len(when) < 2:
        return np.full(len(grid), position[0] if len(position) else 0.0)
    zero = when[0]
    curve: Array = CubicSpline((when - zero) * 1e-9, position)((grid - zero) * 1e-9)
    lines: Array = np.interp(grid, when, position)
    return np.where(straight | (grid < when[0]) | (grid > when[-1]), lines, curve)


def _mean(begins: Ticks, force: Array, grid: Ticks, period: int) -> Array:
    """Of a force that is kept from each of its beginnings on, over each period of the grid."""
    if not len(grid):
        return np.zeros(0)
    whole = np.concatenate([[0.0], np.cumsum(np.diff(begins) * force[:-1])])
    ends = np.append(grid, grid[-1] + period)
    at = np.clip(np.searchsorted(begins, ends, side="right") - 1, 0, None)
    impulse: Array = whole[at] + (ends - begins[at]) * force[at]
    return np.diff(impulse) / period


def _far_from(when: Ticks, grid: Ticks, period: int) -> NDArray[np.bool_]:
    """Whether the samples around each instant are more than BRIDGED periods apart."""
    if len(when) < 2:
        return np.ones(len(grid), bool)
    at = np.clip(np.searchsorted(when, grid, side="right"), 1, len(when) - 1)
    far: NDArray[np.bool_] = when[at] - when[at - 1] > BRIDGED * period
    return far
