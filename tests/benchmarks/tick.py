"""`make bench ARGS=tick`: what one tick of the live control process costs, against a C program that does the same work.

Both run in turns on the same core, at the same priority, paced at the rig's rate (so that caches are cold), on the same
kind of socket, against the same emulated stage in a process of its own on another core. Both sleep to the deadline. So
does a third program, which touches as much memory for as long as the tick takes (tests/benchmarks/walking.py): its
slowest periods are what the host makes of that.
"""

import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from drivers.bus.local_channel import channel_dir
from hil.cli.options import Overrides, RigFile
from hil.live.timing_record import STAGES
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
    ratios,
    spread,
    values_of,
)
from hil.operate.bench.live_runs import (
    TO_THE_DEADLINE,
    BenchError,
    DisturbedError,
    Run,
    bench_bus,
    cores,
    emulator,
    local,
    run_control,
    undisturbed,
)
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.benchmarks.c_programs import build_reference
from tests.benchmarks.walking import C_SOURCE as WALK_SOURCE
from tests.benchmarks.walking import NAME as WALKER
from tests.benchmarks.walking import walking

C_SOURCE = Path(__file__).with_name("tick.c")
READINGS = np.array([1, 1, 2, 1, 1])  # of the CPU clock in each stage (hil.live.timing_record)
SUBJECT, REFERENCE = "hil run", "C program"


def tick(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    blocks: Annotated[int, typer.Option(min=1)] = 5,
    ticks: Annotated[int, typer.Option(min=100, help="measured ticks per block")] = 5000,
    as_json_to: JsonTarget = None,
) -> None:
    """CPU per tick by stage, system calls, allocations, against a C program doing the same work."""
    sets = overrides or []
    config = load_rig(rig, local(sets))
    if config.bus.protocol != "stage_fd":
        raise typer.BadParameter("the C program speaks stage_fd only")
    with bench_bus("bench tick"), tempfile.TemporaryDirectory() as build:
        programs = [build_reference(source, Path(build)) for source in (C_SOURCE, WALK_SOURCE)]
        measured, runs, calls = _measure(rig, sets, config, programs, blocks, ticks)
    result = _result(measured, runs, calls, allocations_per_tick(config, rig.parent))
    publish(result, [_table(measured)], as_json_to, _lines(result))


def _measure(
    rig: Path, sets: list[str], config: RigConfig, programs: list[Path], blocks: int, ticks: int
) -> tuple[list[Block], list[Run], float | None]:
    program, walker = programs
    runs: list[Run] = []
    taken: list[Figures] = []

    def subject() -> Figures:
        run = run_control(rig, [TO_THE_DEADLINE, *sets], ticks, cpu_clock=True)
        runs.append(run)
        taken.append(_figures(run))
        return taken[-1]

    def reference() -> Figures:
        def attempt() -> Figures:
            with emulator(rig, sets):
                return run_reference(program, config, ticks)

        return undisturbed(attempt)[0]

    def only_walking() -> Figures:
        return walking(walker, config, ticks, taken[-1]["p50"] * 1e3)

    cases = [Case(SUBJECT, subject), Case(REFERENCE, reference), Case(WALKER, only_walking)]
    measured = interleave(cases, blocks)
    strace = shutil.which("strace")
    if strace is None:
        return measured, runs, None
    return measured, runs, run_control(rig, sets, 1000, strace=strace).system_calls_per_tick


def clock_cost_ns() -> float:
    """What two readings of the thread's CPU clock put between themselves: a system call each."""
    readings = np.array([time.thread_time_ns() for _ in range(5000)])
    return float(np.median(np.diff(readings)))


def _figures(run: Run) -> Figures:
    spent = np.maximum(run.stages - clock_cost_ns() * READINGS, 0)  # what measuring itself costs is not the tick's
    tick_us = percentiles(spent.sum(axis=1) / 1e3)
    stages = {f"{name}_p50": float(np.median(spent[:, i])) / 1e3 for i, name in enumerate(STAGES)}
    period_us = run.timing.quantile("cpu", 0.5) / 1e3
    return {**tick_us, **stages, "period_p50": period_us, "own_misses": run.lost[0], "host_misses": run.lost[1]}


def run_reference(program: Path, config: RigConfig, ticks: int) -> Figures:
    """One block of the C program, beside a running emulator. Raises BenchError where it fails, DisturbedError where it
    missed too many answers.
    """
    limit = min(axis.rated_force for axis in config.axes.values()) / 2
    bus, timing = config.bus, config.timing
    arguments = [channel_dir(bus.channel), ticks + 500, config.period_ns, cores()[1], timing.priority, bus.host_id]
    arguments += [bus.feedback_id, len(config.axes), limit]
    done = subprocess.run([str(program), *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchError(f"the C program failed: {done.stderr}")
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=np.int64)[500:]
    answered = float((rows[:, 3] == len(config.axes)).mean())
    if answered < 0.9:
        raise DisturbedError(f"the C program got all answers in only {answered:.0%} of its ticks")
    own = int(((rows[:, 1] - 1) // config.period_ns).sum())  # by the rule for our own: CPU time with its wait
    return {**percentiles(rows[:, 0] / 1e3), "period_p50": float(np.median(rows[:, 1])) / 1e3, "own_misses": own}


def allocations_per_tick(config: RigConfig, base_dir: Path, ticks: int = 2000) -> float:
    """Memory blocks that a tick leaves behind on average, in lockstep; 0: no growth."""
    import gc
    import sys

    from hil.virtual.lockstep import LockstepRun

    run = LockstepRun(config, base_dir)
    for _ in range(2000):
        run.tick()
    gc.collect()
    before = sys.getallocatedblocks()
    for _ in range(ticks):
        run.tick()
    gc.collect()
    return (sys.getallocatedblocks() - before) / ticks


def _result(blocks: list[Block], runs: list[Run], calls: float | None, allocations: float) -> dict[str, Any]:
    def median_of(case: str, *figures: str) -> Figures:
        return {figure: spread(values_of(blocks, case, figure)).median for figure in figures}

    marks = ("p50", "p99", "p999")
    return {
        "cpu_us": median_of(SUBJECT, *marks),
        "c_cpu_us": median_of(REFERENCE, *marks),
        "ratio": {mark: spread(ratios(blocks, SUBJECT, REFERENCE, mark)).median for mark in marks},
        "walking_cpu_us": median_of(WALKER, *marks),
        "walking_ratio": {mark: spread(ratios(blocks, WALKER, REFERENCE, mark)).median for mark in marks},
        "stages_us": {name: median_of(SUBJECT, f"{name}_p50")[f"{name}_p50"] for name in STAGES},
        "period_cpu_us": {"hil": median_of(SUBJECT, "period_p50"), "c": median_of(REFERENCE, "period_p50")},
        "system_calls_per_tick": calls,
        "allocated_blocks_per_tick": allocations,
        "collector_runs": sum(run.timing.counters["collector_runs"] for run in runs),
        "major_faults": sum(run.major_faults for run in runs),
        "own_misses": sum(run.lost[0] for run in runs),
        "host_misses": sum(run.lost[1] for run in runs),
        "c_own_misses": int(sum(values_of(blocks, REFERENCE, "own_misses"))),
        "ticks": sum(len(run.lateness) for run in runs),
        "rss_bytes": max(run.rss_bytes for run in runs),
        "rss_growth_bytes": max(run.growth_bytes for run in runs),
        "repeated_blocks": sum(run.repeated for run in runs),
        "realtime": runs[0].timing.verdict,
        "blocks": as_json(blocks),
    }


def _table(blocks: list[Block]) -> Any:
    figures = ["p50", "p99", "p999", "max", *(f"{name}_p50" for name in STAGES), "period_p50"]
    return block_table("CPU per tick, us (period: with its wait)", blocks, figures)


def _lines(result: dict[str, Any]) -> list[str]:
    calls = result["system_calls_per_tick"]
    shown = f"{calls:.1f}" if calls is not None else "not counted (strace is not installed: apt install strace)"
    ratio, walked = result["ratio"], result["walking_ratio"]
    return [
        f"hil / C: p50 {ratio['p50']:.1f}, p99 {ratio['p99']:.1f}, p99.9 {ratio['p999']:.1f}; "
        f"walking for as long / C: {walked['p50']:.1f}, {walked['p99']:.1f}, {walked['p999']:.1f}",
        f"system calls per tick {shown}; allocated blocks per tick {result['allocated_blocks_per_tick']:.3f}; "
        f"collector runs {result['collector_runs']}; major faults {result['major_faults']}; "
        f"slots lost of {result['ticks']}: {result['own_misses']} own, {result['host_misses']} the host's; the C "
        f"program by the same rule: {result['c_own_misses']} own",
        f"resident {result['rss_bytes'] / 1e6:.0f} MB, growth {result['rss_growth_bytes'] / 1e3:.0f} kB",
        f"{result['realtime']}; blocks spoilt by the host and repeated: {result['repeated_blocks']}",
    ]
