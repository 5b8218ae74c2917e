"""A live control process on the local bus with an emulated stage beside it, slow enough for a busy machine."""

import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from drivers.bus.segmented_port import open_segments
from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import runtime_paths
from hil.operate.stalls import STALL_FAULTS
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from sim_plant.emulator import EmulatedStage
from tests.support.paths import ROOT

PAPER = ROOT / "deploy" / "rigs" / "paper.toml"
PATIENCE_S = 60.0  # only a failing test waits this long
# Heavy and damped: a host that stalls for a tenth of a second under force moves them by less than a millimetre.
HEAVY = (
    "axes.x.model={mass=2.0, coulomb=0.05, viscous=10.0}",
    "axes.y.model={mass=2.0, coulomb=0.05, viscous=10.0}",
    "law.gains.kp=[2000.0, 2000.0]",
    "law.gains.kd=[60.0, 60.0]",
    "axes.x.motion.window=1e-4",  # friction holds them 25 um from their set-points
    "axes.y.motion.window=1e-4",
)
# Soft gains at 250 Hz and patient drives: what is tested here is processes, not punctuality.
CALM = (
    "rate_hz=250",
    "law.gains.kp=[100.0, 50.0]",
    "law.gains.kd=[2.0, 1.0]",
    "task.kind=hold",
    "drives.watchdog_s=0.5",
    "safety.overrun_zero_s=1.0",
    "safety.overrun_streak=1000",
    "safety.silent_stop_ticks=250",
    "safety.silent_zero_ticks=250",
    "safety.flood_frames=1000",
    "safety.transmit_refused_limit=250",
    "timing.realtime=false",
    "telemetry.blackbox_s=16",
)


class Emulator(threading.Thread):
    """The stage on the bus; `stop()` ends it. commands: every frame received, with its arrival (monotonic ns)."""

    def __init__(self, rig: RigConfig) -> None:
        super().__init__(daemon=True)
        rated = [axis.rated_force for axis in rig.axes.values()]
        now = time.monotonic_ns()
        self.stage = EmulatedStage(
            rig.plant, rig.bus, rig.axis_names, rated, PAPER.parent, start_ns=now, drives=rig.drives
        )
        self.commands: list[tuple[int, bytes]] = []
        self._port = open_segments(rig.bus, role="device", fd=True)
        self._ended = threading.Event()

    def run(self) -> None:
        poll = select.poll()
        for member in self._port.members:
            poll.register(member.fileno(), select.POLLIN)
        while not self._ended.is_set():
            poll.poll(2)
            self._turn()
        self._turn()
        self._port.close()

    def _turn(self) -> None:
        while frames := self._port.drain(time.monotonic_ns()):
            for frame in frames:
                self.commands.append((frame.timestamp_ns, frame.data))
                for answer in self.stage.on_frame(frame):
                    self._port.send(answer)
        self.stage.advance(time.monotonic_ns())

    def stop(self) -> None:
        """Hear what was sent until now to its end, then fall silent."""
        self._ended.set()
        self.join()


def rig_with(overrides: Sequence[str] = ()) -> RigConfig:
    return load_rig(PAPER, [*CALM, *overrides])


@contextlib.contextmanager
def emulated(overrides: Sequence[str] = ()) -> Iterator[Emulator]:
    emulator = Emulator(rig_with(overrides))
    emulator.start()
    try:
        yield emulator
    finally:
        emulator.stop()


class Control:
    """A `hil run` process. `wrap`: Python to run before it, in the same process."""

    def __init__(self, *arguments: str, rig: Path = PAPER, wrap: str = "", environment: dict[str, str] | None = None):
        sets = [part for override in CALM for part in ("--set", override)]
        # Whoever runs the tests with nohup has us inherit that SIGHUP is ignored.
        heard = "import signal, sys\nsignal.signal(signal.SIGHUP, signal.SIG_DFL)"
        code = f"{heard}\n{wrap}\nfrom hil.cli.app import main\nmain()"
        self.process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-c", code, "run", str(rig), *sets, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **(environment or {})},
        )

    def __enter__(self) -> "Control":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def finish(self) -> tuple[int, str, str]:
        """Exit status, stdout and stderr."""
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, out, err

    def wait_for(self, state: State, reader: RingReader | None = None) -> RingReader:
        """Until the newest record shows `state`; fails with the process' words if it ends before.

        On the way to READY, what comes of this machine not letting a process run is reset, as an operator would.
        """
        limit = time.monotonic() + PATIENCE_S
        newest = fault = counted = None
        while time.monotonic() < limit:
            if self.process.poll() is not None:
                raise AssertionError(f"hil run ended with {self.finish()}")
            if reader is None:
                reader = self._own_ring()
            if reader is not None and len(batch := reader.read().records):
                last = batch[-1]
                newest, fault = State(int(last["state"])), Fault(int(last["fault"]))
                counted = {name: last[name].tolist() for name in ("age_ticks", "drive_status", "rejects", "port")}
                if newest is state:
                    return reader
                tripped = int(np.bitwise_or.reduce(last["drive_status"])) & DriveStatus.WATCHDOG
                if state is State.READY and (fault.name in STALL_FAULTS or tripped):
                    order(CommandKind.RESET)
            time.sleep(0.005)
        told = f"no {state.name} within {PATIENCE_S} s; last seen {newest!r}, {fault!r}, {counted}"
        self.process.send_signal(signal.SIGABRT)  # with faulthandler: where each of its threads stands
        raise AssertionError(f"{told}; it stands where its words end: {self.finish()}")

    def _own_ring(self) -> RingReader | None:
        """Of this process, and not of one before it on the same rig; None: not yet."""
        try:
            reader = RingReader(runtime_paths("paper").ring)
        except RingError:
            return None
        if reader.pid == self.process.pid:
            return reader
        reader.close()
        return None


def order(kind: CommandKind) -> None:
    """Post an operator's command."""
    with Mailbox(runtime_paths("paper").mailbox) as mailbox:
        mailbox.post(kind, time.monotonic_ns() + 1_000_000_000)


def every_record() -> np.ndarray:
    """All records still in the ring."""
    with RingReader(runtime_paths("paper").ring) as reader:
        return reader.read(100_000).records
