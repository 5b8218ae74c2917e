"""`hil compare`: all laws on the same task in lockstep, over corners, rates and disturbances; `--velocity`: estimators.

Every run is the full path (protocol, wire, drives, plant, cycle) of `hil sim`.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from hil.config import RigError, load_rig
from hil.laws import LAWS

LEARNING = "+learning"  # suffix of a law's name: inside iterative learning
CORNERS = {
    "nominal": [],
    "light, slippery": ["plant.mass_scale=0.8", "plant.friction_scale=0.7"],
    "light, sticky": ["plant.mass_scale=0.8", "plant.friction_scale=1.3"],
    "heavy, slippery": ["plant.mass_scale=1.2", "plant.friction_scale=0.7"],
    "heavy, sticky": ["plant.mass_scale=1.2", "plant.friction_scale=1.3"],
}
OFF_GRID = 0.3  # of a period
DISTURBED = {
    "jitter 50 us": ["wire.jitter=50e-6"],
    "1 % lost": ["wire.drop_probability=0.01"],
    "ripple": ["plant.ripple_amplitude=0.05", "plant.ripple_period=0.05"],
    "stribeck": ["plant.stribeck_scale=0.2"],
    "off grid": [],  # the phase depends on rate and frequency
}


class Case(NamedTuple):
    """One run: rig file, law, name of the corner or disturbance, rate, overrides, virtual seconds."""

    rig: str
    law: str
    corner: str
    rate_hz: float
    overrides: list[str]
    seconds: float


def law_overrides(law: str) -> list[str]:
    """--set values that choose a law; with LEARNING at its end, inside iterative learning."""
    name = law.removesuffix(LEARNING)
    if name not in LAWS:
        raise RigError([f"--laws {law}: the laws are {', '.join(LAWS)}, each also with {LEARNING}"])
    return [f"law.name={name}"] + (["law.iterative_learning=true"] if law.endswith(LEARNING) else [])


def run_case(case: Case) -> dict[str, Any]:
    """One row: law, corner, rate_hz, axes.<name>.{max_error, rms_error, peak_force, chatter}, state, faults."""
    from hil.lockstep import simulate

    path = Path(case.rig)
    rig = load_rig(path, [*case.overrides, *law_overrides(case.law), f"rate_hz={case.rate_hz!r}"])
    try:
        report, _ = simulate(rig, path.parent, case.seconds)
    except ValueError as error:
        raise RigError([f"{case.law}: {error}"]) from None
    return {
        "law": case.law,
        "corner": case.corner,
        "rate_hz": case.rate_hz,
        "axes": report.axes,
        "state": report.state,
        "faults": report.faults,
    }


def cases(
    path: Path, laws: Sequence[str], overrides: Sequence[str], rates: Sequence[float], corners: bool, disturbed: bool,
    seconds: float,
) -> list[Case]:  # fmt: skip
    """Every combination asked for; corners and disturbances at the rig's own rate, other rates nominal."""
    rig = load_rig(path, overrides)
    chosen = dict(CORNERS) if corners else {"nominal": CORNERS["nominal"]}
    if disturbed:
        chosen |= DISTURBED
    found = []
    for law in laws:
        law_overrides(law)  # a wrong name is told before anything runs
        for name, extra in chosen.items():
            changes = [*overrides, *extra]
            if name == "off grid":
                phase = rig.task.phase - 6.283185307179586 * rig.task.frequency_hz * OFF_GRID / rig.rate_hz
                changes.append(f"task.phase={phase!r}")
            found.append(Case(str(path), law, name, rig.rate_hz, changes, seconds))
        found += [
            Case(str(path), law, "nominal", rate, list(overrides), seconds) for rate in rates if rate != rig.rate_hz
        ]
    return found


def compare(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="rig file")],
    laws: Annotated[str, typer.Option(help=f"comma-separated; X{LEARNING} is X inside iterative learning")] = "",
    corners: Annotated[bool, typer.Option("--corners", help="five corners of mass and friction")] = False,
    disturbed: Annotated[bool, typer.Option("--disturbed", help="jitter, loss, ripple, Stribeck, off-grid")] = False,
    rates: Annotated[str, typer.Option(help="further rates, Hz, comma-separated")] = "",
    velocity: Annotated[bool, typer.Option("--velocity", help="velocity estimators instead of laws")] = False,
    seconds: Annotated[float, typer.Option(min=1.0, help="virtual time of each run")] = 20.0,
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a value")] = None,
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    picture: Annotated[Path, typer.Option(help="where to draw it (PNG)")] = Path("runs/compare.png"),
    json_target: Annotated[str, typer.Option("--json", help="write the rows there; - for standard output")] = "",
) -> None:
    """All control laws (or velocity estimators) on the same task; a table, a picture, and JSON."""
    from rich.console import Console

    from hil.sim import write_json

    console = Console(stderr=json_target == "-")
    changes = list(overrides or ())
    if velocity:
        from hil.velocity import compare_velocity, velocity_table

        rows = compare_velocity(load_rig(rig_file, changes), rig_file.parent, seconds)
        console.print(velocity_table(rows))
    else:
        chosen = [name.strip() for name in laws.split(",") if name.strip()] or list(LAWS)
        try:
            further = [float(rate) for rate in rates.split(",") if rate.strip()]
        except ValueError:
            raise RigError([f"--rates {rates}: expected numbers (Hz) separated by commas"]) from None
        work = cases(rig_file, chosen, changes, further, corners, disturbed, seconds)
        rows = run_all(work, workers or os.cpu_count() or 1, console)
        _show(console, rows)
        draw(picture, rows)
        console.print(f"picture: {picture}")
    if json_target:
        write_json({"rows": rows}, json_target)


def run_all(work: Sequence[Case], workers: int, console: Any) -> list[dict[str, Any]]:
    """Rows in the order of the cases, with a progress bar."""
    from rich.progress import track

    if workers == 1 or len(work) == 1:
        return [run_case(case) for case in track(work, console=console, transient=True)]
    with ProcessPoolExecutor(workers) as pool:
        return list(track(pool.map(run_case, work), total=len(work), console=console, transient=True))


def _show(console: Any, rows: Sequence[dict[str, Any]]) -> None:
    from rich.table import Table

    from hil.sim import metres

    table = Table("law", "corner", "rate", "axis", "max error", "RMS error", "peak force", "chatter", "ended")
    for row in rows:
        for axis, figures in row["axes"].items():
            table.add_row(
                row["law"],
                row["corner"],
                f"{row['rate_hz']:g} Hz",
                axis,
                metres(figures["max_error"]),
                metres(figures["rms_error"]),
                f"{figures['peak_force']:.3g}",
                f"{figures['chatter']:.3g}",
                row["state"],
            )
    console.print(table)


def draw(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Largest error of every law; one marker per corner, rate or disturbance, one panel per axis (PNG)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    laws = list(dict.fromkeys(row["law"] for row in rows))
    axes = list(rows[0]["axes"])
    figure, panels = pyplot.subplots(
        1, len(axes), figsize=(5 * len(axes), 1.5 + 0.35 * len(laws)), layout="constrained", sharey=True, squeeze=False
    )
    labels = list(dict.fromkeys(f"{row['corner']}, {row['rate_hz']:g} Hz" for row in rows))
    for panel, axis in zip(panels[0], axes, strict=True):
        for label in labels:
            chosen = [row for row in rows if f"{row['corner']}, {row['rate_hz']:g} Hz" == label]
            errors = [row["axes"][axis]["max_error"] * 1e6 for row in chosen]
            panel.plot(errors, [laws.index(row["law"]) for row in chosen], "o", label=label, alpha=0.7)
        panel.set_xscale("log")
        panel.set_xlabel(f"largest error on {axis}, µm (µrad)")
        panel.grid(alpha=0.3)
    panels[0][0].set_yticks(range(len(laws)), laws)
    panels[0][0].invert_yaxis()
    panels[0][-1].legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
