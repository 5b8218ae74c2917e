"""`hil doctor`: what this machine grants, and what to do about what it does not."""

import ctypes
import json
import os
import shutil
import socket
import sys
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.table import Table

from drivers.base.runtime import RuntimeDirectoryError, read_private, runtime_dir
from drivers.base.text_file import words_of
from hil.cli.console import plain_console
from hil.cli.processes import worker_pool
from hil.live.realtime import Grant, claim
from hil.live.runtime_paths import known_sidecars
from hil.operate.adapters import NET, USB, Plugged, adapter_of, make_interface, plugged, set_up
from hil.operate.machine import machine_facts, python_lacks
from hil.rig.schema import TimingConfig
from sim_plant.native import library

ARPHRD_CAN = "280"  # <linux/if_arp.h>, as /sys/class/net/*/type shows it
BUSY_DEVICE = 1000  # interrupts since the machine started; a device with fewer is idle
RT_TESTS = "install rt-tests (Debian: apt install rt-tests)"


class Finding(NamedTuple):
    """One thing looked at. level: ok, note (could be better), warn (missing). advice: what to do, empty when ok."""

    topic: str
    level: str
    detail: str
    advice: str = ""


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="machine-readable")] = False,
    strict: Annotated[bool, typer.Option(help="exit 1 when something is missing")] = False,
) -> None:
    """Say what this machine grants (CAN, real time, memory lock, DMA latency, cores) and what to do about the rest."""
    findings = examine()
    if as_json:
        sys.stdout.write(
            json.dumps({"findings": [f._asdict() for f in findings], "machine": machine_facts()}, indent=1)
        )
        sys.stdout.write("\n")
    else:
        _print(findings)
    if strict and any(finding.level == "warn" for finding in findings):
        raise typer.Exit(1)


def _print(findings: list[Finding]) -> None:
    console = plain_console()
    table = Table(show_header=False, box=None, pad_edge=False)
    colours = {"ok": "green", "note": "yellow", "warn": "red"}
    for finding in findings:
        table.add_row(finding.topic, f"[{colours[finding.level]}]{finding.level}[/]", finding.detail)
        if finding.advice:
            table.add_row("", "", f"-> {finding.advice}")
    console.print(table)
    console.print(", ".join(f"{key} {value}" for key, value in machine_facts().items() if value != ""), highlight=False)


def examine() -> list[Finding]:
    """All findings; none of them changes anything or needs privileges."""
    return [
        *realtime_findings(),
        *computer_findings(),
        tool_finding("cyclictest", f"`hil bench jitter` compares with it: {RT_TESTS}"),
        tool_finding("strace", "the benchmarks (make bench) count system calls with it: apt install strace"),
        tool_finding("cc", "the compiled build and the benchmarks need it: apt install gcc"),
    ]


def computer_findings() -> list[Finding]:
    """What is the same for every user of this computer; quick, and tried in no child."""
    return [
        *can_findings(),
        *kernel_findings(),
        cores_finding(),
        interrupts_finding(max(os.sched_getaffinity(0))),
        runtime_finding(),
        *access_findings(),
        stage_finding(),
        python_finding(python_lacks()),
    ]


# CAN ------------------------------------------------------------------------------------------------------------------


def can_findings(net: Path = NET, usb: Path = USB) -> list[Finding]:
    """SocketCAN in the kernel, the interfaces there are, and adapters without one. net, usb: where the kernel lists its
    interfaces and USB devices.
    """
    adapters = [_adapter_finding(found) for found in plugged(usb) if not found.interfaces]
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return [
            Finding(
                "CAN",
                "note",
                f"no SocketCAN ({error.strerror}); emulated stages run on the local bus",
                "for a real bus: modprobe can_raw (Debian's kernels have it), and in a service unit AF_CAN must be in "
                "RestrictAddressFamilies",
            ),
            *adapters,
        ]
    interfaces = can_interfaces(net)
    if not interfaces:
        advice = "plug in an adapter, or: ip link add vcan0 type vcan && ip link set vcan0 up"
        return [Finding("CAN", "note", "SocketCAN, but no interface", advice), *adapters]
    return [*(_interface_finding(name, net) for name in interfaces), *adapters]


def _adapter_finding(found: Plugged) -> Finding:
    """One that is plugged in and has no interface yet."""
    name, note = found.adapter.name, found.adapter.note
    said = f"{found.product or name}, no interface" + (f"; {note}" if note else "")
    return Finding(f"adapter {name}", "note", said, make_interface(found))


def can_interfaces(net: Path) -> list[str]:
    """Names of the kernel's CAN interfaces, virtual ones included."""
    try:
        return sorted(entry.name for entry in net.iterdir() if _read(entry / "type") == ARPHRD_CAN)
    except OSError:
        return []


def _interface_finding(name: str, net: Path) -> Finding:
    adapter = adapter_of(name, net)
    served = f", {adapter.name} (driver {adapter.driver})" if adapter else ""
    up = int(_read(net / name / "flags") or "0", 0) & 1
    if not up:
        return Finding(f"CAN {name}", "warn", f"down{served}", set_up(name, adapter))
    queue, mtu = _read(net / name / "tx_queue_len"), _read(net / name / "mtu")
    kind = "CAN FD" if mtu == "72" else "classic CAN only: stage_fd needs `fd on`"
    level = "ok" if mtu == "72" else "note"
    note = f"; {adapter.note}" if adapter and adapter.note else ""
    advice = "" if level == "ok" else f"mtu is {mtu}"
    return Finding(f"CAN {name}", level, f"up, {kind}, transmit queue {queue}{served}{note}", advice)


# Real time ------------------------------------------------------------------------------------------------------------


def realtime_findings() -> list[Finding]:
    """What a control process started by this user would be granted; tried in a child, so that nothing stays here."""
    try:
        with worker_pool(1) as child:
            grants = child.submit(_probe_realtime).result(timeout=30)
    except (BrokenProcessPool, TimeoutError, OSError) as error:
        detail = f"could not be tried: {words_of(error)}"
        return [Finding("real time", "warn", detail, "run `hil doctor` as the service's user")]
    return [Finding(g.name, "ok" if g.granted else "warn", g.detail, g.remedy) for g in grants]


def _probe_realtime() -> tuple[Grant, ...]:
    """Claim real time with the default [timing]; the process that does so keeps it until it ends."""
    return tuple(claim(TimingConfig()).verdict.grants)


def kernel_findings(proc: Path = Path("/proc"), sys_kernel: Path = Path("/sys/kernel")) -> list[Finding]:
    """Preemption model, real-time throttling and clock."""
    release = os.uname().release
    if _read(sys_kernel / "realtime") == "1":
        kernel = Finding("kernel", "ok", f"{release}, PREEMPT_RT")
    else:
        advice = "for bounded latencies on a rig: linux-image-rt-amd64 (Debian)"
        kernel = Finding("kernel", "note", f"{release}, not PREEMPT_RT", advice)
    runtime = _read(proc / "sys/kernel/sched_rt_runtime_us") or "?"
    throttle = Finding("throttling", "ok", f"real-time tasks may use {runtime} us of each second's 1000000")
    if runtime == "0":
        throttle = Finding(
            "throttling", "warn", "no time for real-time tasks", "sysctl kernel.sched_rt_runtime_us=950000"
        )
    clock = machine_facts()["clock"] or "?"
    if clock in ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page"):
        return [kernel, throttle, Finding("clock", "ok", f"{clock}, read without a system call")]
    advice = "reading it is a system call of about a microsecond; see the kernel log for why tsc was rejected"
    return [kernel, throttle, Finding("clock", "note", str(clock), advice)]


def cores_finding() -> Finding:
    """Cores this process may use, and whether one is kept free for the loop."""
    allowed = sorted(os.sched_getaffinity(0))
    isolated = _read(Path("/sys/devices/system/cpu/isolated")) or ""
    if len(allowed) < 2:
        return Finding("cores", "warn", "one: everything shares it with the loop", "give this machine a second core")
    if isolated:
        return Finding("cores", "ok", f"{len(allowed)}, isolated: {isolated}; set timing.cpu to one of these")
    last = allowed[-1]
    advice = (
        f"to keep the loop's core ({last}) free: kernel command line isolcpus={last} nohz_full={last} rcu_nocbs={last}"
    )
    return Finding("cores", "note", f"{len(allowed)}, none isolated", advice)


def interrupts_finding(core: int, proc: Path = Path("/proc")) -> Finding:
    """Devices that interrupt the loop's core (timing.cpu = -1: the last one). Their handlers, and the softirqs behind
    them, run in the middle of ticks, at no priority that SCHED_FIFO could beat.
    """
    found = [
        (number, name, count)
        for number, name, count in _device_interrupts(core, proc)
        if count >= BUSY_DEVICE and _read(proc / "irq" / number / "effective_affinity_list") == str(core)
    ]
    if not found:
        return Finding("interrupts", "ok", f"core {core} serves no busy device")
    shown = ", ".join(f"{name} ({number}: {count} so far)" for number, name, count in found)
    advice = (
        "to move one to another core: echo CORE > /proc/irq/NUMBER/smp_affinity_list (and tell irqbalance, if it runs);"
        f" or kernel command line irqaffinity= without {core}. The CAN adapter's own may stay"
    )
    return Finding("interrupts", "note", f"core {core} serves {shown}", advice)


def _device_interrupts(core: int, proc: Path) -> Iterator[tuple[str, str, int]]:
    """(number, name, how many came to the core since the start) of every device's line in /proc/interrupts."""
    header, *lines = (_read(proc / "interrupts") or "").splitlines() or [""]
    cores = header.split()
    column = cores.index(f"CPU{core}") if f"CPU{core}" in cores else -1
    for line in lines if column >= 0 else ():
        number, _, rest = line.partition(":")
        words = rest.split()
        if number.strip().isdigit() and len(words) > len(cores):  # the others are the processor's own: timer, IPIs
            yield number.strip(), words[-1], int(words[column])


# The rest -------------------------------------------------------------------------------------------------------------


def runtime_finding() -> Finding:
    """Ring and mailbox must lie in memory: a disk's write-back can stop the loop for milliseconds."""
    try:
        path = runtime_dir()
    except RuntimeDirectoryError as error:
        return Finding("runtime directory", "warn", str(error), "set HIL_RUNTIME_DIR to a directory of your own")
    if in_memory(path):
        return Finding("runtime directory", "ok", f"{path}, in memory")
    advice = "its write-back can delay the loop; put it on a tmpfs, for example HIL_RUNTIME_DIR=/dev/shm/hil"
    return Finding("runtime directory", "note", f"{path}, on a disk", advice)


def access_findings() -> list[Finding]:
    """Per sidecar that runs: who can connect to it, and to do what."""
    try:
        sidecars = known_sidecars()
    except RuntimeDirectoryError:  # said above
        return []
    return [access_finding(known.rig, known.directory) for known in sidecars]


def access_finding(rig: str, directory: Path) -> Finding:
    """Of one rig's sidecar."""
    topic = f"access to {rig}"
    try:
        access = json.loads(read_private(directory / "access.json"))
        watch, commands = [str(endpoint) for endpoint in access["watch"]], str(access["commands"])
        owner = directory.stat().st_uid
    except (OSError, ValueError, KeyError, TypeError) as error:
        return Finding(topic, "note", f"not known: {error}", "start its sidecar again")
    watchers = "; ".join(f"{endpoint}: {_watchers(endpoint)}" for endpoint in watch)
    elsewhere = f"operators' certificates at {commands}" if commands else "nobody from elsewhere"
    detail = f"stop and command: uid {owner} and root here, {elsewhere}. Watch, no more: {watchers}"
    if any(_open_to_all(endpoint) for endpoint in watch):
        return Finding(topic, "warn", detail, "listen with tls/ and --credentials beyond this machine: deploy/zenoh")
    return Finding(topic, "ok", detail)


def _watchers(endpoint: str) -> str:
    if endpoint.startswith("tls/"):
        return "certificates of its authority"
    return "everybody who reaches this machine" if _open_to_all(endpoint) else "every account of this machine"


def _open_to_all(endpoint: str) -> bool:
    """Neither TLS nor loopback."""
    protocol, _, address = endpoint.partition("/")
    host = address.rpartition(":")[0].strip("[]")
    return protocol != "tls" and not (host.startswith("127.") or host in ("localhost", "::1"))


class _Statfs(ctypes.Structure):
    _fields_ = (("type", ctypes.c_long), ("rest", ctypes.c_byte * 240))


def in_memory(path: Path) -> bool:
    """Whether `path` lies on a tmpfs or ramfs (statfs(2))."""
    found = _Statfs()
    if ctypes.CDLL(None).statfs(os.fsencode(path), ctypes.byref(found)):
        return False
    return found.type in (0x01021994, 0x858458F6)  # TMPFS_MAGIC, RAMFS_MAGIC of <linux/magic.h>


def stage_finding() -> Finding:
    """What computes the emulated stage."""
    kernel, lacking = library.found()
    if kernel:
        return Finding("emulated stage", "ok", f"computed by its native kernel, {kernel.path}")
    first = "" if library.compiler() else "apt install gcc, then "
    advice = f"{first}{sys.executable} -m sim_plant.native"
    return Finding("emulated stage", "note", f"computed in Python, some ten times slower: {lacking}", advice)


def python_finding(lacks: list[str]) -> Finding:
    """How the interpreter was built. lacks: of hil.operate.machine.python_lacks."""
    if not lacks:
        return Finding("Python", "ok", "an optimized build")
    advice = "Debian's python3 is an optimized build: an interpreted tick takes 1.2 to 1.4 times as long without"
    return Finding("Python", "note", f"{sys.executable}: {', '.join(lacks)}", advice)


def tool_finding(name: str, advice: str, which: Callable[[str], str | None] = shutil.which) -> Finding:
    """A program that only benchmarks need."""
    path = which(name)
    return Finding(name, "ok", path) if path else Finding(name, "note", "not installed", advice)


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return None
