"""A law and a task of one's own, a simulation, and its recording read back: what most programs do."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

import hil


class Lead(hil.Law):
    """PD with the nominal model's gravity."""

    GAINS: ClassVar = {"kp": hil.Gain(100.0, "N/m", tune=hil.Knob(10.0, 1e4)), "kd": 2.0}

    def __init__(self, model: hil.Model, period: float, force_limit: float, kp: float, kd: float) -> None:
        self.model, self.kp, self.kd, self.limit = model, kp, kd, force_limit

    def reset(self, position: float, force: float) -> None:
        self.began = position

    def force(self, inputs: hil.LawInputs) -> float:
        error: float = inputs.start.position - inputs.position_estimate
        rate: float = inputs.start.velocity - inputs.velocity_estimate
        return self.kp * error + self.kd * rate + float(self.model.gravity)


class Rose(hil.Task):
    """A rose of two axes."""

    def __init__(self, axes: Sequence[str], radius: float = 1e-3) -> None:
        super().__init__(axes)
        self.radius = radius

    def samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        time = np.linspace(0.0, 4.0, 401)
        return time, np.column_stack([self.radius * np.sin(time), self.radius * np.cos(time)])


def worst_error(run: hil.Run, axis: str) -> float:
    """Of the steady window, m."""
    return run.summary()["axes"][axis]["max_error"]


def main() -> None:
    """Simulate, record, read back, compare."""
    rig = hil.load_rig("paper", ["law.name=pid"])
    try:
        run = hil.simulate(rig, seconds=2.0, record="run.mcap")
    except hil.RigError as error:
        raise SystemExit(str(error)) from None
    print(worst_error(run, "x"), run.trace_sha256, run.figures.ticks)
    recording = hil.Recording("run.mcap")
    estimate = recording.columns["position_estimate"]
    print(estimate[:, 0].max(), recording.lost, recording.truncated, recording.events[0].text)
    for name, difference in run.compare(recording).items():
        print(name, difference["force"])
    columns: list[hil.Column] = ["force", "age_ticks"]
    for column in columns:
        print(column, recording.columns[column].shape)
    print(hil.replay("run.mcap").different)
