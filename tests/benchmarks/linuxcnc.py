"""LinuxCNC's servo thread as a reference: four PIDs at 1 kHz in its real-time process, no bus, no logging.

Debian's linuxcnc-uspace has it. CPU time is the thread's, from the kernel's scheduler statistics, as the mean of a
hundred periods at a time; that of our loop is of single periods. How far a period is from its length at worst is
HAL's own `timedelta`.
"""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hil.operate.bench.blocks import Figures
from hil.operate.bench.live_runs import BenchError, cores

PERIOD_NS = 1_000_000
AXES = 4
THREAD = "rtapi_app:T#0"
CHUNK_S = 0.1
PATIENCE_S = 15.0
_WORST = "timedelta.0.jitter"


def installed() -> bool:
    """Whether this machine has LinuxCNC."""
    return shutil.which("halrun") is not None


def hal_file(seconds: float) -> str:
    """What halrun is to do: the thread with its PIDs for so long, then its worst period."""
    lines = [
        f"loadrt threads name1=servo period1={PERIOD_NS}",
        f"loadrt pid num_chan={AXES}",
        "loadrt timedelta count=1",
    ]
    lines += ["addf timedelta.0 servo", *(f"addf pid.{axis}.do-pid-calcs servo" for axis in range(AXES)), "start"]
    return "\n".join([*lines, f"loadusr -w sleep {seconds:g}", f"getp {_WORST}", ""])


def servo_thread(ticks: int) -> Figures:
    """One block: CPU of a period (us), and how far a period was from 1 ms at most (us). Raises BenchError."""
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as directory:
        script = Path(directory, "servo.hal")
        script.write_text(hal_file(ticks * PERIOD_NS * 1e-9 + 1.0), encoding="ascii")
        environment = os.environ | ({"RTAPI_UID": "65534"} if os.geteuid() == 0 else {})  # it refuses to be root alone
        with _running(["taskset", "-c", str(cores()[1]), "halrun", str(script)], environment) as process:
            spent = _spent(_thread(), ticks)
            said = process.communicate(timeout=ticks * PERIOD_NS * 1e-9 + PATIENCE_S)[0]
    words = [line for line in said.splitlines() if line.strip().lstrip("-").isdigit()]
    if process.returncode or not words:
        raise BenchError(f"halrun failed: {said}")
    p50, p99 = np.percentile(spent, (50, 99)) / 1e3
    return {"p50": float(p50), "p99": float(p99), "worst_period": int(words[-1]) / 1e3}


@contextmanager
def _running(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)  # its real-time process too
            process.wait()


def _thread() -> Path:
    """The scheduler statistics of LinuxCNC's real-time thread, once it runs."""
    limit = time.monotonic() + PATIENCE_S
    while time.monotonic() < limit:
        for comm in Path("/proc").glob("[0-9]*/task/*/comm"):
            try:
                if comm.read_text(encoding="utf-8").strip() == THREAD:
                    return comm.with_name("schedstat")
            except OSError:
                continue
        time.sleep(0.02)
    raise BenchError("LinuxCNC's real-time thread did not start: see `halrun -I`")


def _spent(statistics: Path, ticks: int) -> list[float]:
    """CPU of a period (ns), as means of CHUNK_S, over so many ticks. Each waking is a period."""
    found = []
    before = _taken(statistics)
    for _ in range(max(1, round(ticks * PERIOD_NS * 1e-9 / CHUNK_S))):
        time.sleep(CHUNK_S)
        now = _taken(statistics)
        found.append((now[0] - before[0]) / max(now[1] - before[1], 1))
        before = now
    return found


def _taken(statistics: Path) -> tuple[int, int]:
    """CPU time of a thread, ns, and how many times it slept."""
    spent = int(statistics.read_text(encoding="ascii").split()[0])
    for line in statistics.with_name("status").read_text(encoding="ascii").splitlines():
        if line.startswith("voluntary_ctxt_switches:"):
            return spent, int(line.split()[1])
    return spent, 0
