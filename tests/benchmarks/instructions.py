"""`make bench-compiled ARGS=instructions`: what a live tick takes, counted by callgrind. No other work on the machine
changes this figure.

The control process runs in valgrind, beside an emulated stage, slow enough for that. On a busy machine a moving stage
ends in a fault there; `--set task.kind=hold` holds it. Counted are ticks in ACTIVE, the
whole of `ControlLoop._tick` with all it calls. The clocks are slow in there, so that one of them is read once more than
on a processor: 1700 instructions.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import Overrides, RigFile
from hil.cycle.state_machine import State
from hil.operate.bench import live_runs
from hil.operate.bench.blocks import JsonTarget, publish
from hil.rig.control_path import control_path
from hil.rig.file import load_rig

TICK = "CPyDef_loop___ControlLoop____tick"
SLOW = ("rate_hz=250", live_runs.TO_THE_DEADLINE)  # valgrind takes fifty times as long
WARM_UP_TICKS = 100
STARTS_S = 300.0  # on a busy machine; 20 s on a quiet one


def missing() -> str:
    """What keeps a tick from being counted here; empty where nothing does."""
    if control_path() != "compiled":
        return "only the compiled build's ticks can be told apart: make bench-compiled"
    return "" if shutil.which("valgrind") else "needs valgrind (Debian: apt install valgrind)"


def instructions(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    ticks: Annotated[int, typer.Option(min=100, help="counted ticks")] = 500,
    as_json_to: JsonTarget = None,
) -> None:
    """Instructions of a live tick in ACTIVE, by callgrind; --set law.name=NAME for another law."""
    if lacking := missing():
        raise SystemExit(f"bench instructions: {lacking}")
    with live_runs.bench_bus("bench instructions"):
        count, _ = live_runs.undisturbed(lambda: counted(rig, overrides or [], ticks))
    publish({"instructions_per_tick": count}, [], as_json_to, [f"instructions a live tick: {count:.0f}"])


def counted(rig: Path, overrides: Sequence[str], ticks: int) -> float:
    """Mean of at least so many ticks in a row. Raises DisturbedError where the rig left ACTIVE meanwhile."""
    sets = [*SLOW, *overrides]
    config = load_rig(rig, live_runs.local(sets))
    with tempfile.TemporaryDirectory() as folder, live_runs.emulator(rig, sets):
        out = Path(folder, "callgrind")
        process = _start(rig, sets, out)
        try:
            with live_runs._open_ring(process, config, time.monotonic() + STARTS_S):
                _tell(process, "--instr=on")  # without, valgrind starts ten times as fast
            with live_runs._activate(process, config) as reader:
                live_runs._wait_until(process, reader, reader.written + WARM_UP_TICKS)
                _tell(process, "--zero")
                reader.next = first = reader.written
                live_runs._wait_until(process, reader, first + ticks)
                _tell(process, "--dump")
                records = reader.read(reader.slots, ["state", "fault"]).records
                if (records["state"] != State.ACTIVE).any():
                    fault = live_runs.fault_words(int(records["fault"][-1]))
                    raise live_runs.DisturbedError(f"hil run left ACTIVE with fault {fault}")
        finally:
            live_runs._end(process)
        return per_tick(out.with_suffix(".1").read_text(encoding="utf-8"))


def _start(rig: Path, sets: Sequence[str], out: Path) -> "subprocess.Popen[str]":
    collected = (
        f"--callgrind-out-file={out}",
        f"--toggle-collect={TICK}",
        "--collect-atstart=no",
        "--instr-atstart=no",
    )
    given = [part for override in live_runs.local(sets) for part in ("--set", override)]
    return subprocess.Popen(
        ["valgrind", "--tool=callgrind", *collected, sys.executable, "-m", "hil", "run", str(rig), *given],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, "PYTHONHASHSEED": "0"},
    )  # fmt: skip


def _tell(process: "subprocess.Popen[str]", what: str) -> None:
    subprocess.run(["callgrind_control", what, str(process.pid)], check=True, stdout=subprocess.DEVNULL)


def per_tick(profile: str) -> float:
    """Instructions a tick, of a file that callgrind wrote."""
    named = re.search(rf"^c?fn=\((\d+)\) {TICK}$", profile, re.MULTILINE)
    total = re.search(r"^totals: (\d+)$", profile, re.MULTILINE)
    if named is None or total is None:
        raise live_runs.BenchError("callgrind saw no tick")
    calls = re.findall(rf"^cfn=\({named[1]}\).*\ncalls=(\d+) ", profile, re.MULTILINE)
    return int(total[1]) / sum(map(int, calls))
