"""`hil bench jitter`: wake lateness of the full control loop against cyclictest, on the same core, in turns.

cyclictest does nothing but sleep and look at the clock, so it shows what kernel and host allow at that moment. Same
core, same SCHED_FIFO priority, same period, memory locked and DMA latency held at 0 in both (cyclictest's defaults).
The loop is woken ahead of its deadline (hil/live/pacing.py) and cyclictest is not; what the loop's own wake-up costs is
seen in the blocks where it sleeps to the deadline as well.

How many of the slots booked as our own are the host's doing is a question for tests/benchmarks/misses.py.
"""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from hil.cli.options import Overrides, ReadRig
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
from hil.operate.bench.live_runs import TO_THE_DEADLINE, BenchError, Run, bench_bus, cores, local, run_control
from hil.operate.doctor import RT_TESTS
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig

SUBJECT, REFERENCE, RECORDED = "hil run", "cyclictest", "hil run + sidecar"
ASLEEP = "hil run, not ahead"
_HISTOGRAM_US = 20_000  # later ones are kept by cyclictest as overflows, and counted here as this much


def jitter(
    rig: ReadRig = Path("microscope-ideal"),
    overrides: Overrides = None,
    blocks: Annotated[int, typer.Option(min=1, help="of each; 20 make a good median")] = 20,
    ticks: Annotated[int, typer.Option(min=100, help="measured ticks per block")] = 3000,
    telemetry: Annotated[bool, typer.Option(help="also with the sidecar publishing and recording")] = True,
    as_json_to: JsonTarget = None,
) -> None:
    """Wake lateness of the full loop, in turns with cyclictest on the same core."""
    program = shutil.which("cyclictest")
    if program is None:
        raise SystemExit(f"hil bench jitter: cyclictest is not installed: {RT_TESTS}")
    sets = overrides or []
    config = load_rig(rig, local(sets))
    runs: list[Run] = []
    cases = [
        Case(SUBJECT, lambda: _control(rig, sets, ticks, runs)),
        Case(REFERENCE, lambda: cyclictest(program, config, ticks)),
        Case(ASLEEP, lambda: _control(rig, [*sets, TO_THE_DEADLINE], ticks, runs)),
    ]
    if telemetry:
        cases.append(Case(RECORDED, lambda: _control(rig, sets, ticks, runs, telemetry=True)))
    with bench_bus("hil bench jitter"):
        measured = interleave(cases, blocks)
    result = _result(measured, runs, telemetry)
    publish(result, [_table(measured)], as_json_to, _lines(result))


def _control(rig: Path, sets: Sequence[str], ticks: int, runs: list[Run], *, telemetry: bool = False) -> Figures:
    run = run_control(rig, sets, ticks, telemetry=telemetry)
    runs.append(run)
    return {**percentiles(run.lateness / 1e3), "own_misses": run.lost[0], "host_misses": run.lost[1]}


def cyclictest(program: str, config: RigConfig, ticks: int) -> Figures:
    """One block of cyclictest; lateness in us."""
    period_us, cpu = config.period_ns // 1000, cores()[1]
    options = ["-q", "-m", "-t1", f"-p{config.timing.priority}", f"-a{cpu}", f"-i{period_us}", f"-l{ticks}"]
    done = subprocess.run([program, *options, f"-h{_HISTOGRAM_US}"], capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchError(f"cyclictest failed: {done.stderr.strip()}")
    return percentiles(lateness_in_histogram(done.stdout))


def lateness_in_histogram(output: str) -> NDArray[np.float64]:
    """Lateness (us) of every cycle, from what `cyclictest -h` prints; its bins are whole microseconds, rounded down."""
    values, overflows = [], 0
    for line in output.splitlines():
        if line.startswith("# Histogram Overflows:"):
            overflows = int(line.rpartition(":")[2])
        elif line and line[0].isdigit():
            microseconds, count = map(int, line.split()[:2])
            values.append(np.full(count, microseconds + 0.5))
    values.append(np.full(overflows, float(_HISTOGRAM_US)))
    return np.concatenate(values)


def _result(blocks: list[Block], runs: list[Run], telemetry: bool) -> dict[str, Any]:
    result: dict[str, Any] = {
        f"ratio_{mark}": spread(ratios(blocks, SUBJECT, REFERENCE, mark)).median for mark in ("p50", "p99")
    }
    asleep = {f"asleep_ratio_{mark}": spread(ratios(blocks, ASLEEP, REFERENCE, mark)).median for mark in ("p50", "p99")}
    result.update(asleep)
    if telemetry:
        p99 = [spread(values_of(blocks, case, "p99")).median for case in (RECORDED, SUBJECT)]
        result["telemetry_ratio_p99"] = p99[0] / p99[1]
    return {
        **result,
        "own_misses": sum(run.lost[0] for run in runs),
        "host_misses": sum(run.lost[1] for run in runs),
        "ticks": sum(len(run.lateness) for run in runs),
        "repeated_blocks": sum(run.repeated for run in runs),
        "realtime": runs[0].timing.verdict,
        "blocks": as_json(blocks),
    }


def _table(blocks: list[Block]) -> Any:
    return block_table("wake lateness, us", blocks, ["p50", "p99", "p999", "max", "own_misses", "host_misses"])


def _lines(result: dict[str, Any]) -> list[str]:
    recorded = result.get("telemetry_ratio_p99")
    return [
        f"hil / cyclictest, median block: p50 {result['ratio_p50']:.2f}, p99 {result['ratio_p99']:.2f}"
        + (f"; p99 with telemetry / without: {recorded:.2f}" if recorded else ""),
        f"asleep to the deadline: p50 {result['asleep_ratio_p50']:.2f}, p99 {result['asleep_ratio_p99']:.2f}",
        f"slots lost of {result['ticks']}: {result['own_misses']} own, {result['host_misses']} the host's; "
        f"blocks spoilt by the host and repeated: {result['repeated_blocks']}",
        str(result["realtime"]),
    ]
