"""`hil run` and `hil emulate` as processes on a kernel CAN interface, slow enough for software emulation."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.bus.counters import BusState
from hil.cli import app as cli
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import runtime_paths
from hil.operate.stalls import STALL_FAULTS
from hil.rig.file import load_rig
from tests.vm import links

RIGS = Path(__file__).parents[2] / "deploy/rigs"
PATIENCE_S = 240.0
EXPIRY_NS = 60_000_000_000
LAYOUTS = {  # rig file and bus.protocol of every kind of layout
    "stage_fd": ("paper.toml", "stage_fd"),
    "stage_classic": ("paper.toml", "stage_classic"),
    "cia402": ("paper.toml", "cia402"),
    "dbc": ("paper-dbc.toml", "dbc:example_drive.dbc"),
}

# Function, never timing: soft gains at a rate that software emulation holds on a slow host (a tick of both processes
# takes it 10 to 30 ms), and thresholds that forgive a guest that is not let run for a second.
PATIENT = (
    "rate_hz=20",
    "law.gains.kp=[0.4, 0.2]",
    "law.gains.kd=[0.2, 0.1]",
    "task.kind=hold",
    "drives.watchdog_s=1.0",
    "safety.silent_stop_ticks=500",
    "safety.silent_zero_ticks=1000",
    "safety.overrun_zero_s=5.0",
    "safety.overrun_streak=5000",
    "safety.transmit_refused_limit=500",
    "timing.realtime=false",
    "timing.lock_memory=false",
    "timing.dma_latency=false",
    "bus.interface=socketcan",
)

# What a guest that is not let run looks like; over CANopen a drive says of its watchdog that it has a fault.
HELD_UP = {*STALL_FAULTS, Fault.DRIVE_FAULT.name}

# For a longer way between host and stage, where on a busy machine an answer may take longer than a period of 20 Hz.
UNHURRIED = ("rate_hz=10", "law.gains.kp=[0.2, 0.1]", "law.gains.kd=[0.16, 0.08]")


class LiveRig:
    """A running pair. `records()` is everything the control process has recorded so far."""

    def __init__(self, name: str, control: ForkProcess, emulator: ForkProcess) -> None:
        self.name = name
        self.control = control
        self.emulator = emulator
        self._records: list[npt.NDArray[Any]] = []
        self._reader: RingReader | None = None

    def newest(self) -> Any:
        """The newest record, None before the first."""
        assert self.control.is_alive(), f"hil run ended with {self.control.exitcode}"
        assert self.emulator.is_alive(), f"hil emulate ended with {self.emulator.exitcode}"
        if self._reader is None:
            try:
                self._reader = RingReader(runtime_paths(self.name).ring)
            except (RingError, OSError):
                return None
        batch = self._reader.read(100_000).records
        if len(batch):
            self._records.append(batch.copy())
        return self._records[-1][-1] if self._records else None

    def records(self) -> npt.NDArray[Any]:
        """All records read so far, oldest first."""
        self.newest()
        return np.concatenate(self._records)

    def bus_state(self) -> BusState:
        """The bus as the control process's port has seen it last."""
        return BusState(int(self.newest()["port"][-1]))

    def wait_for(self, *states: State) -> State:
        """Until the control process is in one of `states`."""
        deadline = time.monotonic() + PATIENCE_S
        seen: list[str] = []
        while time.monotonic() < deadline:
            record = self.newest()
            if record is not None:
                state = State(int(record["state"]))
                if state in states:
                    return state
                if seen[-1:] != [state.name]:
                    seen.append(state.name)
            time.sleep(0.05)
        raise AssertionError(f"never in {[state.name for state in states]}; seen: {seen}")

    def wait_ticks(self, count: int) -> npt.NDArray[Any]:
        """The next `count` (or more) records."""
        start = len(self.records())
        deadline = time.monotonic() + PATIENCE_S
        while len(self.records()) < start + count:
            assert time.monotonic() < deadline, f"{len(self.records()) - start} ticks instead of {count}"
            time.sleep(0.05)
        return self.records()[start:]

    def order(self, kind: CommandKind) -> None:
        """Post an operator's command."""
        with Mailbox(runtime_paths(self.name).mailbox) as mailbox:
            mailbox.post(kind, time.monotonic_ns() + EXPIRY_NS)

    def to_ready(self) -> None:
        """To READY, by resets where it takes them: the first unlatches the rig, another one what the drives hold."""
        deadline = time.monotonic() + PATIENCE_S
        asked = -1.0
        while self.wait_for(State.READY, State.CONNECTED, State.FAULT) is not State.READY:
            assert time.monotonic() < deadline, f"never READY, but {State(int(self.newest()['state'])).name}"
            if time.monotonic() > asked + 5.0:
                asked = time.monotonic()
                self.order(CommandKind.RESET)
            time.sleep(0.1)

    def activate(self) -> None:
        """READY -> ACTIVE; once more where the guest is held up on the way."""
        for _ in range(10):
            self.to_ready()
            self.order(CommandKind.ACTIVATE)
            if self.wait_for(State.ACTIVE, State.FAULT) is State.ACTIVE:
                return
            fault = held_up(self.newest())
        raise AssertionError(f"never ACTIVE, at last {fault}")

    def active_for(self, count: int) -> npt.NDArray[Any]:
        """`count` (or more) records in ACTIVE, in a row; where a guest that was held up ends them, once more."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            self.activate()
            records = self.wait_ticks(count)
            stopped = records[records["state"] != State.ACTIVE]
            if not len(stopped):
                return records
            fault = held_up(stopped[-1])
            assert time.monotonic() < deadline, f"never ACTIVE for {count} ticks; at last {fault}"

    def stage(self) -> dict[str, Any]:
        """What the emulated drives say of themselves, as of now (they write it twice a second)."""
        path = runtime_paths(self.name).emulator
        asked = time.monotonic_ns()
        found: dict[str, Any] = {}

        def fresh() -> bool:
            with contextlib.suppress(OSError, ValueError):
                found.update(json.loads(path.read_text()))
            return bool(found.get("now_ns", 0) > asked)

        links.eventually(fresh, "the emulator writes its status")
        return found

    def applied_forces(self) -> list[float]:
        """Force that each emulated drive applies now, N."""
        return [axis["applied_force"] for axis in self.stage()["axes"].values()]

    def stop(self) -> int | None:
        """SIGTERM to the control process; its exit status, None if it has none yet."""
        self.control.terminate()
        self.control.join(PATIENCE_S)
        return self.control.exitcode


@contextlib.contextmanager
def hil_process(name: str, rig: Path, overrides: Sequence[str], prefix: Sequence[str] = ()) -> Iterator[ForkProcess]:
    """`hil NAME RIG` as a process of its own, killed at the end of the block if it still runs.

    A fork of this one, which has imported it all: in the guest that alone takes half a minute. How a process starts
    from nothing is tested on the local bus and as a service. prefix: a command to run it under (`ip netns exec X`).
    """
    words = ["hil", name, str(rig), *(part for text in overrides for part in ("--set", text))]
    cli.build_app(name)  # imports it

    def run() -> None:
        if prefix:
            os.execvp(prefix[0], [*prefix, sys.executable, "-m", *words])
        sys.argv = words
        cli.main()

    process = ForkProcess(target=run)
    process.start()
    try:
        yield process
    finally:
        process.kill()
        process.join()


@contextlib.contextmanager
def live_rig(
    channel: str,
    *more: str,
    rig: Path = RIGS / "paper.toml",
    stage_prefix: Sequence[str] = (),
    stage_channel: str | None = None,
) -> Iterator[LiveRig]:
    """Start both processes on `channel`.

    stage_prefix: command before the emulator's (`ip netns exec NAME`). stage_channel: the emulator's, if another.
    """
    overrides = (*PATIENT, f"bus.channel={channel}", *more)
    stage_overrides = (*overrides, f"bus.channel={stage_channel or channel}")
    with (
        hil_process("emulate", rig, stage_overrides, stage_prefix) as emulator,
        hil_process("run", rig, overrides) as control,
    ):
        yield LiveRig(load_rig(rig).name, control, emulator)


def held_up(record: Any) -> str:
    """The fault of a record, which must be one that a guest's host can cause."""
    fault = Fault(int(record["fault"])).name
    assert fault in HELD_UP, fault
    return fault


def assert_closed_loop(rig: LiveRig) -> None:
    """Activate, hold for a while, and see that torque goes out, samples come back and the position is held."""
    active = rig.active_for(50)
    assert (active["n_sent"] > 0).all()
    assert (active["age_ticks"][:, :2] == 0).mean() > 0.5, "most ticks have a fresh sample of every axis"
    assert abs(active["following_error"][-1, :2]).max() < 0.02
    rig.order(CommandKind.STOP)
    rig.wait_for(State.READY)
