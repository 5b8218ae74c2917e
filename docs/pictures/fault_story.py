"""A fault's story: what the axis did, and what `hil events` says of it, on one time axis."""

from pathlib import Path

import numpy as np

import hil
from docs.pictures.sheet import CURVES, SOFT, figure

SCENARIO, SECONDS, AXIS = "bad-day", 9.0, "z"
BEFORE, AFTER = 0.02, 0.06  # s around the first event that stops the rig


def draw(path: Path) -> None:
    """The shipped scenario `bad-day`: Z's encoder dies inside a cell. Position, force, and the events in words."""
    run = hil.simulate("microscope", SECONDS, scenario=SCENARIO)
    axis = run.axes.index(AXIS)
    at = next(event.run_ns * 1e-9 for event in run.log if event.kind.name == "FAULT_LATCHED")
    near = (run.time > at - BEFORE) & (run.time < at + AFTER)
    time = (run.time[near] - at) * 1e3
    sampled = np.where(run.columns["age_ticks"][:, axis] == 0, run.measured[:, axis], np.nan)
    setpoint = run.columns["setpoint_position"][:, axis]
    told = [event for event in run.log if -BEFORE < event.run_ns * 1e-9 - at < AFTER]
    with figure(path, (9, 5)) as drawn:
        panels = drawn.subplots(3, 1, sharex=True, height_ratios=(3, 3, 2))
        panels[0].plot(time, setpoint[near] * 1e3, color=SOFT, linestyle="--", label="set-point")
        panels[0].plot(time, sampled[near] * 1e3, color=CURVES[0], linewidth=3, label="as measured")
        if run.true is not None:
            panels[0].plot(time, run.true[near, axis] * 1e3, color=CURVES[2], label="where it was")
        panels[0].set_ylabel("Z, mm")
        panels[0].legend(fontsize=7, frameon=False)
        panels[1].plot(time, run.force[near, axis], color=CURVES[1])
        panels[1].set_ylabel("force on Z, N")
        panels[2].set_yticks([])
        panels[2].set_ylim(len(told), -0.5)
        panels[2].spines["left"].set_visible(False)
        panels[2].set_xlabel(f"time from the fault, ms (hil sim microscope --faults {SCENARIO})")
        for row, event in enumerate(told):
            when = (event.run_ns * 1e-9 - at) * 1e3
            panels[2].plot([when], [row], marker="o", color=CURVES[1], markersize=4)
            panels[2].annotate(f" {event.text}", (when, row), fontsize=7.5, va="center")
            for panel in panels[:2]:
                panel.axvline(when, color=CURVES[1], linewidth=0.6, alpha=0.6)
