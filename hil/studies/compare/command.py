"""`hil compare`: all laws on the same task in lockstep, over corners, rates and disturbances; `--velocity`: estimators.

Every run is the full path (protocol, wire, drives, plant, cycle) of `hil sim`.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from hil.cli.output import drawable, writable, write_json
from hil.cli.processes import worker_pool
from hil.control.law_registry import LAWS
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.compare.report import comparison_table, draw, summary_table
from hil.virtual.lockstep import usable

LEARNING = "+learning"  # suffix of a law's name: inside iterative learning
CORNERS = {
    "nominal": [],
    "light, slippery": ["plant.mass_scale=0.8", "plant.friction_scale=0.7"],
    "light, sticky": ["plant.mass_scale=0.8", "plant.friction_scale=1.3"],
    "heavy, slippery": ["plant.mass_scale=1.2", "plant.friction_scale=0.7"],
    "heavy, sticky": ["plant.mass_scale=1.2", "plant.friction_scale=1.3"],
}
OFF_GRID = 0.3  # of a period
RIPPLE, RIPPLE_PERIOD = 0.01, 0.05  # of the force limit; m, where the rig file has no ripple of its own
WIDTH, WIDTH_PER_AXIS = 50, 40  # characters of a table that goes to a file


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


def disturbances(rig: RigConfig) -> dict[str, list[str]]:
    """Overrides by name: what a real stage does beside its corners. Reversals off the grid: for figures alone."""
    ripple = [RIPPLE * axis.limits.force for axis in rig.axes.values()]
    own = any(value > 0.0 for value in _listed(rig.plant.ripple_amplitude))
    found = {
        "jitter 50 us": ["wire.jitter=50e-6"],
        "1 % lost": ["wire.drop_probability=0.01"],
        "ripple": [f"plant.ripple_amplitude={ripple}"] + ([] if own else [f"plant.ripple_period={RIPPLE_PERIOD}"]),
        "stribeck": ["plant.stribeck_scale=0.2"],
    }
    if rig.task.kind in ("circle", "lissajous"):
        phase = rig.task.phase - 2.0 * math.pi * rig.task.frequency_hz * OFF_GRID / rig.rate_hz
        found["off grid"] = [f"task.phase={phase!r}"]
    return found


def _listed(value: Any) -> list[float]:
    return list(value) if isinstance(value, list) else [value]


def case_rig(case: Case) -> RigConfig:
    """The rig of a case. Gains found at the rig's own rate are scaled to another by their units (N/m with its square
    and so on), as `hil tune` would begin there.
    """
    rig = load_rig(case.rig, [*case.overrides, *law_overrides(case.law)])
    if case.rate_hz == rig.rate_hz:
        return rig
    from hil.studies.tune.search_space import at_rate

    gains = at_rate(rig, rig.law.name, rig.law.effective_gains(), case.rate_hz)
    law = rig.law.model_copy(update={"gains": gains})
    return rig.model_copy(update={"law": law, "rate_hz": case.rate_hz})


def run_case(case: Case) -> dict[str, Any]:
    """One row: law, corner, rate_hz, axes.<name>.{max_error, rms_error, peak_force, chatter}, state, faults, refused
    (why `hil run` would not start it; empty: it would).
    """
    from hil.control.stability import refuse_unstable
    from hil.virtual.lockstep import simulate

    rig, refused = case_rig(case), []
    try:
        refuse_unstable(rig)
    except RigError as error:
        refused = error.problems
    except ValueError as error:
        raise RigError([f"{case.law}: {error}"]) from None
    try:
        report, _ = simulate(rig, Path(case.rig).parent, case.seconds)
    except ValueError as error:
        raise RigError([f"{case.law}: {error}"]) from None
    return {
        "law": case.law,
        "corner": case.corner,
        "rate_hz": case.rate_hz,
        "axes": report.axes,
        "state": report.state,
        "faults": report.faults,
        "refused": refused,
    }


def cases(
    path: Path, laws: Sequence[str], overrides: Sequence[str], rates: Sequence[float], corners: bool, disturbed: bool,
    seconds: float,
) -> list[Case]:  # fmt: skip
    """Every combination asked for; corners and disturbances at the rig's own rate, other rates nominal."""
    rig = load_rig(path, overrides)
    chosen = dict(CORNERS) if corners else {"nominal": CORNERS["nominal"]}
    if disturbed:
        chosen |= disturbances(rig)
    for rate in rates:
        load_rig(path, [*overrides, f"rate_hz={rate!r}"])
    found = []
    for law in laws:
        usable(load_rig(path, [*overrides, *law_overrides(law)]), path)  # what cannot run is told before anything does
        found += [
            Case(str(path), law, name, rig.rate_hz, [*overrides, *extra], seconds) for name, extra in chosen.items()
        ]
        found += [
            Case(str(path), law, "nominal", rate, list(overrides), seconds) for rate in rates if rate != rig.rate_hz
        ]
    return found


def _numbers(text: str) -> list[float]:
    try:
        rates = [float(rate) for rate in text.split(",") if rate.strip()]
    except ValueError:
        raise RigError([f"--rates {text}: expected numbers (Hz) separated by commas"]) from None
    for rate in rates:
        if not 10.0 <= rate <= 10_000.0:
            raise RigError([f"--rates {text}: {rate:g} Hz is outside 10 to 10000 Hz"])
    return rates


def compare(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="rig file")],
    laws: Annotated[str, typer.Option(help=f"comma-separated; X{LEARNING} is X inside iterative learning")] = "",
    corners: Annotated[bool, typer.Option("--corners", help="five corners of mass and friction")] = False,
    disturbed: Annotated[
        bool, typer.Option("--disturbed/--undisturbed", help="jitter, loss, ripple, Stribeck, reversals off the grid")
    ] = True,
    rates: Annotated[str, typer.Option(help="further rates, Hz, comma-separated; gains scale with them")] = "",
    velocity: Annotated[bool, typer.Option("--velocity", help="velocity estimators instead of laws")] = False,
    seconds: Annotated[float, typer.Option(min=1.0, max=1e6, help="virtual time of each run")] = 20.0,
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a value")] = None,
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    picture: Annotated[
        Path | None, typer.Option(callback=drawable, help="where to draw it [default: runs/RIG-compare.png]")
    ] = None,
    json_target: Annotated[
        str, typer.Option("--json", callback=writable, help="write the rows there; - for standard output")
    ] = "",
) -> None:
    """All control laws (or velocity estimators) on the same task; tables, a picture, and JSON."""
    from rich.console import Console

    changes = list(overrides or ())
    rig = load_rig(rig_file, changes)
    console = Console(stderr=json_target == "-")
    if not console.is_terminal:
        console.width = WIDTH + WIDTH_PER_AXIS * len(rig.axes)
    if velocity:
        from hil.studies.compare.velocity_estimators import compare_velocity, velocity_table

        rows = compare_velocity(usable(rig, rig_file), rig_file.parent, seconds)
        console.print(velocity_table(rig, rows))
    else:
        chosen = [name.strip() for name in laws.split(",") if name.strip()] or list(LAWS)
        work = cases(rig_file, chosen, changes, _numbers(rates), corners, disturbed, seconds)
        rows = run_all(work, workers or os.cpu_count() or 1, console)
        console.print(comparison_table(rig, rows))
        console.print(summary_table(rig, rows))
        target = picture or Path("runs") / f"{rig.name}-compare.png"
        draw(target, rig, rows)
        console.print(f"picture: {target}")
    if json_target:
        write_json({"rows": rows}, json_target)


def run_all(work: Sequence[Case], workers: int, console: Any) -> list[dict[str, Any]]:
    """Rows in the order of the cases, with a progress bar."""
    from rich.progress import track

    note = f"{len(work)} runs"
    if workers == 1 or len(work) == 1:
        return [run_case(case) for case in track(work, note, console=console, transient=True)]
    with worker_pool(workers) as pool:
        return list(track(pool.map(run_case, work), note, total=len(work), console=console, transient=True))
