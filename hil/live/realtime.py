"""What the loop thread asks of the kernel, and an honest verdict on what it got.

Each grant is asked for and then read back: under RT_GROUP_SCHED a priority, and in a container a memory lock, can be
refused without an error. Call `claim` in the loop thread after every import: SCHED_FIFO set earlier would run the
imports, and any thread a library starts, above the rest of the system; RESET_ON_FORK keeps children out of it.
"""

import ctypes
import gc
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from hil.rig.schema import TimingConfig

DMA_LATENCY = "/dev/cpu_dma_latency"  # kernel: Documentation/power/pm_qos_interface.rst

# A mapping this large of which hardly anything has ever been touched is somebody's reserve, not a working set.
_POOL_BYTES, _POOL_USE = 4 << 20, 0.05
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK = 29


class Grant(NamedTuple):
    """One thing asked of the kernel. granted: read back, not assumed. remedy: what to do about a refusal, or empty."""

    name: str
    asked: bool
    granted: bool
    detail: str
    remedy: str = ""


class RealtimeVerdict(NamedTuple):
    """All grants. ok: everything [timing] asks for was granted."""

    grants: tuple[Grant, ...]

    @property
    def ok(self) -> bool:
        """True when nothing that was asked for was refused."""
        return all(grant.granted for grant in self.grants if grant.asked)

    @property
    def refused(self) -> tuple[Grant, ...]:
        """What was asked for and refused."""
        return tuple(grant for grant in self.grants if grant.asked and not grant.granted)

    def text(self) -> str:
        """One line for people: everything granted, or what was refused and why."""
        if self.ok:
            return "; ".join(f"{g.name}: {g.detail}" for g in self.grants if g.asked) or "no real time asked for"
        return "real time degraded: " + "; ".join(f"{g.name} refused ({g.detail}; {g.remedy})" for g in self.refused)


@dataclass
class Claim:
    """Grants held by this process. Closing gives the DMA latency back; the rest ends with the process."""

    verdict: RealtimeVerdict
    latency_fd: int = -1
    collector_runs: list[int] = field(default_factory=lambda: [0])  # one number, counted up by a gc callback

    def close(self) -> None:
        """Let the cores sleep deeply again."""
        if self.latency_fd >= 0:
            os.close(self.latency_fd)
            self.latency_fd = -1


def _locked_bytes() -> int:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmLck:"):
            return int(line.split()[1]) * 1024
    return 0


def _pin(cpu: int) -> tuple[bool, str, str]:
    allowed = sorted(os.sched_getaffinity(0))
    core = allowed[-1] if cpu < 0 else cpu
    try:
        os.sched_setaffinity(0, {core})
    except OSError as error:
        cores = ", ".join(map(str, allowed))
        return False, f"core {core}: {error.strerror}", f"set timing.cpu to -1 or one of {cores}"
    return os.sched_getaffinity(0) == {core}, f"core {core}", "the pinning did not hold: a cpuset forbids it"


def _promote(priority: int) -> tuple[bool, str, str]:
    remedy = "run as root, or grant CAP_SYS_NICE or an rtprio limit (systemd: LimitRTPRIO=, AmbientCapabilities=)"
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        return False, f"SCHED_FIFO {priority}: {error.strerror}", remedy
    fifo = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    held = fifo and os.sched_getparam(0).sched_priority == priority
    return (
        held,
        f"SCHED_FIFO {priority}",
        "the kernel took it back: RT_GROUP_SCHED gives this group no real-time budget",
    )


def _mappings() -> Iterator[tuple[int, int]]:
    """(address, length) of what the loop may touch: all but BLAS and its pools, 80 MB the control path never uses."""
    span, used = "", False
    with Path("/proc/self/smaps").open(encoding="utf-8") as lines:  # whole, it would be a mapping of its own
        for line in lines:
            key, *rest = line.split(maxsplit=5)
            if not key.endswith(":"):  # 7f12..-7f13.. r-xp 00000000 fe:00 123 /path
                span = key
                used = not (rest[0].startswith("---") or "blas" in rest[-1] or rest[-1].startswith("[v"))
            elif key == "Rss:" and used:
                low, high = (int(part, 16) for part in span.split("-"))
                if high - low < _POOL_BYTES or int(rest[0]) * 1024 > (high - low) * _POOL_USE:
                    yield low, high - low


def _unlockable(libc: ctypes.CDLL) -> int:
    """Number of mappings that cannot be locked. What has been unmapped meanwhile needs no lock."""

    def refused() -> set[tuple[int, int]]:
        return {mapping for mapping in list(_mappings()) if libc.mlock(*mapping) != 0}

    first = refused()
    return len(first & refused()) if first else 0


def _lock_memory() -> tuple[bool, str, str]:
    """Lock all memory, and bring in now what would else be a page fault in some tick."""
    remedy = "run as root, or grant CAP_IPC_LOCK or a memlock limit (systemd: LimitMEMLOCK=infinity)"
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mlock.argtypes = (ctypes.c_void_p, ctypes.c_size_t)
    # What is mapped already is pinned as it comes in, what is mapped from now on at once.
    if libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT) or libc.mlockall(_MCL_FUTURE):
        return False, f"mlockall: {os.strerror(ctypes.get_errno())}", remedy
    if failed := _unlockable(libc):
        return False, f"mlock of {failed} mappings: {os.strerror(ctypes.get_errno())}", remedy
    locked = _locked_bytes()
    return locked > 0, f"{locked / 1e6:.0f} MB locked", remedy


def _hold_latency(claim: Claim) -> tuple[bool, str, str]:
    remedy = f"run as root, or let the service's group write {DMA_LATENCY} (deploy/systemd has the udev rule)"
    try:
        claim.latency_fd = os.open(DMA_LATENCY, os.O_RDWR | os.O_CLOEXEC)
        os.write(claim.latency_fd, struct.pack("=i", 0))
        held = struct.unpack("=i", os.read(claim.latency_fd, 4))[0]
    except OSError as error:
        return False, f"{DMA_LATENCY}: {error.strerror}", remedy
    return held == 0, f"exit latency held at {held} us", remedy


def _still_collector(claim: Claim) -> tuple[bool, str, str]:
    def count(phase: str, _info: dict[str, int]) -> None:
        if phase == "stop":
            claim.collector_runs[0] += 1

    gc.collect()
    gc.freeze()
    gc.disable()
    gc.callbacks.append(count)  # proves that it stays off: costs nothing until a collection runs
    return not gc.isenabled(), f"off, {gc.get_freeze_count()} objects frozen", ""


def claim(timing: TimingConfig) -> Claim:
    """Ask for everything [timing] names, for the calling thread; read each back. Never raises for a refusal."""
    held = Claim(RealtimeVerdict(()))
    asks: list[tuple[str, bool, Callable[[], tuple[bool, str, str]]]] = [
        ("core", timing.realtime, lambda: _pin(timing.cpu)),
        ("collector", True, lambda: _still_collector(held)),
        ("memory", timing.realtime and timing.lock_memory, _lock_memory),
        ("dma_latency", timing.realtime and timing.dma_latency, lambda: _hold_latency(held)),
        ("priority", timing.realtime, lambda: _promote(timing.priority)),
    ]
    grants = []
    for name, asked, ask in asks:
        if not asked:
            grants.append(Grant(name, False, False, "not asked for"))
            continue
        granted, detail, remedy = ask()
        grants.append(Grant(name, True, granted, detail, "" if granted else remedy))
    if timing.realtime:
        _tighten_timer_slack()
    held.verdict = RealtimeVerdict(tuple(grants))
    return held


def _tighten_timer_slack() -> None:
    # FIFO threads have none; a thread that was refused FIFO would otherwise be woken up to 50 us late on purpose.
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
