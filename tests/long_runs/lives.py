"""A live rig whose files are cut, whose processes end and are killed: what is left goes on, and every end is explained.

The harness proves which process it talks to: the ring and the stop page carry the pid of the control process that it
started itself, and a victim is looked for below /proc before it is killed.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import MailboxError
from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_page import Page, live_pages
from hil.operate.stalls import STALL_FAULTS
from tests.support.live_rig import CALM, HEAVY, PAPER, PATIENCE_S, Control, Emulator, emulated, order
from tests.support.ports import free_port

FILES = ("stop", "ring", "mailbox", "goals", "task", "notes")
MOMENTS = ("start", "motion", "reset", "home", "stop")
ENDS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
LATCHED_S = 0.005  # from a press to its latch
AROUND_NS = 5_000_000  # ticks so near a press and its latch tell who held them up
GOES_ON_TICKS = 20
LOST = ("NO_ACK", "BUS_OFF", "TRANSMIT_BLOCKED", "FOLLOWING_ERROR")  # where the stage and its drives are gone
HELD_UP = ("FOLLOWING_ERROR", "OSCILLATION")  # where ticks were lost in motion
HEAVY_CIRCLE = (*HEAVY, "task.kind=circle", "task.radius=2e-3", "task.frequency_hz=0.5")
MOVING = tuple(part for override in HEAVY_CIRCLE for part in ("--set", override))
WATCHDOG, WATCHDOG_NS = "drives.watchdog_s=0.25", 250_000_000
QUICK = "rate_hz=1000"  # where the time to a latch is measured
_UP_S = 2.0  # a victim is killed at any moment of so long a start


class Row(NamedTuple):
    """One try. why: what was not explained, or nothing. latched_s: from a press to its latch, where one was pressed.
    by_host: meanwhile the machine missed ticks, and the control process none.
    """

    name: str
    why: str = ""
    latched_s: float = -1.0
    by_host: bool = False


@contextmanager
def own_runtime() -> Iterator[Path]:
    """A runtime directory that no other rig of this machine has."""
    before = os.environ.get("HIL_RUNTIME_DIR")
    with tempfile.TemporaryDirectory(prefix="hil-long-runs-") as folder:
        os.environ["HIL_RUNTIME_DIR"] = folder
        try:
            yield Path(folder)
        finally:
            if before is None:
                del os.environ["HIL_RUNTIME_DIR"]
            else:
                os.environ["HIL_RUNTIME_DIR"] = before


def page_of(control: Control) -> Page:
    """The stop page that this control process holds, and no other one."""
    (page,) = live_pages("paper")
    assert page.status().pid == control.process.pid, "another control process has the rig"
    return page


def to_active(control: Control, reader: RingReader) -> None:
    """As an operator who resets and activates until the rig is ACTIVE."""
    wanted = {State.READY: CommandKind.ACTIVATE, State.ESTOP: CommandKind.RESET, State.FAULT: CommandKind.RESET}
    limit = time.monotonic() + PATIENCE_S
    while True:
        records = reader.read(100_000).records
        state = State(int(records[-1]["state"])) if len(records) else State.CONNECTED
        if state is State.ACTIVE:
            return
        assert control.process.poll() is None, control.finish()
        assert time.monotonic() < limit, f"not ACTIVE, but {state.name} within {PATIENCE_S:g} s"
        if state in wanted:
            with suppress(MailboxError):  # it was cut, and is mended in a moment
                order(wanted[state])
        time.sleep(0.05)


def goes_on(control: Control, reader: RingReader) -> str:
    """Why the control process does not tick on, or nothing."""
    begun, limit = reader.written, time.monotonic() + PATIENCE_S
    while reader.written < begun + GOES_ON_TICKS:
        if control.process.poll() is not None:
            return f"the control process ended with {control.process.returncode}"
        if time.monotonic() > limit:
            return f"no {GOES_ON_TICKS} ticks within {PATIENCE_S:g} s"
        time.sleep(0.002)
    page = page_of(control)
    page.close()
    return ""


def cut(tries: int, seed: int, names: tuple[str, ...] = FILES) -> Iterator[Row]:
    """Each runtime file cut short, removed or replaced while the rig is ACTIVE; then stop is pressed."""
    draw = random.Random(seed)
    with own_runtime(), emulated((*HEAVY, QUICK)) as emulator, Control(*MOVING, "--set", QUICK) as control:
        reader = control.wait_for(State.READY)
        folder = runtime_paths("paper").directory
        journal = _drained(control)
        for name in names:
            for _ in range(tries):
                try:
                    to_active(control, reader)
                except AssertionError as error:
                    yield Row(f"{name}, afterwards", f"{error}\n{''.join(journal[-12:])}")
                    return
                page = page_of(control)  # opened before: whoever presses may have it open
                how = _damage(folder / name, draw)
                why = goes_on(control, reader) if page else "no stop page"
                pressed_ns = page.press()
                status = page.await_latch(pressed_ns, 1.0)
                latched_s = (status.latched_at - pressed_ns) * 1e-9
                page.close()
                if status.latched_state != State.ESTOP.name or latched_s < 0.0:
                    why = why or f"a press was not latched: {status.latched_state!r}"
                _wait_zero(emulator)
                yield Row(f"{name} {how}", why, latched_s, by_host(reader, pressed_ns, status.latched_at))


def by_host(reader: RingReader, pressed_ns: int, latched_ns: int) -> bool:
    """Whether ticks were missed between a press and its latch, all of them by the machine."""
    records = reader.read(100_000, ("now_ns", "missed_own", "missed_host")).records
    near = records[(records["now_ns"] >= pressed_ns - AROUND_NS) & (records["now_ns"] <= latched_ns + AROUND_NS)]
    own, host = (int(near[name].max() - near[name].min()) if len(near) else 0 for name in ("missed_own", "missed_host"))
    return host > 0 and not own


def _drained(control: Control) -> list[str]:
    """The lines of its journal, read as they come: a pipe that is full would hold its writer up."""
    lines: list[str] = []
    stream = control.process.stderr
    assert stream is not None
    threading.Thread(target=lambda: lines.extend(stream), daemon=True).start()
    return lines


def _damage(path: Path, draw: random.Random) -> str:
    if not path.exists():
        path.write_bytes(b"")
        return "made"
    os.truncate(path, draw.randrange(path.stat().st_size + 1))
    return "cut short"


def _wait_zero(emulator: Emulator) -> None:
    limit = time.monotonic() + PATIENCE_S
    while any(emulator.stage.applied_force):
        assert time.monotonic() < limit, f"the drives still apply {emulator.stage.applied_force}"
        time.sleep(0.002)


def cycles(count: int, seed: int) -> Iterator[Row]:
    """A control process started and ended so often, READY or ACTIVE; each end is status 0, the drives at zero."""
    draw = random.Random(seed)
    with own_runtime(), emulated(HEAVY) as emulator:
        for number in range(count):
            with Control(*MOVING) as control, control.wait_for(State.READY) as reader:
                if draw.random() < 0.5:
                    to_active(control, reader)
                page_of(control).close()
                how = ENDS[number % len(ENDS)]
                control.process.send_signal(how)
                status, _, err = control.finish()
            _wait_zero(emulator)
            why = "" if status == 0 else f"status {status}: {err[-300:]}"
            yield Row(f"{number}: {how.name}", why or ("a traceback" if "Traceback" in err else ""))


def kills_of_control(count: int, seed: int) -> Iterator[Row]:
    """Killed at random moments: the drives are at zero by their own watchdogs, which latch."""
    draw = random.Random(seed)
    with own_runtime(), emulated((*HEAVY, WATCHDOG)) as emulator:
        for number in range(count):
            moment = MOMENTS[number % len(MOMENTS)]
            with Control(*MOVING, "--set", WATCHDOG) as control:
                if moment == "start":
                    time.sleep(draw.uniform(0.0, _UP_S))
                else:
                    with control.wait_for(State.READY) as reader:
                        _moment(control, reader, moment, draw)
                control.process.kill()
                status = control.process.wait(PATIENCE_S)
            _wait_zero(emulator)
            yield Row(f"control, {moment}", "" if status == -signal.SIGKILL else f"it had ended with {status}")
        trips = [trip for drive in emulator.stage.drives for trip in drive.trips]
        late = sum(trip.expired_ns - trip.command_ns != WATCHDOG_NS for trip in trips)
        yield Row("control, watchdogs", "" if not late else f"{late} of {len(trips)} watchdogs late")


def kills_beside(victim: str, count: int, seed: int) -> Iterator[Row]:
    """Another process of the rig killed at random moments: the control process goes on; of an emulator its loss is
    told by name.
    """
    draw = random.Random(seed)
    with own_runtime() as folder, _no_stage() if victim == "emulator" else emulated(HEAVY):
        for number in range(count):
            moment = MOMENTS[number % len(MOMENTS)]
            with (
                _started(victim, folder) as beside,
                Control(*MOVING) as control,
                control.wait_for(State.READY) as reader,
            ):
                if moment == "start" and beside is not None and victim != "emulator":
                    time.sleep(draw.uniform(0.0, _UP_S))
                else:
                    _moment(control, reader, moment, draw)
                pid = _child_of(control.process.pid, "teller") if beside is None else beside.pid
                assert Path(f"/proc/{pid}/cmdline").read_bytes(), "the victim had ended by itself"
                os.kill(pid, signal.SIGKILL)
                why = goes_on(control, reader) or _told(control, reader, lost=victim == "emulator")
                control.process.send_signal(signal.SIGTERM)
                status, _, err = control.finish()
            ended = "" if status == 0 and "Traceback" not in err else f"status {status}: {err[-300:]}"
            yield Row(f"{victim}, {moment}", why or ended)


def _moment(control: Control, reader: RingReader, moment: str, draw: random.Random) -> None:
    """Bring a READY rig there, and wait a little."""
    if moment in ("motion", "stop"):
        to_active(control, reader)
    if moment == "stop":
        order(CommandKind.STOP)
    elif moment in ("reset", "home"):
        order(CommandKind.RESET if moment == "reset" else CommandKind.HOME)
    time.sleep(draw.uniform(0.0, 0.3))


def _told(control: Control, reader: RingReader, *, lost: bool) -> str:
    """Why the state afterwards is not explained, or nothing."""
    limit = time.monotonic() + (PATIENCE_S if lost else 0.0)
    while True:
        records = reader.read(100_000).records
        faults = {Fault(int(value)).name for value in records["fault"]} - {Fault.NONE.name}
        held_up = len(records) > 1 and int(np.diff(records["index"]).max()) > 1  # and the stage went on without us
        if not faults <= {*STALL_FAULTS, *(HELD_UP if held_up else ()), *(LOST if lost else ())}:
            return f"faults {sorted(faults)}"
        if not lost or faults or (len(records) and int(records[-1]["state"]) == State.CONNECTED):
            return ""
        if time.monotonic() > limit:
            return "the loss of the stage was not told"
        time.sleep(0.01)


@contextmanager
def _no_stage() -> Iterator[None]:
    yield


@contextmanager
def _started(victim: str, folder: Path) -> Iterator["subprocess.Popen[bytes] | None"]:
    """The process beside, None for a child of the control process."""
    sets = [part for override in (*CALM, *HEAVY) for part in ("--set", override)]
    words: dict[str, Callable[[], list[str]]] = {
        "sidecar": lambda: ["sidecar", str(PAPER), *sets, "--out", str(folder / "out"), "--or-free-port"],
        "emulator": lambda: ["emulate", str(PAPER), *sets],
        "page": lambda: ["page", "--port", str(free_port())],
    }
    if victim not in words:
        yield None
        return
    line = [sys.executable, "-m", "hil", *words[victim]()]
    status = runtime_paths("paper").emulator
    status.unlink(missing_ok=True)
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            limit = time.monotonic() + PATIENCE_S
            while victim == "emulator" and not status.exists():  # it answers from here on
                assert time.monotonic() < limit, "no emulated stage"
                time.sleep(0.01)
            yield process
        finally:
            process.kill()


def _child_of(parent: int, word: str) -> int:
    """The pid of its child with that word in its command line."""
    limit = time.monotonic() + PATIENCE_S
    while time.monotonic() < limit:
        for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            if word in Path(f"/proc/{child}/cmdline").read_bytes().decode():
                return int(child)
        time.sleep(0.01)
    raise AssertionError(f"{parent} has no {word}")


def _to_the_end(rows: Iterator[Row]) -> Iterator[Row]:
    """The rows, and what ended them too early."""
    try:
        yield from rows
    except AssertionError as error:
        yield Row("the rest was not tried", str(error)[-3000:])


def told(rows: Iterator[Row]) -> bool:
    """Print each try, the latches and the counts; whether all was explained."""
    found = []
    for row in _to_the_end(rows):
        found.append(row)
        print(f"UNEXPLAINED {row.name}: {row.why}" if row.why else f"explained: {row.name}", flush=True)
    latched = sorted(row.latched_s for row in found if row.latched_s >= 0.0)
    print(f"{len(found)} tries, {sum(not row.why for row in found)} explained", flush=True)
    if latched:
        middle, most = latched[len(latched) // 2] * 1e3, latched[-1] * 1e3
        late = [row for row in found if row.latched_s > LATCHED_S]
        held_up = sum(row.by_host for row in late)
        print(
            f"stop latched within {middle:.2f} ms (median), {most:.2f} ms (worst); {len(late)} beyond 5 ms, "
            f"{held_up} of them while this machine missed ticks",
            flush=True,
        )
    return not any(row.why for row in found)
