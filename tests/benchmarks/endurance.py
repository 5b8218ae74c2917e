"""`make bench ARGS=endurance`: a live rig for minutes or hours: what it does to every process.

Sampled are memory, descriptors, threads, files and the loop's lateness.
Growth is told from the samples after the warm-up: the slope of a straight line through them (least squares).
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from drivers.base.runtime import runtime_dir
from hil.cli.options import Overrides, RigFile
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import DEMO_PREFIX, runtime_paths_in
from hil.operate.bench.blocks import JsonTarget, publish
from hil.rig.file import load_rig

PROCESSES = {"run": "control process", "sidecar": "sidecar", "emulate": "emulated stage"}
WARM_UP = 0.2  # of the samples: imports on first use, caches that fill, the window of a second
_MB, _HOUR = 1e6, 3600.0
Sample = dict[str, float]


def endurance(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    minutes: Annotated[float, typer.Option(min=0.2, help="how long the rig is ACTIVE")] = 15.0,
    every: Annotated[float, typer.Option(min=0.5, help="seconds between samples")] = 5.0,
    as_json_to: JsonTarget = None,
) -> None:
    """What a long live run does to memory, descriptors, files and lateness."""
    result = watched(rig, overrides or [], minutes * 60.0, every)
    publish(result, [_table(result)], as_json_to, _lines(result))


def watched(rig: Path, overrides: list[str], seconds: float, every_s: float) -> dict[str, Any]:
    """`hil demo` for so long, sampled. Raises RuntimeError where it does not end with success."""
    config = load_rig(rig, overrides)
    with tempfile.TemporaryDirectory(prefix="hil-endurance-") as made, (Path(made) / "demo.log").open("w+") as log:
        sets = [word for text in overrides for word in ("--set", text)]
        line = [sys.executable, "-m", "hil", "demo", str(rig), "--seconds", str(seconds), "--out", made, *sets]
        began = time.monotonic()
        with subprocess.Popen(line, stdout=log, stderr=subprocess.STDOUT) as demo:
            directory = runtime_dir() / f"{DEMO_PREFIX}{demo.pid}"
            ring = runtime_paths_in(directory, config.name).ring
            samples: list[Sample] = []
            while demo.poll() is None and time.monotonic() - began < seconds:
                found = {name: dict(process_sample(pid)) for name, pid in _children(demo.pid).items()}
                if len(found) == len(PROCESSES) and (late := _lateness(ring)):
                    flat = {f"{name} {what}": value for name, each in found.items() for what, value in each.items()}
                    files = {"runtime files": _size(directory), "recordings": _size(Path(made))}
                    samples.append({"s": time.monotonic() - began, **flat, **late, **files})
                time.sleep(every_s)
            status = demo.wait()
        if status:
            log.seek(0)
            raise RuntimeError(f"hil demo ended with status {status}: {log.read()[-2000:]}")
        return {**judged(samples), "rig": config.name, "seconds": seconds, "recorded_bytes": _size(Path(made))}


def process_sample(pid: int) -> Iterator[tuple[str, float]]:
    """Resident and private memory (bytes), open descriptors and threads of a process (proc(5)); nothing once it is
    gone.
    """
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
        fields = {line.split(":")[0]: float(line.split()[1]) for line in text.splitlines()[1:]}
        yield "resident", fields["Rss"] * 1024
        yield "private", (fields["Private_Clean"] + fields["Private_Dirty"]) * 1024
        yield "descriptors", len(os.listdir(f"/proc/{pid}/fd"))
        yield "threads", len(os.listdir(f"/proc/{pid}/task"))
    except (OSError, KeyError):
        return


def judged(samples: list[Sample]) -> dict[str, Any]:
    """First, last, largest and slope an hour of every figure, after the warm-up. Raises ValueError for too few."""
    kept = samples[round(len(samples) * WARM_UP) :]
    if len(kept) < 3:
        raise ValueError(f"{len(kept)} samples are too few to tell growth")
    at = np.array([sample["s"] for sample in kept])
    figures = {}
    for name in kept[0]:
        values = np.array([sample[name] for sample in kept])
        slope = float(np.polyfit(at, values, 1)[0]) * _HOUR
        ends = {"first": float(values[0]), "last": float(values[-1]), "most": float(values.max())}
        figures[name] = {**ends, "an_hour": slope}
    return {"figures": figures, "samples": samples}


def _children(parent: int) -> dict[str, int]:
    try:
        pids = Path(f"/proc/{parent}/task/{parent}/children").read_text(encoding="ascii").split()
    except OSError:
        return {}
    found = {}
    for pid in map(int, pids):
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        found |= {name: pid for verb, name in PROCESSES.items() if verb in words}
    return found


def _lateness(ring: Path) -> dict[str, float]:
    """Of the ticks in the ring's last second, us; nothing where there are none."""
    try:
        with RingReader(ring) as reader:
            reader.next = max(0, reader.written - round(1e9 / reader.period_ns))
            records = reader.read(100_000, ("now_ns", "scheduled_ns", "missed_own", "missed_host")).records
    except RingError:
        return {}
    if not len(records):
        return {}
    late = (records["now_ns"] - records["scheduled_ns"]) / 1e3
    missed = {name: float(records[name][-1]) for name in ("missed_own", "missed_host")}
    return {"lateness p50": float(np.median(late)), "lateness p99": float(np.percentile(late, 99)), **missed}


def _size(directory: Path) -> float:
    total = 0
    for path in directory.rglob("*"):
        try:
            total += path.lstat().st_size
        except OSError:  # it went meanwhile
            continue
    return float(total)


def _table(result: dict[str, Any]) -> Table:
    table = Table("after the warm-up", "first", "last", "most", "slope an hour")
    for name, figure in result["figures"].items():
        if name != "s":
            scale, unit = (
                (_MB, " MB") if name.split()[-1] in ("resident", "private", "files", "recordings") else (1, "")
            )
            table.add_row(name, *(f"{figure[key] / scale:.2f}{unit}" for key in ("first", "last", "most", "an_hour")))
    return table


def _lines(result: dict[str, Any]) -> list[str]:
    grown = {name: result["figures"][f"{name} private"]["an_hour"] / _MB for name in PROCESSES.values()}
    told = ", ".join(f"{name} {slope:+.2f}" for name, slope in grown.items())
    return [f"{result['rig']}, {result['seconds'] / 60:g} minutes; private memory, MB an hour: {told}"]
