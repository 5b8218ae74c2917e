"""What a task asks of the axes, for people: how long it lasts, its greatest speed, acceleration and force, and where a
path goes beyond its rows.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.analysis.feasibility import chunks, corner_starts, smooth_force
from hil.control.trajectories import plan_task
from hil.control.trajectories.kinds import timed_body
from hil.control.trajectories.rows import Excursion, excursions
from hil.rig.schema import RigConfig

TOLD = 5  # excursions that are told one by one


class Peak(NamedTuple):
    """A greatest value, and when, s after the task's start."""

    value: float
    time_s: float


class TaskFigures(NamedTuple):
    """duration_s: with the approach from home; None: it goes on for ever. repeat_s: of one repeat, else None. peaks:
    "speed", "acceleration" and "force" by axis, m/s, m/s^2 and N (rad, N m), with the nominal model's friction.
    """

    duration_s: float | None
    repeat_s: float | None
    peaks: dict[str, dict[str, Peak]]

    def as_json(self) -> dict[str, Any]:
        """The greatest of each over all axes, and by axis; each with its time and axis."""
        found: dict[str, Any] = {"duration_s": self.duration_s, "repeat_s": self.repeat_s}
        for quantity in ("speed", "acceleration", "force"):
            axis = max(self.peaks, key=lambda name: self.peaks[name][quantity].value)
            found[quantity] = {"axis": axis, **self.peaks[axis][quantity]._asdict()}
        found["axes"] = {
            name: {quantity: peak._asdict() for quantity, peak in peaks.items()} for name, peaks in self.peaks.items()
        }
        return found

    def notes(self, units: dict[str, str]) -> list[str]:
        """A line for the whole, and one an axis. units: "m" or "rad" by axis."""
        lasts = "goes on for ever" if self.duration_s is None else f"lasts {self.duration_s:.3f} s"
        repeats = f", each repeat {self.repeat_s:.3f} s" if self.repeat_s is not None else ""
        lines = [f"task: {lasts}{repeats}"]
        for name, peaks in self.peaks.items():
            unit = units[name]
            speed, acceleration, force = peaks["speed"], peaks["acceleration"], peaks["force"]
            lines.append(
                f"task, axis {name}: at most {speed.value:.4g} {unit}/s at {speed.time_s:.3f} s, "
                f"{acceleration.value:.4g} {unit}/s^2 at {acceleration.time_s:.3f} s, "
                f"{force.value:.4g} {'N' if unit == 'm' else 'N m'} at {force.time_s:.3f} s"
            )
        return lines


def task_figures(rig: RigConfig, start: Sequence[float] | None = None) -> TaskFigures:
    """Of the rig's task from rest at `start`, m (rad) by axis, else from home. Raises ValueError as plan_task."""
    place = corner_starts(rig)["home"] if start is None else start
    trajectory = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts)(place)
    peaks: dict[str, dict[str, Peak]] = {name: {} for name in rig.axes}
    for times, _, velocities, accelerations in chunks(trajectory, len(rig.axes), rig.period_ns):
        for index, (name, axis) in enumerate(rig.axes.items()):
            v, a = velocities[:, index], accelerations[:, index]
            force = np.abs(smooth_force(axis.model, v, a) + axis.model.coulomb * np.sign(v))
            for quantity, values in (("speed", np.abs(v)), ("acceleration", np.abs(a)), ("force", force)):
                at = int(np.argmax(values))
                peak = Peak(float(values[at]), float(times[at]))
                if peak.value > peaks[name].get(quantity, Peak(-math.inf, 0.0)).value:
                    peaks[name][quantity] = peak
    duration, repeat = trajectory.duration_ns, trajectory.repeat_ns
    return TaskFigures(None if duration is None else duration * 1e-9, None if repeat is None else repeat * 1e-9, peaks)


def task_excursions(rig: RigConfig) -> list[Excursion]:
    """Where a path goes beyond two neighbouring rows by more than a count of the encoder."""
    task = rig.task
    if not task.timed:
        return []
    counts = dict(zip(rig.axes, rig.counts, strict=True))
    return excursions(task.samples, timed_body(task), [counts[name] for name in task.axes])


def excursion_notes(rig: RigConfig) -> list[str]:
    """The longest of them, with row and um (urad), the worst first."""
    found = sorted(task_excursions(rig), key=lambda excursion: -excursion.beyond)
    lines = [_text(rig, excursion) for excursion in found[:TOLD]]
    if len(found) > TOLD:
        lines.append(f"task.samples: {len(found) - TOLD} more rows with less; hil check --json lists them all")
    return lines


def excursion_problems(rig: RigConfig) -> list[str]:
    """Those that are longer than task.beyond allows."""
    bound = rig.task.beyond
    found = [excursion for excursion in task_excursions(rig) if excursion.share > bound]
    if not found:
        return []
    worst = max(found, key=lambda excursion: excursion.share)
    return [
        f"{_text(rig, worst)}, {worst.share:.1%} of its longest step; task.beyond = {bound:g} allows {bound:.1%}. "
        "task.between = 'blended' never goes beyond"
    ]


def excursions_json(rig: RigConfig) -> list[dict[str, Any]]:
    """All of them: axis, row, beyond (m, rad), share."""
    return [
        {"axis": rig.task.axes[x.column], "row": x.row, "beyond": x.beyond, "share": x.share}
        for x in task_excursions(rig)
    ]


def _text(rig: RigConfig, excursion: Excursion) -> str:
    name, row = rig.task.axes[excursion.column], excursion.row
    unit = "um" if rig.axes[name].kind == "linear" else "urad"
    return f"task.samples: axis {name} goes {excursion.beyond * 1e6:.3f} {unit} beyond rows {row} and {row + 1}"
