"""python -m tests.attacks.presses COUNT RIG: stop pressed at random moments of a live rig, everything around it broken.

Run in a network namespace of its own, which is taken down, and where HIL_RUNTIME_DIR names a small file system of its
own (test_presses.py sees to both): it is filled, and its directory is deleted at last. Each press must end with every
drive at zero torque within two ticks of the tick that read it. Prints what it did; fails with an AssertionError.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

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
        press()
        self._check(start)

    def _check(self, start: int) -> None:
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


def main(count: int, rig: Path) -> None:
    """rig: a copy that may be deleted."""
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
        for name, act in breakages.items():
            act()
            for number in range(count // len(breakages) + 1):
                presser.once(by_command if number % 50 == 49 else lambda: by_page(page))
            print(f"{name}: {count // len(breakages) + 1} presses, none missed", flush=True)
        print(f"pressed in {presser.by_state}")


def _delete(rig: Path, control: Control) -> None:
    """The rig then refuses ACTIVATE, as it must; its content put back, the next is accepted."""
    content = rig.read_bytes()
    rig.unlink()
    assert by_command()
    rig.write_bytes(content)
    assert control.process.poll() is None


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
