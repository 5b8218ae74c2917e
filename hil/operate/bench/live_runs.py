"""Live processes for benchmarks: an emulated stage on one core, the control process on another, on a private bus."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.cycle.faults.number import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import runtime_paths
from hil.live.timing_record import TimingSnapshot, read_timing
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig

T = TypeVar("T")

PATIENCE_S = 30.0
WARM_UP_TICKS = 500
ATTEMPTS = 5
TO_THE_DEADLINE = "timing.wake_ahead_s=0"  # asleep, as whatever the loop is compared with
PATIENT = (
    "safety.silent_stop_ticks=1000",
    "safety.silent_zero_ticks=2000",
    "safety.overrun_streak=1000",
    "safety.overrun_zero_s=5",
    "safety.flood_frames=1000",
    "drives.watchdog_s=1",
)
_POLL_S = 0.2
# Of a record, and no more: while this process runs, the loop's wake-up of the stage has to interrupt its core.
_COLLECTED = ("state", "fault", "cpu_ns", "now_ns", "scheduled_ns", "missed_own", "missed_host")
_ANSWERS = {
    State.CONNECTED: CommandKind.RESET,
    State.FAULT: CommandKind.RESET,
    State.READY: CommandKind.ACTIVATE,
}


class BenchError(Exception):
    """A benchmark that cannot be run here; the text says why and what to do."""


class DisturbedError(BenchError):
    """The host stalled so badly that the run ended in a fault; to be measured again."""


class Run(NamedTuple):
    """What a control process did while ACTIVE, after its warm-up; arrays by tick, ns.

    stages: (ticks, 5), read to send. lateness: wake against deadline. lost: slots lost to ourselves and to the host.
    timing: its timing file at the end, with the histograms of the measured ticks alone: before, it waited for its
    drives, which costs less. major_faults: of the measured ticks. rss_bytes: resident at the end.
    growth_bytes: of the resident memory over the measured ticks. repeated: attempts that the host spoilt before.
    """

    stages: NDArray[np.int64]
    lateness: NDArray[np.int64]
    lost: tuple[int, int]
    timing: TimingSnapshot
    major_faults: int
    rss_bytes: int
    growth_bytes: int
    system_calls_per_tick: float | None
    repeated: int


def cores() -> tuple[int, int]:
    """(core of everything else, core of the loop): the same on a machine with one, where the loop takes precedence."""
    allowed = sorted(os.sched_getaffinity(0))
    return allowed[0], allowed[-1]


@contextlib.contextmanager
def private_bus() -> Iterator[Path]:
    """A runtime directory of our own, in memory: nobody else's frames, rings or mailboxes."""
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    before = os.environ.get("HIL_RUNTIME_DIR")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # unwinds, so that no process of ours is left behind
    with tempfile.TemporaryDirectory(prefix="hil-bench-", dir=base) as directory:
        os.environ["HIL_RUNTIME_DIR"] = directory
        try:
            yield Path(directory)
        finally:
            os.environ.pop("HIL_RUNTIME_DIR")
            if before is not None:
                os.environ["HIL_RUNTIME_DIR"] = before


@contextlib.contextmanager
def bench_bus(command: str) -> Iterator[None]:
    """A private bus for the length of a benchmark; what keeps it from running ends the program with its reason."""
    try:
        with private_bus():
            yield
    except BenchError as error:
        raise SystemExit(f"{command}: {error}") from None


def local(overrides: Sequence[str]) -> list[str]:
    """The overrides of every live benchmark: the local bus, and no end of the run because the host stalls.

    Lost slots are counted and shown instead; what the kernel refuses is part of the result.
    """
    return [*PATIENT, *overrides, "bus.interface=local", "timing.allow_degraded=true"]


def _start(command: str, rig: Path, overrides: Sequence[str], *more: str, cpu: int) -> subprocess.Popen[str]:
    sets = [part for override in local(overrides) for part in ("--set", override)]
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", command, str(rig), *sets, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if command != "run":
        os.sched_setaffinity(process.pid, {cpu})  # the control process pins itself
    return process


def _end(process: subprocess.Popen[str]) -> str:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
    try:
        return process.communicate(timeout=PATIENCE_S)[0]
    except subprocess.TimeoutExpired:
        process.kill()
        raise BenchError(f"{process.args!r}: did not end on SIGTERM: {process.communicate()[0]}") from None


@contextlib.contextmanager
def emulator(rig: Path, overrides: Sequence[str]) -> Iterator[int]:
    """`hil emulate` on the first core; gives its pid once it is on the bus."""
    process = _start("emulate", rig, overrides, cpu=cores()[0])
    try:
        line = process.stdout.readline() if process.stdout else ""
        if "hil emulate:" not in line:
            raise BenchError(f"the emulated stage did not start: {line}{_end(process)}")
        yield process.pid
    finally:
        _end(process)


@contextlib.contextmanager
def sidecar(rig: Path, overrides: Sequence[str]) -> Iterator[None]:
    """`hil sidecar` on the first core, publishing and recording; its recording is thrown away."""
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as directory:
        private = ("--listen", "tcp/127.0.0.1:0", "--out", directory)
        process = _start("sidecar", rig, overrides, *private, cpu=cores()[0])
        try:
            yield
        finally:
            _end(process)


def undisturbed(measure: Callable[[], T]) -> tuple[T, int]:
    """What `measure` gives, tried again where the host spoils it (DisturbedError); and how often it did. Raises
    BenchError where it always does.
    """
    for attempt in range(ATTEMPTS):
        try:
            return measure(), attempt
        except DisturbedError as error:
            reason = str(error)
    raise BenchError(f"{ATTEMPTS} attempts failed; the last one: {reason}")


def run_control(
    rig_path: Path,
    overrides: Sequence[str],
    ticks: int,
    *,
    cpu_clock: bool = False,
    strace: str | None = None,
    telemetry: bool = False,
) -> Run:
    """Run the control process beside an emulated stage, activate it, measure `ticks` of it, and stop both.

    cpu_clock: stages in CPU time instead of monotonic time. strace: program to count system calls with meanwhile.
    telemetry: with a sidecar beside them. Every attempt has a stage of its own: where the host stalls a running one, it
    may come to rest outside its travel, and no later attempt could move it.
    """

    def attempt() -> Run:
        with emulator(rig_path, overrides), sidecar(rig_path, overrides) if telemetry else contextlib.nullcontext():
            return _attempt(rig_path, overrides, ticks, cpu_clock, strace)

    run, repeated = undisturbed(attempt)
    return run._replace(repeated=repeated)


def _attempt(rig_path: Path, overrides: Sequence[str], ticks: int, cpu_clock: bool, strace: str | None) -> Run:
    rig = load_rig(rig_path, local(overrides))
    process = _start("run", rig_path, overrides, *(["--cpu-clock"] if cpu_clock else []), cpu=cores()[1])
    try:
        reader = _activate(process, rig)
        with reader:
            _wait_until(process, reader, reader.written + WARM_UP_TICKS)
            reader.next = reader.written
            before, rss = _timing(rig), _resident(process.pid)
            calls = _count_calls(strace, process.pid, reader, ticks) if strace else None
            stages, lateness, lost = _collect(process, reader, ticks)
            time.sleep(0.6)  # the counters of the timing file are written a few times a second
            after, rss_end = _timing(rig), _resident(process.pid)
    finally:
        _end(process)
    faults = after.counters["major_faults"] - before.counters["major_faults"]
    measured = replace(after, lifetime=after.lifetime - before.lifetime)
    return Run(stages, lateness, lost, measured, faults, rss_end, rss_end - rss, calls, 0)


def _activate(process: subprocess.Popen[str], rig: RigConfig) -> RingReader:
    """Wait for the ring and for READY, activate, wait for ACTIVE. Reset where the host spoilt the start."""
    limit = time.monotonic() + PATIENCE_S
    reader = _open_ring(process, rig, limit)
    asked, state, fault = time.monotonic(), State.BOOT, 0
    while time.monotonic() < limit and process.poll() is None:
        time.sleep(0.02)
        records = reader.read(reader.slots).records
        if len(records):
            state, fault = State(int(records["state"][-1])), int(records["fault"][-1])
        if state is State.ACTIVE:
            return reader
        command = _ANSWERS.get(state)
        if command is not None and time.monotonic() > asked + 0.3:
            asked = time.monotonic()
            with Mailbox(runtime_paths(rig.name).mailbox) as mailbox:
                mailbox.post(command, time.monotonic_ns() + 1_000_000_000)
    reader.close()
    raise DisturbedError(f"hil run stayed in {state.name}, fault {fault_words(fault)}: {_end(process)}")


def fault_words(number: int) -> str:
    """A fault as a record has it, by name and number."""
    known = number in Fault.__members__.values()
    return f"{Fault(number).name} ({number})" if known else str(number)


def _open_ring(process: subprocess.Popen[str], rig: RigConfig, limit: float) -> RingReader:
    while time.monotonic() < limit and process.poll() is None:
        with contextlib.suppress(RingError):
            reader = RingReader(runtime_paths(rig.name).ring)
            if reader.pid == process.pid:
                return reader
            reader.close()
        time.sleep(0.02)
    raise BenchError(f"hil run did not start: {_end(process)}")


def _wait_until(process: subprocess.Popen[str], reader: RingReader, written: int) -> None:
    limit = time.monotonic() + PATIENCE_S
    while reader.written < written:
        if process.poll() is not None or time.monotonic() > limit:
            raise BenchError(f"hil run stopped ticking: {_end(process)}")
        time.sleep(0.01)


def _collect(
    process: subprocess.Popen[str], reader: RingReader, ticks: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], tuple[int, int]]:
    """Stages and lateness of the next `ticks` records, and the slots lost among them."""
    stages, lateness, count, missed = [], [], 0, []
    while count < ticks:
        if process.poll() is not None:
            raise BenchError(f"hil run ended: {_end(process)}")
        time.sleep(_POLL_S)
        batch = reader.read(reader.slots, _COLLECTED)
        records = batch.records[: ticks - count]
        if batch.lost:
            raise DisturbedError(
                f"{batch.lost} records were overwritten before they were read: this machine is too busy"
            )
        if not len(records):
            continue
        if not (records["state"] == State.ACTIVE).all():
            raise DisturbedError(f"hil run left ACTIVE with fault {fault_words(int(records['fault'][-1]))}")
        count += len(records)
        stages.append(records["cpu_ns"].astype(np.int64))
        lateness.append(records["now_ns"] - records["scheduled_ns"])
        missed.append((int(records["missed_own"][0]), int(records["missed_host"][0])))
        missed.append((int(records["missed_own"][-1]), int(records["missed_host"][-1])))
    lost = (missed[-1][0] - missed[0][0], missed[-1][1] - missed[0][1])
    return np.concatenate(stages), np.concatenate(lateness), lost


def _timing(rig: RigConfig) -> TimingSnapshot:
    return read_timing(runtime_paths(rig.name).timing)


def _resident(pid: int) -> int:
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024
    return 0


def _count_calls(strace: str, pid: int, reader: RingReader, ticks: int) -> float:
    """System calls per tick over about `ticks` ticks, by strace. The process runs slower meanwhile."""
    with tempfile.NamedTemporaryFile("r", suffix=".strace") as summary:
        tracer = subprocess.Popen([strace, "-c", "-o", summary.name, "-p", str(pid)], stderr=subprocess.PIPE, text=True)
        target = reader.written + min(ticks, 2000)
        limit = time.monotonic() + PATIENCE_S
        while reader.written < target and time.monotonic() < limit:
            time.sleep(0.01)
        tracer.send_signal(signal.SIGINT)
        error = tracer.communicate(timeout=PATIENCE_S)[1]
        per_tick = calls_per_tick(Path(summary.name).read_text(encoding="utf-8"))
    reader.next = reader.written
    if per_tick is None:
        raise BenchError(f"strace saw no tick: {error.strip()}")
    return per_tick


def calls_per_tick(summary: str) -> float | None:
    """From the table that `strace -c` prints: all calls over the pacing sleeps, of which each tick has one."""
    calls = {
        fields[-1]: int(fields[3])
        for fields in map(str.split, summary.splitlines())
        if len(fields) >= 5 and fields[3].isdigit()
    }
    sleeps = calls.get("clock_nanosleep", 0)
    return calls["total"] / sleeps if sleeps and "total" in calls else None
