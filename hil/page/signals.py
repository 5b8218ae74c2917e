"""What of a tick's record the page can draw: a signal is one number a tick."""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.events.followed import FIELDS as FOLLOWED
from hil.events.followed import followed

# name, field of the record, unit of a linear and of a rotary axis
_QUANTITIES: Final = (
    ("position", "position", "m", "rad"),
    ("setpoint", "setpoint_position", "m", "rad"),
    ("error", "following_error", "m", "rad"),
    ("force", "force", "N", "N m"),
    ("force asked", "force_requested", "N", "N m"),
    ("velocity", "velocity_estimate", "m/s", "rad/s"),
    ("disturbance", "disturbance_estimate", "N", "N m"),
    ("innovation", "innovation", "m", "rad"),
)
_PER_TICK: Final = ("index", "scheduled_ns", "now_ns", "state", "fault", "motion", "task_ns", "cpu_ns", "run_delay_ns")
FIELDS: Final = (*_PER_TICK, *(field for _, field, _, _ in _QUANTITIES), "readings")
OF_THE_LOOP: Final = ("lateness", "CPU time", "run delay")  # s, of every tick


class Signal(NamedTuple):
    """quantity: what it is. axis: whose, or of which sensor; empty: the loop's. unit: SI. low, high: its limits, None
    where it has none.
    """

    quantity: str
    axis: str
    unit: str
    low: float | None
    high: float | None


def signals_of(rig: Mapping[str, Any]) -> list[Signal]:
    """The signals of a rig, in the order of `rows`. rig: as the ring's metadata have it."""
    found = []
    for name, _, linear, rotary in _QUANTITIES:
        for axis, table in rig["axes"].items():
            low, high = _limits(name, table["limits"])
            found.append(Signal(name, axis, linear if table["kind"] == "linear" else rotary, low, high))
    for name, sensor in rig.get("sensors", {}).items():
        found.append(Signal("reading", name, str(sensor["unit"]), None, None))
    return [*found, *(Signal(name, "", "s", None, None) for name in OF_THE_LOOP)]


def _limits(quantity: str, limits: Mapping[str, Any]) -> tuple[float | None, float | None]:
    if quantity in ("position", "setpoint"):
        low, high = limits["position"]
        return float(low), float(high)
    bound = {"error": "following_error", "force": "force", "force asked": "force", "velocity": "speed"}.get(quantity)
    return (None, None) if bound is None else (-float(limits[bound]), float(limits[bound]))


def rows(records: NDArray[np.void], n_axes: int, n_sensors: int = 0) -> NDArray[np.float64]:
    """(signals, ticks), in the order of `signals_of`. records: with FIELDS. NaN for setpoint and error where nothing is
    followed, and for a reading before the first.
    """
    nobody = ~followed(records)
    per_axis = []
    for _, field, _, _ in _QUANTITIES:
        values = records[field][:, :n_axes].T
        per_axis.append(np.where(nobody, np.nan, values) if field in FOLLOWED else values)
    loop = [
        records["now_ns"] - records["scheduled_ns"],
        records["cpu_ns"].sum(axis=1, dtype=np.int64),
        records["run_delay_ns"].astype(np.int64),
    ]
    return np.vstack([*per_axis, records["readings"][:, :n_sensors].T, np.array(loop) * 1e-9])
