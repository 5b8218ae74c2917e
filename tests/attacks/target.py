"""The rig under attack: emulated stage, control process and sidecar as real processes; what must hold throughout."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.ring import RingReader
from hil.live.stop_page import live_pages
from hil.telemetry.client import RigClient
from hil.telemetry.command_client import CommandClient, NoGatewayError, Verdict, local_client
from tests.support.certificates import certificates
from tests.support.live_rig import CALM, HEAVY, PAPER
from tests.support.paths import ROOT

NAME = "paper"
PATIENCE_S = 20.0
# Goals accelerate by so little, m/s^2, that a host that stalls meanwhile moves no axis by more than some millimetres.
SLOW = (*HEAVY, "axes.x.motion.acceleration=0.05", "axes.y.motion.acceleration=0.05")
STOP_S = 0.5  # from press to latch, on a machine that does much else


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Target:
    """directory: of its own; HIL_RUNTIME_DIR points into it while this exists."""

    def __init__(self, directory: Path) -> None:
        self.base = directory
        self.runtime = directory / "runtime"
        self.runtime.mkdir(mode=0o700)
        os.environ["HIL_RUNTIME_DIR"] = str(self.runtime)
        self.directory = self.runtime / NAME
        self.made = certificates(directory / "certificates")
        self.rig = directory / "paper.toml"
        for part in PAPER.parent.iterdir():
            if part.is_file():
                (directory / part.name).write_bytes(part.read_bytes())
        self.zenoh_port, self.tls_port, self.command_port = free_port(), free_port(), free_port()
        self.endpoint, self.tls = f"tcp/127.0.0.1:{self.zenoh_port}", f"tls/127.0.0.1:{self.tls_port}"
        self.routed = f"tls/127.0.0.1:{free_port()}"
        self.where = f"127.0.0.1:{self.command_port}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def hil(self, *words: str) -> list[str]:
        """A command line."""
        return [sys.executable, "-m", "hil", *words]

    def start(self, kind: str) -> None:
        """emulate, run, sidecar or router."""
        if kind == "router":
            script = [sys.executable, str(ROOT / "deploy" / "zenoh" / "router.py"), self.tls, self.routed]
            self._begin(kind, [*script, str(self.made / "router")])
            return
        sets = [word for override in (*CALM, *SLOW) for word in ("--set", override)]
        words = [kind, str(self.rig), *sets]
        if kind == "sidecar":
            listen = f'telemetry.listen=["{self.endpoint}", "{self.tls}"]'
            words += ["--set", listen, "--credentials", str(self.made / "sidecar"), "--out", str(self.base / "out")]
            words += ["--commands-from", f"0.0.0.0:{self.command_port}"]
        self._begin(kind, self.hil(*words))

    def _begin(self, kind: str, line: list[str]) -> None:
        with (self.base / f"{kind}.log").open("ab") as log:
            self.processes[kind] = subprocess.Popen(line, stdout=log, stderr=log, cwd=ROOT)

    def begin(self) -> None:
        """Everything, until the rig is READY."""
        for kind in ("emulate", "sidecar", "run"):
            self.start(kind)
        self.until(lambda: all((self.directory / name).exists() for name in ("commands", "mailbox")), "it runs")
        self.ready()

    def until(self, wanted: Callable[[], object], what: str, seconds: float = PATIENCE_S) -> None:
        """Wait for it."""
        limit = time.monotonic() + seconds
        while not wanted():
            assert time.monotonic() < limit, f"not within {seconds} s: {what}"
            time.sleep(0.01)

    def newest(self) -> State:
        """The newest tick's state, from the ring."""
        with RingReader(self.directory / "ring") as reader:
            reader.next = max(reader.written - 1, 0)
            records = reader.read(1, ("state",)).records
            return State(int(records[-1]["state"])) if len(records) else State.BOOT

    @contextlib.contextmanager
    def operator(self) -> Iterator[CommandClient]:
        """On this machine."""
        with local_client(self.directory) as client:
            yield client

    def command(self, kind: CommandKind) -> Verdict:
        """One, on a connection of its own."""
        with self.operator() as client:
            return client.command(kind)

    def ready(self) -> None:
        """Bring the rig back to READY, as an operator would."""

        def there() -> bool:
            state = self.newest()
            if state is State.READY:
                return True
            kind = CommandKind.STOP if state in (State.ACTIVE, State.HOMING) else CommandKind.RESET
            with contextlib.suppress(NoGatewayError):
                self.command(kind)
            time.sleep(0.1)
            return False

        self.until(there, "READY")

    def active(self) -> None:
        """Let it move."""

        def there() -> bool:
            if self.newest() is not State.ACTIVE:
                self.ready()  # again where a fault came in between
                return self.command(CommandKind.ACTIVATE).accepted
            return True

        self.until(there, "ACTIVE")

    def press(self) -> str:
        """Stop; what came of it."""
        pages = live_pages(NAME)
        assert pages, "no page"
        pressed_ns = pages[0].press()
        status = pages[0].await_latch(pressed_ns, PATIENCE_S)
        pages[0].close()
        after_ms = (status.latched_at - pressed_ns) / 1e6
        assert status.latched_state == "ESTOP", status.latched_state
        assert after_ms < STOP_S * 1e3, f"{after_ms:.0f} ms"
        return f"ESTOP after {after_ms:.1f} ms"

    def obeyed(self) -> str:
        """An operator on this machine gets the true verdict within a second."""
        began = time.monotonic()
        verdict = self.command(CommandKind.HEARTBEAT)
        took = time.monotonic() - began
        assert verdict == (True, "", self.newest().name), verdict
        assert took < 1.0, f"{took:.2f} s"
        return f"verdict from the rig's record in {took * 1e3:.0f} ms"

    def watched(self, seconds: float = 5.0) -> str:
        """A monitor that connects now hears the true state."""
        began = time.monotonic()
        with RigClient(self.endpoint, rig=NAME) as client:
            while True:
                status = client.wait_status(seconds)
                assert status.pid == self.processes["run"].pid, "a status of somebody else"
                if status.state == self.newest().name:
                    return f"a new monitor heard {status.state} in {time.monotonic() - began:.1f} s"
                assert time.monotonic() - began < seconds

    def signal(self, kind: str, number: signal.Signals) -> None:
        """To one of the processes."""
        self.processes[kind].send_signal(number)

    def close(self) -> None:
        """End everything."""
        for process in self.processes.values():
            process.kill()
            process.wait()
