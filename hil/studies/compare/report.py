"""What `hil compare` shows: every run in one table, one line per law, and a picture. Errors in um (urad)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.base.named_file import save_picture
from hil.rig.schema import RigConfig

Row = dict[str, Any]
FIGURES = {
    "max_error": (1e6, "max"),
    "rms_error": (1e6, "RMS"),
    "peak_force": (1.0, "peak"),
    "chatter": (1.0, "chatter"),
}
MARKERS = "osD^vP*X<>hp"


def case_name(row: Row, rate_hz: float) -> str:
    """Corner or disturbance; for another rate than the rig's own, the rate."""
    name: str = row["corner"]
    return name if row["rate_hz"] == rate_hz else f"{row['rate_hz']:g} Hz"


def _units(rig: RigConfig) -> tuple[str, str]:
    kinds = {axis.kind for axis in rig.axes.values()}
    return "/".join(u for kind, u in (("linear", "µm"), ("rotary", "µrad")) if kind in kinds), "/".join(
        u for kind, u in (("linear", "N"), ("rotary", "N m")) if kind in kinds
    )


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _joined(row: Row, key: str, scale: float) -> str:
    return " / ".join(_number(axis[key] * scale) for axis in row["axes"].values())


def _ended(row: Row) -> str:
    notes = [] if row["state"] == "ACTIVE" else [row["state"]]
    return ", ".join(notes + (["unstable: hil run refuses"] if row["refused"] else []))


def comparison_table(rig: RigConfig, rows: Sequence[Row]) -> Any:
    """Every run; its figures with all axes in one cell."""
    from rich.table import Table

    length, force = _units(rig)
    names = " / ".join(rig.axis_names)
    table = Table(
        title=f"{rig.name}, {rig.rate_hz:g} Hz: {names}; errors {length}, forces {force}", title_justify="left"
    )
    table.add_column("law", no_wrap=True)
    table.add_column("case", no_wrap=True)
    for _, label in FIGURES.values():
        table.add_column(label, no_wrap=True, justify="right")
    table.add_column("ended", no_wrap=True)
    last = ""
    for row in rows:
        if last and row["law"] != last:
            table.add_section()
        figures = (_joined(row, key, scale) for key, (scale, _) in FIGURES.items())
        table.add_row(row["law"] if row["law"] != last else "", case_name(row, rig.rate_hz), *figures, _ended(row))
        last = row["law"]
    return table


def worst_of(rows: Sequence[Row], axis: str) -> Row:
    """The run in which an axis' error grew largest; one without a figure (a fault) counts as the worst."""
    return max(
        rows, key=lambda row: (not math.isfinite(row["axes"][axis]["max_error"]), row["axes"][axis]["max_error"])
    )


def summary_table(rig: RigConfig, rows: Sequence[Row]) -> Any:
    """One line per law: nominal errors, and the worst run at the rig's own rate, per axis."""
    from rich.table import Table

    length, _ = _units(rig)
    table = Table("law", "max", "RMS", title=f"nominal, and the worst run; {length}", title_justify="left")
    for axis in rig.axis_names:
        table.add_column(f"worst on {axis}", no_wrap=True)
    for law in dict.fromkeys(row["law"] for row in rows):
        runs = [row for row in rows if row["law"] == law and row["rate_hz"] == rig.rate_hz]
        nominal = next(row for row in runs if row["corner"] == "nominal")
        cells = [_joined(nominal, key, 1e6) for key in ("max_error", "rms_error")]
        for axis in rig.axis_names:
            worst = worst_of(runs, axis)
            cells.append(f"{_number(worst['axes'][axis]['max_error'] * 1e6)} ({worst['corner']})")
        table.add_row(law, *cells)
    return table


def draw(path: Path, rig: RigConfig, rows: Sequence[Row]) -> None:
    """Largest and RMS error (rows) of every axis (columns), a line per law, a marker per case (PNG)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    laws = list(dict.fromkeys(row["law"] for row in rows))
    labels = list(dict.fromkeys(case_name(row, rig.rate_hz) for row in rows))
    size = (2.6 + 4.2 * len(rig.axes), 1.5 + 2 * (0.6 + 0.42 * len(laws)))
    figure, panels = pyplot.subplots(2, len(rig.axes), figsize=size, layout="constrained", sharey=True, squeeze=False)
    for line, (key, word) in zip(panels, (("max_error", "largest"), ("rms_error", "RMS")), strict=True):
        for panel, (axis, config) in zip(line, rig.axes.items(), strict=True):
            for index, label in enumerate(labels):
                chosen = [row for row in rows if case_name(row, rig.rate_hz) == label]
                errors = [row["axes"][axis][key] * 1e6 for row in chosen]
                style = {"marker": MARKERS[index % len(MARKERS)], "color": f"C{index % 10}", "alpha": 0.75}
                above = 0.7 * (index + 0.5) / len(labels) - 0.35  # side by side, or they hide each other
                heights = [laws.index(row["law"]) + above for row in chosen]
                panel.plot(errors, heights, linestyle="", label=label, markersize=5, **style)
            panel.set_xscale("log")
            panel.set_xlabel(f"{word} error on {axis}, {'µm' if config.kind == 'linear' else 'µrad'}")
            panel.grid(alpha=0.3, axis="x")
            for between in range(1, len(laws)):
                panel.axhline(between - 0.5, color="0.85", linewidth=0.8)
    panels[0][0].set_yticks(range(len(laws)), laws)
    panels[0][0].invert_yaxis()
    handles, names = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside right upper", fontsize=8)
    figure.suptitle(f"{rig.name}, {rig.rate_hz:g} Hz")
    save_picture(figure, path)
    pyplot.close(figure)
