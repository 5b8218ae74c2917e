"""`make bench ARGS="page RIG"`: what an open page costs the loop and this computer, beside a rig that runs here."""

import asyncio
import json
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated

import typer
from websockets.asyncio.client import connect
from websockets.typing import Origin

from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths
from hil.operate.bench.blocks import (
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
from hil.page.access import Role
from tests.support.page_process import PageProcess

NOBODY = "no viewer"
SETTLED_S = 1.0  # after viewers come or go
CHOSEN = '{"ticks": [0, 1]}'  # signals of which each viewer has every tick
_TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


def page(
    rig: Annotated[str, typer.Argument(help="name of a rig that runs here: hil demo")] = "microscope",
    seconds: Annotated[float, typer.Option(min=1, help="per block")] = 10.0,
    blocks: Annotated[int, typer.Option(min=1)] = 5,
    viewers: Annotated[int, typer.Option(min=1, max=30)] = 5,
    as_json_to: JsonTarget = None,
) -> None:
    """The loop's lateness with and without viewers, block by block in turns, and the CPU time of the page's process."""
    watched = f"{viewers} viewers"
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder, PageProcess(Path(folder), rig) as process:
        process.pair(Role.WATCH, "bench")

        def block(count: int) -> Figures:
            with _watching(process, rig, count):
                time.sleep(SETTLED_S)
                return _measured(process.process.pid, rig, seconds)

        measured = interleave([Case(NOBODY, lambda: block(0)), Case(watched, lambda: block(viewers))], blocks)
    ratio = spread(ratios(measured, watched, NOBODY, "p99")).median
    share = {name: spread(values_of(measured, name, "cpu_percent")).median for name in (NOBODY, watched)}
    lines = [
        f"the loop's p99 with {watched}: {ratio:.2f} of that without (bar 1.1)",
        f"the page's process: {share[watched]:.1f} % of a core with {watched} (bar 5), {share[NOBODY]:.1f} % without",
    ]
    result = {"p99_ratio": ratio, "cpu_percent": share, "blocks": as_json(measured)}
    publish(result, [block_table("page, us", measured, ["p50", "p99", "max", "cpu_percent"], 1)], as_json_to, lines)


def _measured(pid: int, rig: str, seconds: float) -> Figures:
    """Lateness of the loop's ticks, us, and the CPU time of a process, % of a core."""
    with RingReader(runtime_paths(rig).ring) as reader:
        reader.next = reader.written
        began, used = time.monotonic(), _cpu_seconds(pid)
        time.sleep(seconds)
        spent = (_cpu_seconds(pid) - used) / (time.monotonic() - began)
        batch = reader.read(reader.slots, ("scheduled_ns", "now_ns"))
    late_us = (batch.records["now_ns"] - batch.records["scheduled_ns"]) / 1e3
    return {**percentiles(late_us), "cpu_percent": 100.0 * spent}


def _cpu_seconds(pid: int) -> float:
    """Of a process so far, user and system (proc(5))."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_A_SECOND


@contextmanager
def _watching(process: PageProcess, rig: str, count: int) -> Iterator[None]:
    """So many open pages, in a process of their own at the lowest priority: elsewhere they would cost nothing here."""
    if not count:
        yield
        return
    context = get_context("spawn")
    there = context.Event()
    child = context.Process(target=_watch, args=(process.port, process.cookie, rig, count, there))
    child.start()
    try:
        if not there.wait(60.0):
            raise TimeoutError("no page came to life")
        yield
    finally:
        child.terminate()
        child.join()


def _watch(port: int, cookie: str, rig: str, count: int, there: Event) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.nice(19)

    async def watch() -> None:
        address, origin = f"ws://localhost:{port}/rigs/{rig}/feed", Origin(f"http://localhost:{port}")
        async with connect(address, origin=origin, additional_headers={"Cookie": cookie}, proxy=None) as feed:
            while not isinstance(text := await feed.recv(), str) or "run" not in json.loads(text):
                pass
            await feed.send(CHOSEN)
            there.set()
            async for _ in feed:
                pass

    async def all_of_them() -> None:
        await asyncio.gather(*(watch() for _ in range(count)))

    asyncio.run(all_of_them())
