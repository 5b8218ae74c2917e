"""The last second of ticks, in the few figures a status message shows."""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.events.followed import followed
from hil.telemetry import codec
from hil.telemetry import telemetry_pb2 as pb

STALE_NS = 500_000_000  # a control process whose newest tick is older hangs, or is gone
SILENT_S = 0.5  # an axis that has not answered for so long has fallen silent


def silent_axes(names: Iterable[str], ages_s: Iterable[float]) -> str:
    """Which axes' drives have fallen silent and how long ago, in words; empty where all answer. ages_s: since each
    answered last.
    """
    silent = [f"{name} for {age:.1f} s" for name, age in zip(names, ages_s, strict=False) if age > SILENT_S]
    return f"no answer from {', '.join(silent)}" if silent else ""


class Window:
    """Keeps lateness (ns) and following error of the newest ticks. ticks: how many."""

    def __init__(self, ticks: int, n_axes: int) -> None:
        self._ticks = ticks
        self._n_axes = n_axes
        self._lateness: deque[NDArray[np.int64]] = deque()
        self._errors: deque[NDArray[np.float64]] = deque()
        self._held = 0
        self.last: np.void | None = None

    def add(self, records: codec.Records) -> None:
        """Take a batch in; batches beyond the window fall out."""
        if not len(records):
            return
        errors = np.abs(records["following_error"][:, : self._n_axes])
        errors[~followed(records)] = np.nan
        self._lateness.append(records["now_ns"] - records["scheduled_ns"])
        self._errors.append(errors)
        self._held += len(records)
        self.last = records[-1].copy()
        while self._held - len(self._lateness[0]) >= self._ticks:
            self._held -= len(self._lateness.popleft())
            self._errors.popleft()

    @property
    def state(self) -> str:
        """Name of the newest tick's state."""
        return "-" if self.last is None else State(int(self.last["state"])).name

    def state_at(self, now_ns: int) -> str:
        """The same for people, with its age where the control process has not ticked since."""
        age_ns = 0 if self.last is None else now_ns - int(self.last["now_ns"])
        return f"{self.state} {age_ns * 1e-9:.1f} s ago, nothing since" if age_ns > STALE_NS else self.state

    @property
    def rests(self) -> bool:
        """Whether the newest tick permits no torque."""
        return self.last is not None and int(self.last["state"]) not in TORQUE_STATES

    def fill(self, status: pb.Status) -> None:
        """Write the figures into a status message."""
        last = self.last
        if last is None:
            return
        n = self._n_axes
        status.state = self.state
        status.fault = Fault(int(last["fault"])).name
        status.faults_active.extend(fault.name for fault in Fault if int(last["faults_active"]) >> fault & 1)
        status.index = int(last["index"])
        status.tick_ns = int(last["now_ns"])
        status.task_ns = int(last["task_ns"])
        status.motion = MotionWord(int(last["motion"])).name
        status.counters.CopyFrom(codec.counters(last, n))
        status.position.extend(last["position"][:n].tolist())
        held = followed(np.atleast_1d(last))[0]
        status.setpoint.extend(last["setpoint_position"][:n].tolist() if held else [math.nan] * n)
        status.force.extend(last["force"][:n].tolist())
        status.drive_status.extend(last["drive_status"][:n].tolist())
        status.answer_age.extend((last["age_ticks"][:n] * (status.period_ns * 1e-9)).tolist())
        largest = [np.fmax.reduce(batch) for batch in self._errors]
        status.max_error.extend(np.fmax.reduce(largest).tolist())
        lateness = np.concatenate(self._lateness) * 1e-9
        status.lateness_p50, status.lateness_p99 = np.percentile(lateness, (50, 99)).tolist()
        status.lateness_max = float(lateness.max())
