"""`make bench ARGS=profile`: where the time of a tick goes, by function (cProfile over a lockstep run, warm caches)."""

import cProfile
import pstats
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hil.cli.options import Overrides, RigFile
from hil.operate.bench.blocks import JsonTarget, publish
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun

WARM_UP_TICKS = 3000


def profile(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    ticks: Annotated[int, typer.Option(min=100)] = 4000,
    rows: Annotated[int, typer.Option(min=1)] = 30,
    save: Annotated[Path | None, typer.Option(help="keep the raw profile, for pstats or snakeviz")] = None,
    as_json_to: JsonTarget = None,
) -> None:
    """Where a tick's time goes. The profiler makes everything about three times slower: read shares, not times."""
    config = load_rig(rig, overrides or [])
    run = LockstepRun(config, rig.parent)
    for _ in range(WARM_UP_TICKS):
        run.tick()
    profiler = cProfile.Profile()
    profiler.enable()
    for _ in range(ticks):
        run.tick()
    profiler.disable()
    stats = pstats.Stats(profiler)
    if save:
        stats.dump_stats(save)
    found = functions(stats, ticks)[:rows]
    publish({"functions": found}, [_table(found, f"{config.name}, {config.law.name}: {ticks} ticks")], as_json_to)


def functions(stats: pstats.Stats, ticks: int) -> list[dict[str, float | str]]:
    """All functions, the dearest first: where, calls per tick, share of own time and share with what it calls."""
    rows: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = stats.stats  # type: ignore[attr-defined]
    total = sum(row[2] for row in rows.values())
    found: list[dict[str, float | str]] = [
        {
            "where": f"{Path(file).name}:{line} {name}" if line else name,
            "calls_per_tick": calls / ticks,
            "own_share": own / total,
            "share": cumulative / total,
        }
        for (file, line, name), (_, calls, own, cumulative, _) in rows.items()
    ]
    return sorted(found, key=lambda row: -float(row["own_share"]))


def _table(found: list[dict[str, float | str]], title: str) -> Table:
    table = Table(title=title)
    table.add_column("function")
    for heading in ("calls/tick", "own %", "with callees %"):
        table.add_column(heading, justify="right")
    for row in found:
        shares = (f"{float(row[key]) * 100:.1f}" for key in ("own_share", "share"))
        table.add_row(str(row["where"]), f"{row['calls_per_tick']:.1f}", *shares)
    return table
