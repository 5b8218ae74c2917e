"""`make bench ARGS=ring`: what a record in the ring costs the control process, and how far a reader lags."""

import os
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hil.cycle.record import RECORD_SIZE
from hil.cycle.record_builder import RecordBuilder
from hil.live.pacing import Pacer
from hil.live.ring import RingReader, RingWriter
from hil.operate.bench.blocks import (
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    percentiles,
    publish,
    spread,
    values_of,
)

PERIOD_NS = 1_000_000
SLOTS = 4096
APPEND, READ, COPY = "append, nobody reads", "append, one reader", "copy of as many bytes"


def ring(
    ticks: Annotated[int, typer.Option(min=100, help="per block")] = 3000,
    blocks: Annotated[int, typer.Option(min=1)] = 5,
    poll_ms: Annotated[float, typer.Option(min=0.1, help="how often the reader looks")] = 20.0,
    as_json_to: JsonTarget = None,
) -> None:
    """Cost of an append at 1 kHz (cold caches), with and without a reader, and the reader's lag."""
    with tempfile.TemporaryDirectory(prefix="hil-bench-", dir=_memory()) as directory:
        path = Path(directory) / "ring"
        cases = [
            Case(APPEND, lambda: append_cost(path, ticks)),
            Case(READ, lambda: with_reader(path, ticks, poll_ms)),
            Case(COPY, lambda: copy_cost(ticks)),
        ]
        measured = interleave(cases, blocks)
    medians = {case.name: spread(values_of(measured, case.name, "p50")).median for case in cases}
    lag = {name: spread(values_of(measured, READ, name)).median for name in ("lag_p50_ms", "lag_p99_ms")}
    result = {
        "append_us": medians[APPEND],
        "append_while_read_us": medians[READ],
        "copy_us": medians[COPY],
        **lag,
        "lost": sum(values_of(measured, READ, "lost")),
        "blocks": as_json(measured),
    }
    figures = ["p50", "p99", "max", "lag_p50_ms", "lag_p99_ms", "lost"]
    copies = medians[APPEND] / medians[COPY]
    lines = [
        f"append {medians[APPEND]:.1f} us, {copies:.1f} times the bare copy of {RECORD_SIZE} B; "
        f"while it is read {medians[READ]:.1f} us",
        f"a reader that looks every {poll_ms:g} ms is {lag['lag_p50_ms']:.1f} ms behind (p50)",
    ]
    publish(result, [block_table("ring, us", measured, figures, 2)], as_json_to, lines)


def _memory() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def append_cost(path: Path, ticks: int) -> Figures:
    """A paced writer's cost per append, us."""
    builder = RecordBuilder(4)
    spent = np.zeros(ticks)
    pacer = Pacer(PERIOD_NS)
    with RingWriter(path, SLOTS) as writer:
        pacer.start()
        for index in range(ticks):
            pacer.wait()
            builder.record["index"] = index
            builder.record["now_ns"] = time.monotonic_ns()
            began = time.perf_counter_ns()
            writer.append(builder.record)
            spent[index] = time.perf_counter_ns() - began
    return percentiles(spent / 1e3)


def with_reader(path: Path, ticks: int, poll_ms: float) -> Figures:
    """The same with the writer in a process of its own and this one reading: the age of records when they are read."""
    context = get_context("spawn")
    answer, theirs = context.Pipe(duplex=False)
    path.unlink(missing_ok=True)
    child = context.Process(target=_write, args=(path, ticks, theirs))
    child.start()
    while not path.exists():
        time.sleep(0.01)
    ages, lost = [], 0
    with RingReader(path) as reader:
        while not reader.ended or reader.next < reader.written:
            time.sleep(poll_ms / 1e3)
            batch = reader.read(SLOTS)
            lost += batch.lost
            ages.append(time.monotonic_ns() - batch.records["now_ns"])
    figures: Figures = answer.recv()
    child.join()
    p50, p99 = np.percentile(np.concatenate(ages) / 1e6, (50, 99))
    return {**figures, "lag_p50_ms": float(p50), "lag_p99_ms": float(p99), "lost": float(lost)}


def _write(path: Path, ticks: int, answer: "object") -> None:
    answer.send(append_cost(path, ticks))  # type: ignore[attr-defined]


def copy_cost(ticks: int) -> Figures:
    """A paced copy of as many bytes within this process, us: what cannot be avoided."""
    source, target = memoryview(bytearray(RECORD_SIZE)), memoryview(bytearray(SLOTS * RECORD_SIZE))
    spent = np.zeros(ticks)
    pacer = Pacer(PERIOD_NS)
    pacer.start()
    for index in range(ticks):
        pacer.wait()
        start = index % SLOTS * RECORD_SIZE
        began = time.perf_counter_ns()
        target[start : start + RECORD_SIZE] = source
        spent[index] = time.perf_counter_ns() - began
    return percentiles(spent / 1e3)
