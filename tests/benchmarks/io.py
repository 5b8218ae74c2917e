"""`make bench ARGS=io`: one tick's I/O (four frames received, one sent) on the local bus, three ways in one run.

ours: drivers.bus.port.Port. python-can: send and recv of its plug-in for the same bus, with its Message objects, as
most people would write it. C: tests/benchmarks/io.c, the system calls of `ours` and nothing else. All three take
everything that has come, so that nothing old is left for the next tick. The frames to receive are sent beforehand,
outside the measured part, so that one side alone is measured; the cost of reading the CPU clock is taken off in all
three.
"""

import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import can
import typer

from drivers.bus.port import Port, open_port
from drivers.config import BusConfig
from drivers.frame import BRS, FD, Frame
from hil.operate.bench.blocks import (
    Block,
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    publish,
    ratios,
    spread,
    values_of,
)
from hil.operate.bench.live_runs import BenchError, bench_bus
from tests.benchmarks.c_programs import build_reference

C_SOURCE = Path(__file__).with_name("io.c")
OURS, PYTHON_CAN, C_PROGRAM = "ours", "python_can", "c"
FD_BRS = FD | BRS
FEEDBACK = [Frame(0x100 + axis, bytes(16), FD_BRS) for axis in range(4)]
MOST_OF_C = 4.0  # times the C program's CPU
LEAST_GAIN = 3.0  # times less than python-can


def io(
    blocks: Annotated[int, typer.Option(min=1)] = 15,
    ticks: Annotated[int, typer.Option(min=100, help="per block and subject")] = 2000,
    as_json_to: JsonTarget = None,
) -> None:
    """One tick's I/O through the bus layer: against python-can and against C, in one run."""
    with bench_bus("bench io"), tempfile.TemporaryDirectory() as build:
        measured = measure(build_reference(C_SOURCE, Path(build)), blocks, ticks)
    result = summarise(measured)
    table = block_table("CPU per tick, 4 frames received and 1 sent, us", measured, ["cpu_us"], digits=2)
    publish(result, [table], as_json_to, _lines(result))


def measure(program: Path, blocks: int, ticks: int) -> list[Block]:
    """All three subjects in turns, on one bus after the other."""

    def in_c() -> Figures:
        done = subprocess.run([str(program), str(ticks)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise BenchError(f"the C program failed: {done.stderr}")
        return {"cpu_us": int(done.stdout.split()[1]) / 1e3}

    cases = [
        Case(OURS, lambda: _run(_our_tick, ticks)),
        Case(PYTHON_CAN, lambda: _run(_python_can_tick, ticks)),
        Case(C_PROGRAM, in_c),
    ]
    return interleave(cases, blocks)


Tick = Callable[[int], int]  # number of the tick -> frames received
Subject = Callable[[BusConfig], tuple[Tick, Callable[[], None]]]


def _our_tick(bus: BusConfig) -> tuple[Tick, Callable[[], None]]:
    port = open_port(bus, role="host", fd=True)

    def tick(number: int) -> int:
        frames = port.drain(time.monotonic_ns())
        port.send(Frame(0x080, number.to_bytes(24, "little"), FD_BRS))
        return len(frames)

    return tick, port.close


def _python_can_tick(bus: BusConfig) -> tuple[Tick, Callable[[], None]]:
    member = can.Bus(interface="local", channel=bus.channel, fd=True)

    def tick(number: int) -> int:
        received = 0
        while member.recv(0) is not None:  # to the end, as Port.drain: what stays behind would be old in the next tick
            received += 1
        member.send(
            can.Message(
                arbitration_id=0x080,
                data=number.to_bytes(24, "little"),
                is_extended_id=False,
                is_fd=True,
                bitrate_switch=True,
            )
        )
        return received

    return tick, member.shutdown


def _run(subject: Subject, ticks: int) -> Figures:
    """Median CPU time of one tick over `ticks`, us."""
    bus = BusConfig(interface="local", channel="bench")
    stage = open_port(bus, role="device", fd=True)
    tick, close = subject(bus)
    try:
        _exchange_handshakes(stage, tick)
        costs = [_one(stage, tick, number) for number in range(ticks)]
    finally:
        close()
        stage.close()
    return {"cpu_us": (median(costs) - _clock_cost()) / 1e3}


def _exchange_handshakes(stage: Port, tick: Tick) -> None:
    for number in range(3):
        stage.drain(time.monotonic_ns())
        tick(number)
    stage.drain(time.monotonic_ns())


def _one(stage: Port, tick: Tick, number: int) -> int:
    for frame in FEEDBACK:
        stage.send(frame)
    start = time.thread_time_ns()
    received = tick(number)
    cost = time.thread_time_ns() - start
    answered = len(stage.drain(time.monotonic_ns()))
    if received != len(FEEDBACK) or answered != 1:
        raise BenchError(f"tick {number}: {received} frames received, {answered} sent: nothing to measure")
    return cost


def _clock_cost() -> float:
    """What reading the CPU clock twice adds to a measurement, ns."""
    costs = []
    for _ in range(1000):
        start = time.thread_time_ns()
        costs.append(time.thread_time_ns() - start)
    return median(costs)


def summarise(blocks: list[Block]) -> dict[str, Any]:
    """Medians, spreads, ratios within each round of blocks, and whether the bars hold."""
    gain = spread(ratios(blocks, PYTHON_CAN, OURS, "cpu_us"))
    over_c = spread(ratios(blocks, OURS, C_PROGRAM, "cpu_us"))
    cases = (OURS, PYTHON_CAN, C_PROGRAM)
    spreads = {case: spread(values_of(blocks, case, "cpu_us")) for case in cases}
    return {
        "cpu_us_per_tick": {case: spreads[case].median for case in cases},
        "spread_us": {case: spreads[case]._asdict() for case in cases},
        "python_can_over_ours": gain._asdict(),
        "ours_over_c": over_c._asdict(),
        "holds": gain.median >= LEAST_GAIN and over_c.median <= MOST_OF_C,
        "blocks": as_json(blocks),
    }


def _lines(result: dict[str, Any]) -> list[str]:
    gain, over_c = result["python_can_over_ours"], result["ours_over_c"]
    return [
        f"python-can / ours: {_shown(gain)}, at least {LEAST_GAIN:g} asked for",
        f"ours / C: {_shown(over_c)}, at most {MOST_OF_C:g} asked for",
        "holds" if result["holds"] else "does NOT hold",
    ]


def _shown(ratio: Figures) -> str:
    return f"{ratio['median']:.2f} ({ratio['min']:.2f} to {ratio['max']:.2f})"
