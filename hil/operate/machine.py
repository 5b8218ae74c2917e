"""Facts about this machine (processor, kernel, versions), printed beside every figure of time."""

import os
import platform
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np

from hil.rig.control_path import control_path
from sim_plant.native import library


def _first_line(path: str) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8").partition("\n")[0].strip()
    except OSError:
        return None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.machine()


def python_lacks(maps: Path = Path("/proc/self/maps")) -> list[str]:
    """What makes this interpreter slower than it could be, 6 to 9 % each; empty: nothing. maps: of this process."""
    stated = sysconfig.get_config_var("CONFIG_ARGS") or ""
    try:
        is_shared = "/libpython" in maps.read_text(encoding="utf-8", errors="replace")
    except OSError:
        is_shared = False
    found = ["its core is a shared library"] if is_shared else []
    wanted = {"--enable-optimizations": "no profile", "--with-lto": "no link-time optimization"}
    return found + [text for option, text in wanted.items() if option not in stated]


def machine_facts() -> dict[str, Any]:
    """What the figures were measured on; the load tells whether it was a good moment."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "kernel": platform.release(),
        "preempt_rt": _first_line("/sys/kernel/realtime") == "1",
        "clock": _first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "isolated_cores": _first_line("/sys/devices/system/cpu/isolated") or "",
        "python": platform.python_version(),
        "python_build": "; ".join(python_lacks()) or "optimized",
        "numpy": np.__version__,
        "control_path": control_path(),
        "stage": "native" if library.kernel() else "python",
        "load_1min": os.getloadavg()[0],
    }
