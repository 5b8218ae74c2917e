"""Is what `hil doctor` says of a machine true? Asked of the machine by other means than the doctor's own.

Only the standard library, so that it runs in the systemd guest, which has nothing of the project but its package.
"""

import json
import os
import resource
import shutil
import subprocess
from pathlib import Path
from typing import Any


def kernel_has_can() -> bool:
    """Whether the kernel lists the CAN family among its protocols (after loading it, where there is a module).

    A machine without modprobe (a container, a minimal Debian) has no modules to load either.
    """
    if shutil.which("modprobe"):
        subprocess.run(["modprobe", "can-raw"], capture_output=True, check=False)
    return any(line.startswith("CAN") for line in Path("/proc/net/protocols").read_text().splitlines())


def can_links() -> dict[str, tuple[bool, int]]:
    """CAN interfaces by `ip`: name -> (up, mtu)."""
    told = subprocess.run(["ip", "-json", "link", "show"], capture_output=True, text=True, check=True).stdout
    return {
        link["ifname"]: ("UP" in link["flags"], link["mtu"]) for link in json.loads(told) if link["link_type"] == "can"
    }


def may_be_fifo() -> bool:
    """Whether chrt(1) gets SCHED_FIFO at the priority the service asks for."""
    return subprocess.run(["chrt", "--fifo", "80", "true"], capture_output=True, check=False).returncode == 0


def _can_untruths(said: dict[str, dict[str, Any]]) -> list[str]:
    if not kernel_has_can():
        return [] if "no SocketCAN" in said.get("CAN", {}).get("detail", "") else ["CAN: this kernel has none"]
    links = can_links()
    if not links:
        return [] if said.get("CAN", {}).get("detail") == "SocketCAN, but no interface" else ["CAN: no interface"]
    wrong = []
    for name, (up, mtu) in links.items():
        finding = said.get(f"CAN {name}", {"level": "absent", "detail": ""})
        expected = "down" if not up else "up, CAN FD" if mtu == 72 else "up, classic CAN only"
        if not finding["detail"].startswith(expected):
            wrong.append(f"CAN {name}: {finding}, by ip it is: {expected}")
    listed = {f"CAN {name}" for name in links}
    return wrong + [f"{topic}: no such interface" for topic in said if topic.startswith("CAN") and topic not in listed]


def untruths(findings: list[dict[str, Any]]) -> list[str]:
    """What of the doctor's findings (`hil doctor --json`) other witnesses contradict; for the calling user."""
    said = {finding["topic"]: finding for finding in findings}
    witnesses = {
        "kernel": "PREEMPT_RT" in os.uname().version,
        "priority": may_be_fifo(),
        "dma_latency": os.access("/dev/cpu_dma_latency", os.W_OK),
        "cyclictest": shutil.which("cyclictest") is not None,
        "strace": shutil.which("strace") is not None,
        "cc": shutil.which("cc") is not None,
    }
    wrong = _can_untruths(said)
    for topic, holds in witnesses.items():
        if (said[topic]["level"] == "ok") is not holds:
            wrong.append(f"{topic}: {said[topic]}, by other means: {holds}")
    if os.uname().release not in said["kernel"]["detail"]:
        wrong.append(f"kernel: {said['kernel']}, uname says {os.uname().release}")
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == 0 and os.geteuid() and said["memory"]["level"] == "ok":
        wrong.append(f"memory: {said['memory']}, the limit is 0")
    cores = len(os.sched_getaffinity(0))
    if not said["cores"]["detail"].startswith("one" if cores < 2 else f"{cores},"):
        wrong.append(f"cores: {said['cores']}, this process may use {cores}")
    return wrong
