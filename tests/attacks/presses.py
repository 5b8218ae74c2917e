"""python -m tests.attacks.presses COUNT: stop pressed at random moments of a live rig, everything around it broken.

Needs root: it makes a network namespace, which it takes down, and a small file system for the runtime directory, which
it fills; at last it deletes that directory. Each press must end with every drive at zero torque within two ticks of the
tick that read it. Prints what it pressed, in which states, how many were missed, and how long the loop took to read
them. Exit status 1 at the first press that did not hold.
"""

import contextlib
import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from drivers.protocols.base import DriveStatus
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_page import Page, live_pages
from tests.support.live_rig import PAPER, Control, Emulator, emulated
from tests.support.paths import ROOT

WITHIN = 2  # ticks
PATIENCE_S = 30.0
TRIPPED_S = 2.0  # who stays in CONNECTED has a drive whose watchdog tripped, as this machine held a process up
_ESTOP_FLAG = 32


class Presser:
    """Presses, checks and brings the rig back; through handles opened at the start, which outlive their files."""

    def __init__(self, emulator: Emulator, reader: RingReader, seed: int) -> None:
        self._emulator = emulator
        self._reader = reader
        self._mailbox = Mailbox(runtime_paths("paper").mailbox)
        self._random = random.Random(seed)
        self.by_state: dict[str, int] = {}
        self.read_after_ms: list[float] = []  # the tick, after the press (hil estop: after its start)

    def _newest(self) -> tuple[State, int]:
        reader = self._reader
        reader.next = max(reader.next, reader.written - 1)
        while not len(records := reader.read(512, ("state", "index")).records):
            time.sleep(0.001)
        return State(int(records[-1]["state"])), int(records[-1]["index"])

    def _await(self, wanted: State, asking: CommandKind) -> None:
        began = time.monotonic()
        limit = began + PATIENCE_S
        while (state := self._newest()[0]) is not wanted:
            assert time.monotonic() < limit, f"{state.name}, not {wanted.name}"
            kind = asking if state is State.READY else CommandKind.RESET
            tripped = state is State.CONNECTED and time.monotonic() - began > TRIPPED_S
            if tripped or state in (State.READY, State.ESTOP, State.FAULT):
                self._mailbox.post(kind, time.monotonic_ns() + 10**9)
                time.sleep(0.5 if tripped else 0.02)

    def once(self, press: Callable[[], int]) -> None:
        """One press at a random moment. press: presses; returns when, monotonic ns."""
        if self._random.random() < 0.8:
            self._await(State.ACTIVE, CommandKind.ACTIVATE)
        else:
            self._mailbox.post(CommandKind.RESET, time.monotonic_ns() + 10**9)
        time.sleep(self._random.random() * 0.02)
        before, _ = self._newest()
        self.by_state[before.name] = self.by_state.get(before.name, 0) + 1
        start = self._reader.written
        pressed_ns = press()
        self.read_after_ms.append((self._check(start) - pressed_ns) * 1e-6)

    def _check(self, start: int) -> int:
        """The press was read by a tick at or after `start`, and what must follow did. Returns when, monotonic ns."""
        limit = time.monotonic() + PATIENCE_S
        reader, place = self._reader, start
        while True:  # the tick that read the press
            reader.next = place
            records = reader.read(512).records
            place += len(records)
            hits = [at for at, record in enumerate(records) if int(record["flags"]) & _ESTOP_FLAG]
            if hits:
                place += hits[0] - len(records)
                break
            assert time.monotonic() < limit, "missed"
            time.sleep(0.001)
        while reader.written <= place + WITHIN:
            time.sleep(0.001)
        reader.next = place
        after = reader.read(WITHIN + 1).records
        assert all(int(record["state"]) == State.ESTOP for record in after), after["state"]
        assert not after["force"].any(), "torque was applied"
        # The drives, as soon as this machine let them hear the last of these ticks' commands.
        stage, sent_ns = self._emulator.stage, int(after[-1]["now_ns"])
        while min(drive.last_command_ns for drive in stage.drives) < sent_ns:
            assert time.monotonic() < limit, "the drives hear nothing"
            time.sleep(0.001)
        assert stage.applied_force == [0.0, 0.0], stage.applied_force
        assert not any(drive.status & DriveStatus.ENABLED for drive in stage.drives), "a drive is enabled"
        return int(after[0]["now_ns"])


def by_page(page: Page) -> int:
    """As somebody who holds the page already."""
    return page.press()


def by_command() -> int:
    """As an operator with no network at all."""
    began = time.monotonic_ns()
    line = ["unshare", "-n", sys.executable, "-m", "hil", "estop", "paper"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert done.returncode == 0, done.stderr
    return began


@contextlib.contextmanager
def sidecar() -> Iterator[subprocess.Popen[bytes]]:
    """As a process, on any free port."""
    line = [sys.executable, "-m", "hil", "sidecar", str(PAPER), "--or-free-port", "--set", "telemetry.record=false"]
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT) as process:
        try:
            yield process
        finally:
            process.kill()


def fill(directory: Path) -> None:
    """Until nothing goes in any more."""
    with (directory / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while file.write(bytes(4096)):
            pass


def pressed(count: int, rig: Path) -> None:
    """rig: a copy that may be deleted. Raises AssertionError at the first press that does not hold."""
    runtime = Path(os.environ["HIL_RUNTIME_DIR"])
    with emulated() as emulator, Control(rig=rig) as control, sidecar() as beside:
        reader = control.wait_for(State.READY)
        (page,) = live_pages("paper")
        presser = Presser(emulator, reader, seed=24)
        breakages: dict[str, Callable[[], object]] = {
            "nothing broken": lambda: None,
            "sidecar stopped": lambda: beside.send_signal(signal.SIGSTOP),
            "sidecar killed": beside.kill,
            "network down": lambda: subprocess.run(["ip", "link", "set", "lo", "down"], check=True),
            "disk full": lambda: fill(runtime),
            "rig file deleted": lambda: _delete(rig, control),
            "runtime directory deleted": lambda: [path.unlink() for path in runtime_paths("paper").directory.iterdir()],
        }
        each = math.ceil(count / len(breakages))
        for name, act in breakages.items():
            act()
            for number in range(each):
                presser.once(by_command if number % 50 == 49 else lambda: by_page(page))
            print(f"{name}: {each} presses, none missed", flush=True)
        states = ", ".join(f"{state} {times}" for state, times in sorted(presser.by_state.items()))
        after = np.percentile(presser.read_after_ms, (50, 99, 100))
        print(f"ran: {len(presser.read_after_ms)} presses, 0 missed; in {states}")
        print("read by the loop after p50 {:.1f}, p99 {:.1f}, at most {:.1f} ms; a tick is 4 ms".format(*after))


def _delete(rig: Path, control: Control) -> None:
    """The rig then refuses ACTIVATE, as it must; its content put back, the next is accepted."""
    content = rig.read_bytes()
    rig.unlink()
    assert by_command()
    rig.write_bytes(content)
    assert control.process.poll() is None


def isolated(count: int, directory: Path) -> subprocess.CompletedProcess[str]:
    """The same in a network namespace and a runtime directory of their own, on a copy of the rig in `directory`."""
    for part in PAPER.parent.iterdir():
        if part.is_file():
            (directory / part.name).write_bytes(part.read_bytes())
    mount = directory / "runtime"
    mount.mkdir()
    script = f'ip link set lo up && mount -t tmpfs -o size=64m,mode=700 none {mount} && exec "$@"'
    line = [sys.executable, "-m", "tests.attacks.presses", str(count), str(directory / PAPER.name)]
    environment = {**os.environ, "HIL_RUNTIME_DIR": str(mount)}
    words = ["unshare", "-m", "-n", "sh", "-c", script, "sh", *line]
    return subprocess.run(words, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=False)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        pressed(int(sys.argv[1]), Path(sys.argv[2]))
    else:
        with tempfile.TemporaryDirectory(prefix="hil-presses-") as made:
            done = isolated(int(sys.argv[1]), Path(made))
        print(done.stdout, end="")
        sys.exit(done.returncode)
