"""Pictures of a run: setpoint, following error and applied force over time."""

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from drivers.base.named_file import save_picture
from hil.cli.marks import Mark
from hil.rig.schema import RigConfig

_BUCKETS = 1500  # per drawn line; each keeps its lowest and highest value, so that no peak is lost
_WORDED_SHOWN = 6
UNITS = {"linear": ("mm", 1e3, "µm", 1e6, "N"), "rotary": ("mrad", 1e3, "µrad", 1e6, "N m")}
STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "lines.linewidth": 0.8,
    "svg.hashsalt": "hil",
}


class Tracked(Protocol):
    """A run to draw, from lockstep or from a recording. Arrays (ticks, n_axes); NaN where there is nothing."""

    @property
    def time(self) -> NDArray[np.float64]:
        """When each tick was due, s from the first, (ticks,); ticks may be missing."""

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Setpoint at the samples' instants, m."""

    @property
    def error(self) -> NDArray[np.float64]:
        """Following error at the samples' instants, m."""

    @property
    def force(self) -> NDArray[np.float64]:
        """Applied force, N."""


def tracking_picture(
    path: Path,
    rig: RigConfig,
    run: Tracked,
    lateness: NDArray[np.float64] | None = None,
    marks: Sequence[Mark] = (),
) -> None:
    """One column per axis: position, error and force over time (s); below, where known, tick lateness (s, per tick).

    Every mark is a line through the panels of its axis, those of latched faults and lost accuracy in words below; a
    .png file holds all of them as text, too (its Description).
    """
    n_axes = len(rig.axes)
    rows = 3 + (lateness is not None)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.4 * max(n_axes, 2), 2.0 * rows), layout="constrained")
        grid = figure.add_gridspec(rows, n_axes)
        for axis in range(n_axes):
            panels = [figure.add_subplot(grid[row, axis]) for row in range(3)]
            _axis_panels(panels, rig, run, axis)
            _mark(panels, run.time, [mark for mark in marks if mark.axis in ("", rig.axis_names[axis])])
        if lateness is not None:
            panel = figure.add_subplot(grid[3, :])
            _line(panel, rig, run.time, lateness * 1e6, "tick lateness, µs", "C4")
            _mark([panel], run.time, marks)
        figure.suptitle(f"{rig.name}: {rig.law.name} at {rig.rate_hz:g} Hz")
        if words := _words(marks, 40 * max(n_axes, 2)):
            figure.supxlabel(words, x=0.01, ha="left", fontsize=7, color="red", family="monospace")
        told = {"Description": "\n".join(mark.line for mark in marks)} if path.suffix == ".png" and marks else None
        save_picture(figure, path, dpi=110, metadata=told)


def axis_svg(rig: RigConfig, run: Tracked, axis: int) -> str:
    """Position, error and force of one axis over time, one below the other: SVG, the same text every time."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.0, 6.0), layout="constrained")
        _axis_panels(figure.subplots(3, 1), rig, run, axis)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()


def _axis_panels(panels: Sequence[Axes], rig: RigConfig, run: Tracked, axis: int) -> None:
    name, config = list(rig.axes.items())[axis]
    long, to_long, short, to_short, force_unit = UNITS[config.kind]
    panels[0].set_title(name, fontweight="bold")
    _line(panels[0], rig, run.time, run.setpoint[:, axis] * to_long, f"setpoint, {long}", "C0")
    _line(panels[1], rig, run.time, run.error[:, axis] * to_short, f"following error, {short}", "C3")
    _line(panels[2], rig, run.time, run.force[:, axis], f"force, {force_unit}", "C2")


def _mark(panels: Sequence[Axes], time: NDArray[np.float64], marks: Sequence[Mark]) -> None:
    """A line through every panel at each mark; its label in the first."""
    for mark in marks:
        at = float(time[min(mark.place, len(time) - 1)]) if len(time) else 0.0
        for panel in panels:
            panel.axvline(at, color=mark.colour, linestyle=mark.style, alpha=0.7)
        if mark.worded:
            panels[0].annotate(
                mark.label, (at, 1.0), xycoords=("data", "axes fraction"), rotation=90, va="top", ha="right",
                color=mark.colour, fontsize=7,
            )  # fmt: skip


def _words(marks: Sequence[Mark], width: int) -> str:
    """The first of them that are told in words, lines of `width` characters."""
    lines = [mark.line for mark in marks if mark.worded]
    shown = [textwrap.fill(line, width, subsequent_indent="    ") for line in lines[:_WORDED_SHOWN]]
    more = [f"and {len(lines) - _WORDED_SHOWN} more: hil events"] if len(lines) > _WORDED_SHOWN else []
    return "\n".join([*shown, *more])


def _line(
    panel: Axes, rig: RigConfig, time: NDArray[np.float64], values: NDArray[np.float64], label: str, colour: str
) -> None:
    """Draw values over time, thinned to their envelope; where ticks are missing or hold nothing, the line is broken."""
    slots = np.rint((time - time[:1]) * rig.rate_hz).astype(np.int64)
    total = int(slots.max(initial=-1)) + 1
    count = min(total, _BUCKETS)
    low, high = np.full(count, np.nan), np.full(count, np.nan)
    buckets = slots * count // max(total, 1)
    np.fmin.at(low, buckets, values)
    np.fmax.at(high, buckets, values)
    middle = ((np.arange(count) + 0.5) * total / max(count, 1) - 0.5) / rig.rate_hz
    panel.plot(np.repeat(middle, 2), np.stack((low, high), axis=1).ravel(), color=colour)
    panel.set_ylabel(label)
    panel.set_xlabel("s")
