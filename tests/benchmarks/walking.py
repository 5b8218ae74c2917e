"""The C program that walks over memory: what the host makes of a thread that works as often and as long as a tick.

A hypervisor that stops a virtual core does not always say so: the kernel then books the stop as CPU time of whoever
ran, a tick that it hits looks slow, and a slot lost to it counts as our own (hil/live/pacing.py). It comes as often to
a program without system calls, page faults or interpreter (tests/benchmarks/walk.c) that wakes as often, computes as
long and touches as much memory, on the same core, at the same priority: what that program shows is not the tick's own.
"""

import subprocess
from pathlib import Path
from typing import Final

import numpy as np

from hil.live.miss_ledger import own_share
from hil.operate.bench.blocks import Figures, percentiles
from hil.operate.bench.live_runs import BenchError, cores
from hil.rig.schema import RigConfig

C_SOURCE: Final = Path(__file__).with_name("walk.c")
NAME: Final = "C program that walks"


def walking(program: Path, config: RigConfig, periods: int, work_ns: float) -> Figures:
    """One block of it at the rig's rate: CPU time of a period's walk and of the whole period, us, and the slots
    lost, by the loop's rules. work_ns: what the walk is to take in the median. Raises BenchError where it fails.
    """
    timing, period_ns = config.timing, config.period_ns
    arguments = [periods, period_ns, cores()[1], timing.priority, round(work_ns)]
    done = subprocess.run([str(program), *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchError(f"the C program that walks failed: {done.stderr}")
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=np.int64)
    own = sum(own_share(skipped, period_ns, cpu_ns, False) for _, cpu_ns, skipped in rows[rows[:, 2] > 0].tolist())
    return {
        **percentiles(rows[:, 0] / 1e3),
        "period_p50": float(np.median(rows[:, 1])) / 1e3,
        "own_misses": own,
        "host_misses": int(rows[:, 2].sum()) - own,
    }
