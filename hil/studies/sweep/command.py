"""`hil sweep`: thousands of plants under one rig; distributions, and the worst cases as rig files."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from hil.cli.options import JsonTarget, Overrides, ReadRig, Scheduler
from hil.cli.output import metres, print_plant_notes, write_json
from hil.control.law_registry import file_name
from hil.events.baseline import BEYOND
from hil.rig.baseline_file import read_baseline
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import RigConfig
from hil.studies.crew import Crew, crew, resumed
from hil.studies.sweep.plants import (
    Figures,
    Job,
    beyond_baseline,
    collect,
    jobs,
    plot,
    reproduce,
    run_chunk,
    save_worst,
    summary,
    worst_plants,
)
from hil.virtual.sim import usable


def sweep(
    rig_file: ReadRig,
    *,
    plants: Annotated[int, typer.Option(min=1, max=10_000_000, help="stages to draw")] = 1000,
    seconds: Annotated[float, typer.Option(min=0.1, max=1e6, help="virtual time, start-up included")] = 10.0,
    laws: Annotated[str, typer.Option(help="comma-separated names, or 'all'; default: the rig's own")] = "",
    seed: Annotated[int, typer.Option(help="of the plants' parameters")] = 1,
    hard: Annotated[bool, typer.Option(help="also force ripple and Stribeck friction; slower")] = False,
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    scheduler: Scheduler = "",
    overrides: Overrides = None,
    worst: Annotated[int, typer.Option(min=0, max=100, help="worst plants to save and reproduce")] = 2,
    output: Annotated[Path, typer.Option("--out", "-o", help="folder for plots and rig files")] = Path("runs/sweep"),
    json_target: JsonTarget = "",
) -> None:
    """Run thousands of plants with seeded parameters; distributions, and the worst cases as rig files."""
    from hil.cli.console import plain_console

    base = load_rig(rig_file, overrides or ())
    console = plain_console(stderr=json_target == "-")
    print_plant_notes(console, base)
    output.mkdir(parents=True, exist_ok=True)
    names = (
        list(LAWS) if laws == "all" else [name.strip() for name in laws.split(",") if name.strip()] or [base.law.name]
    )
    document: dict[str, Any] = {"rig": base.name, "plants": plants, "seconds": seconds, "seed": seed, "laws": {}}
    with crew(workers, scheduler) as hands:
        for name in names:
            rig = usable(load_rig(rig_file, [*(overrides or ()), f"law.name={name}"]), rig_file)
            work = jobs(rig, rig_file.parent, plants, seconds, seed, hard, hands.size)
            figures, rate = _run(f"{rig.name}: {name}", work, hands)
            plot(output / f"{file_name(name)}.png", rig, figures)
            chosen = worst_plants(figures, worst)
            paths = save_worst(rig_file, rig, seed, hard, chosen, output)
            cases = [_case(path, seconds, n, figures) for path, n in zip(paths, chosen, strict=True)]
            document["laws"][name] = {"axes": summary(rig, figures), "plant_ticks_per_s": rate, "worst": cases}
            if (kept := read_baseline(rig)) is not None:
                document["laws"][name]["baseline"] = {"run": kept["run"], "beyond": beyond_baseline(rig, figures, kept)}
            _show(console, rig, document["laws"][name], output / f"{file_name(name)}.png")
    if json_target:
        write_json(document, json_target)


def _run(title: str, work: Sequence[Job], hands: Crew) -> tuple[Figures, float]:
    """All jobs, telling how far they are: what they found, and plants times ticks per second."""
    from hil.cli.progress import Steps

    plants = sum(job.plants for job in work)
    started = time.perf_counter()
    with Steps(title, plants) as steps:
        figures = collect(resumed(hands, run_chunk, work), steps.advance)
    return figures, plants * work[0].ticks / (time.perf_counter() - started)


def _case(path: Path, seconds: float, number: int, figures: Figures) -> dict[str, Any]:
    error = figures.max_error[number]
    return {
        "rig": str(path),
        "plant": number,
        "max_error": error.tolist(),
        "reproduced": reproduce(path, seconds, error),
    }


def _show(console: Any, rig: RigConfig, found: dict[str, Any], picture: Path) -> None:
    from rich.table import Table

    title = f"{rig.name}, {rig.law.name}: {found['plant_ticks_per_s'] / 1e6:.2f} million plant-ticks/s"
    table = Table("axis", "error", "median", "90 %", "99 %", "worst", title=title, title_justify="left")
    for name, figures in found["axes"].items():
        for key in ("max_error", "rms_error"):
            values = [metres(figures[key][q], rig.axes[name].kind) for q in ("p50", "p90", "p99", "p100")]
            table.add_row(name, key.removesuffix("_error"), *values)
    console.print(table)
    console.print(f"distributions: {picture}")
    if held := found.get("baseline"):
        counts = ", ".join(f"{name} {count}" for name, count in held["beyond"].items())
        limit = f"{BEYOND:g} times the RMS error of the baseline, {held['run']}"
        console.print(f"plants beyond {limit}: {counts}", soft_wrap=True)
    for case in found["worst"]:
        verdict = (
            "reproduced singly, bit for bit" if case["reproduced"] else "NOT reproduced (a fault stops the single run)"
        )
        console.print(f"plant {case['plant']}: {case['rig']}: {verdict}", soft_wrap=True)
