"""What a run holds and tells, by type: names of columns, figures, differences. Editors and type checkers know them."""

from typing import Any, Literal, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from hil.analysis.figures_of_merit import Figures

Column = Literal[
    "index", "scheduled_ns", "now_ns", "state", "fault", "faults_active", "task_ns", "motion", "run_delay_ns",
    "position", "position_estimate", "velocity_estimate", "disturbance_estimate", "innovation", "setpoint_position",
    "setpoint_velocity", "following_error", "force_requested", "force", "stamp_ns", "age_ticks", "drive_status",
    "cpu_ns", "readings", "reading_age",
]  # fmt: skip
Array = NDArray[np.float64]
Columns = dict[Column, NDArray[Any]]


class Event(NamedTuple):
    """Something that happened. time: s from the first tick."""

    time: float
    text: str


def seconds_of(columns: Columns) -> Array:
    """When each tick was due, s from the first, (ticks,): the time axis of everything that shows a run."""
    scheduled = columns["scheduled_ns"]
    seconds: Array = (scheduled - scheduled[:1]) * 1e-9
    return seconds


class Difference(TypedDict):
    """The largest differences of two runs on one axis: m, m, N (rad, N m)."""

    setpoint: float
    error: float
    force: float


class Summary(TypedDict):
    """Figures of a run. steady_from_s: where the steady window begins, None: nowhere; axes: figures there. settled:
    whether approach and settling were over then.
    """

    rig: str
    law: str
    ticks: int
    seconds: float
    final_state: str | None
    faults: list[str]
    steady_from_s: float | None
    settled: bool
    axes: dict[str, Figures]
