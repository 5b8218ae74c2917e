"""`make bench ARGS=misses`: the slots that a long run loses, in turns with a C program that walks over memory."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from hil.cli.options import Overrides, RigFile
from hil.operate.bench.blocks import (
    Block,
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    percentiles,
    publish,
    values_of,
)
from hil.operate.bench.live_runs import Run, bench_bus, local, run_control
from hil.rig.file import load_rig
from tests.benchmarks.c_programs import build_reference
from tests.benchmarks.walking import C_SOURCE, NAME, walking

SUBJECT = "hil run"
LOST = ("own_misses", "host_misses")


def misses(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    blocks: Annotated[int, typer.Option(min=1)] = 20,
    ticks: Annotated[int, typer.Option(min=100, help="measured ticks per block")] = 50_000,
    as_json_to: JsonTarget = None,
) -> None:
    """Slots that a long run loses, in turns with a C program that touches as much memory; growth, faults, collector."""
    sets = overrides or []
    config = load_rig(rig, local(sets))
    runs: list[Run] = []
    with bench_bus("bench misses"), tempfile.TemporaryDirectory() as build:
        program = build_reference(C_SOURCE, Path(build))
        cases = [
            Case(SUBJECT, lambda: _control(rig, sets, ticks, runs)),
            Case(NAME, lambda: walking(program, config, ticks, _work_ns(runs[-1]))),
        ]
        measured = interleave(cases, blocks)
    result = _result(measured, runs, ticks)
    publish(result, [_table(measured)], as_json_to, _lines(result))


def _control(rig: Path, sets: Sequence[str], ticks: int, runs: list[Run]) -> Figures:
    run = run_control(rig, sets, ticks)
    runs.append(run)
    own, host = run.lost
    tick_us = percentiles(run.stages.sum(axis=1) / 1e3)
    return {**tick_us, "period_p50": run.timing.quantile("cpu", 0.5) / 1e3, "own_misses": own, "host_misses": host}


def _work_ns(run: Run) -> float:
    """What the loop works between two wakes: its ticks."""
    return float(np.median(run.stages.sum(axis=1)))


def _result(blocks: list[Block], runs: list[Run], ticks: int) -> dict[str, Any]:
    def lost(case: str) -> dict[str, int]:
        return {figure: int(sum(values_of(blocks, case, figure))) for figure in LOST}

    return {
        "ticks": ticks * len(runs),
        **lost(SUBJECT),
        "c_walking": lost(NAME),
        "collector_runs": sum(run.timing.counters["collector_runs"] for run in runs),
        "major_faults": sum(run.major_faults for run in runs),
        "rss_bytes": max(run.rss_bytes for run in runs),
        "rss_growth_bytes": max(run.growth_bytes for run in runs),
        "repeated_blocks": sum(run.repeated for run in runs),
        "realtime": runs[0].timing.verdict,
        "blocks": as_json(blocks),
    }


def _table(blocks: list[Block]) -> Any:
    figures = ["p50", "p99", "p999", "max", "period_p50", *LOST]
    return block_table("tick, us (period: CPU with its wait), and slots lost", blocks, figures)


def _lines(result: dict[str, Any]) -> list[str]:
    reference = result["c_walking"]
    return [
        f"slots lost of {result['ticks']}: {result['own_misses']} own, {result['host_misses']} the host's; "
        f"a program that touches as much memory, as often and as long: {reference['own_misses']} and "
        f"{reference['host_misses']}",
        f"collector runs {result['collector_runs']}; major faults {result['major_faults']}; resident "
        f"{result['rss_bytes'] / 1e6:.0f} MB, growth {result['rss_growth_bytes'] / 1e3:.0f} kB",
        f"{result['realtime']}; blocks spoilt by the host and repeated: {result['repeated_blocks']}",
    ]
