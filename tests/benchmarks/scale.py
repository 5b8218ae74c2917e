"""`make bench ARGS=scale`: how near to linear a sweep gets faster over this machine's cores, and over a local cluster.

The cluster is dask.distributed: a scheduler and a worker process a core on the loopback interface, as several machines
would be, less their network. Wall-clock times of whole commands, their starts included, by turns.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from hil.cli.options import Overrides, RigFile
from hil.operate.bench.blocks import (
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    publish,
    ratios,
    spread,
)

ONE = "1 process"


def scale(
    rig: RigFile = Path("paper"),
    overrides: Overrides = None,
    plants: Annotated[int, typer.Option(min=1)] = 2000,
    seconds: Annotated[float, typer.Option(min=0.1, help="virtual seconds of each plant")] = 9.0,
    blocks: Annotated[int, typer.Option(min=1)] = 3,
    as_json_to: JsonTarget = None,
) -> None:
    """A sweep on one core, on all cores, and on a local cluster."""
    cores = len(os.sched_getaffinity(0))
    words = [str(rig), "--plants", str(plants), "--seconds", f"{seconds:g}", "--worst", "0"]
    words += [word for override in overrides or [] for word in ("--set", override)]
    with _cluster(cores) as address, tempfile.TemporaryDirectory() as directory:
        ways = {ONE: ["--workers", "1"], f"{cores} processes": ["--workers", str(cores)]}
        if address:
            ways[f"cluster of {cores} workers"] = ["--scheduler", address]
        cases = [Case(name, partial(_sweep, [*words, *way], Path(directory))) for name, way in ways.items()]
        measured = interleave(cases, blocks)
    gains = {case.name: spread(ratios(measured, ONE, case.name, "wall_s")) for case in cases[1:]}
    result = {"cores": cores, "gain": {name: g._asdict() for name, g in gains.items()}, "blocks": as_json(measured)}
    lines = [f"{name}: {gain.median:.2f} times as fast as {ONE}; linear: {cores}" for name, gain in gains.items()]
    if not address:
        lines.append("cluster: not run (pip install 'hil[cluster]')")
    publish(result, [block_table("sweep", measured, ["wall_s"], 2)], as_json_to, lines)


def _sweep(words: list[str], directory: Path) -> Figures:
    """One block: the whole command. Raises subprocess.CalledProcessError."""
    command = [sys.executable, "-m", "hil", "sweep", *words, "--out", str(directory / "worst")]
    began = time.perf_counter()
    subprocess.run(command, cwd=directory, check=True, stdout=subprocess.DEVNULL)
    return {"wall_s": time.perf_counter() - began}


@contextmanager
def _cluster(workers: int) -> Iterator[str]:
    """The address of a scheduler with so many worker processes; empty where the extra is missing."""
    try:
        from distributed import LocalCluster  # type: ignore[attr-defined,unused-ignore]
    except ImportError:
        yield ""
        return
    make: Any = LocalCluster
    with make(
        n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address
