"""What the tests of the installed service do and look at: commands, units, the state machine, the emulated drives."""

import json
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TextIO

import pytest

PATIENCE_S = 900.0  # software emulation on a busy machine, where installing took 300; only a failure waits it out
PACKAGES = Path("/share/packages")
RIGS = Path("/etc/hil/rigs")

# The edit of the rig file: this guest is fifty times slower than a rig's PC and promises no timing at all. At 20 Hz no
# law damps a mode of 200 Hz: the stage is an ideal one, under PD. Answers that were held up come in a heap, too old for
# the few sequence numbers of classic CAN: they are no flood here.
EDIT = {
    r"^rate_hz = .*$": "rate_hz = 20",
    r'^name = "presliding-kalman"$': 'name = "pd-feedforward"\n'
    "gains = { kp = [24.0, 16.0, 6.4, 0.0053], kd = [6.4, 4.4, 1.8, 0.00144] }",
    r", torque_lag = .*, presliding = .* }$": " }",
    r'^stage = "crossed-roller"$': 'stage = "ideal"',
    r"following_error = [0-9.e-]+": "following_error = 0.02",
    r'^kind = "injection"$': 'kind = "hold"',
    r"^allow_degraded = .*$": "allow_degraded = true",
    r"^\[telemetry\]$": "[telemetry]\npublish_hz = 5",
    r"^watchdog_s = [0-9.]+": "watchdog_s = 1.0",
    r"^\[plant\]$": "[safety]\nsilent_stop_ticks = 100\nsilent_zero_ticks = 200\noverrun_zero_s = 5.0\n"
    "overrun_streak = 1000\nbad_frame_limit = 1000\nflood_frames = 1000\ncommand_expiry_s = 5.0\n\n"
    "[plant]",
}


def edited(text: str, edits: dict[str, str] = EDIT) -> str:
    """A rig file's text with every one of the edits made."""
    for pattern, replacement in edits.items():
        text, found = re.subn(pattern, replacement, text, flags=re.MULTILINE)
        assert found, pattern
    return text


def sh(command: str, *, ok: bool = True) -> str:
    """Output of a shell command that must succeed (unless not ok)."""
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, timeout=PATIENCE_S, check=False, stdin=subprocess.DEVNULL
    )
    assert not ok or done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def watch(command: str, until: str, meanwhile: Callable[[], object] = lambda: None) -> str:
    """Run a command that only Ctrl-C ends: press it when `until` (a pattern) has been shown; what it showed.

    meanwhile: done once a second for as long as `until` has not been shown.
    """
    shown = ""
    deadline = time.monotonic() + PATIENCE_S
    with subprocess.Popen(
        f"exec {command}", shell=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        text = _reading(process.stdout)
        while not re.search(until, shown):
            assert process.poll() is None, f"{command}: ended with {process.returncode}\n{text()}"
            assert time.monotonic() < deadline, f"{command}: never showed {until}:\n{shown}"
            meanwhile()
            time.sleep(1)
            shown = text()
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    assert process.returncode in (0, 130, -signal.SIGINT), f"{command}: {process.returncode}\n{shown}"
    assert "Traceback" not in shown
    return shown


def _reading(stream: TextIO) -> Callable[[], str]:
    """Collect what a process writes, in a thread; a function that gives all of it so far."""
    parts: list[str] = []
    threading.Thread(target=lambda: parts.extend(iter(stream.readline, "")), daemon=True).start()
    return lambda: "".join(parts)


def eventually(holds: Callable[[], object], what: str) -> None:
    """Wait until `holds()`; fail with what the services say of themselves."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > deadline:
            told = sh("systemctl status --no-pager -n 25 'hil-*'", ok=False)
            pytest.fail(f"not within {PATIENCE_S:.0f} s: {what}\n{told}")
        time.sleep(0.5)


_CONSOLE = """
import sys
from hil.cli.app import main
for line in sys.stdin:
    sys.argv = ["hil", *line.split()]
    try:
        main()
    except SystemExit as end:
        print(f"exit status {end.code or 0}", flush=True)
"""


class Console:
    """Many a `hil command` and `hil monitor` in one process of the package's: to start one takes half a minute here."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._told: Callable[[], str] = str
        self._seen = 0

    def _started(self) -> "subprocess.Popen[str]":
        if self._process is None:
            self._process = subprocess.Popen(
                ["/opt/hil/bin/python3", "-I", "-c", _CONSOLE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            assert self._process.stdout is not None
            self._told = _reading(self._process.stdout)
        return self._process

    def __call__(self, words: str) -> tuple[int, str]:
        """Exit status and output of `hil WORDS`."""
        process = self._started()
        assert process.stdin is not None
        process.stdin.write(words + "\n")
        process.stdin.flush()

        def done() -> "re.Match[str] | None":
            assert process.poll() is None, self._told()
            return re.search(r"^exit status (\d+)\n", self._told()[self._seen :], flags=re.MULTILINE)

        eventually(done, f"hil {words}")
        end = done()
        assert end is not None
        output = end.string[: end.start()]
        self._seen += end.end()
        return int(end[1]), output


console = Console()


class Unit(str):
    """A unit's name, and what systemd says of it."""

    def show(self, prop: str) -> str:
        """One property."""
        return sh(f"systemctl show --value --property={prop} '{self}'").strip()

    @property
    def state(self) -> str:
        """ActiveState."""
        return self.show("ActiveState")

    @property
    def pid(self) -> int:
        """Of its main process, 0: none."""
        return int(self.show("MainPID"))

    @property
    def journal(self) -> str:
        """All it has written to the journal."""
        return sh(f"journalctl --no-pager -o cat -u '{self}'")


class Rig(NamedTuple):
    """An installed rig."""

    name: str

    @property
    def file(self) -> Path:
        """Its rig file."""
        return RIGS / f"{self.name}.toml"

    @property
    def control(self) -> Unit:
        """The control unit."""
        return Unit(f"hil-control@{self.name}.service")

    @property
    def sidecar(self) -> Unit:
        """The sidecar's unit."""
        return Unit(f"hil-sidecar@{self.name}.service")

    @property
    def emulator(self) -> Unit:
        """The emulator's unit."""
        return Unit(f"hil-emulator@{self.name}.service")

    def edit(self, edits: dict[str, str]) -> None:
        """Edit the rig file."""
        self.file.write_text(edited(self.file.read_text(), edits))

    def shows(self, *states: str) -> bool:
        """Whether `systemctl status` shows one of the state machine's states."""
        return self.control.show("StatusText").split(",")[0] in states

    def wait_for(self, *states: str) -> None:
        """Until `systemctl status` shows one of the state machine's states."""
        eventually(lambda: self.shows(*states), " or ".join(states))

    def order(self, action: str) -> bool:
        """An operator's command through the gateway; whether it was taken."""
        status, said = console(f"command {self.file} {action}")
        print(said, end="")
        return status == 0

    def reset_to(self, state: str) -> None:
        """To CONNECTED or READY, by resets where it takes them, as the page for the rig says.

        A guest that is not let run for a second may find itself in FAULT at any time: it promises no timing.
        """
        eventually(lambda: self.shows(state) or (self.order("reset") and self.shows(state)), state)

    def recover(self) -> None:
        """A reset, where it has fallen into FAULT meanwhile."""
        if self.shows("FAULT"):
            self.order("reset")

    def to_ready(self) -> None:
        """To READY."""
        self.reset_to("READY")

    def activate(self) -> None:
        """To ACTIVE, from wherever it is; again where a guest that was not let run has fallen into FAULT meanwhile."""

        def carries() -> bool:
            if not self.shows("ACTIVE"):
                self.to_ready()
                self.order("activate")
            return self.shows("ACTIVE") and not self.no_torque()

        eventually(carries, "ACTIVE, with torque: Z has its weight to carry")

    def drives(self) -> dict:
        """What the emulated drives say of themselves, as of now (they write it twice a second)."""
        asked_ns = time.monotonic_ns()
        told: dict = {}

        def fresh() -> bool:
            told.update(json.loads(Path(f"/run/hil/{self.name}/emulator.json").read_text()))
            return told["now_ns"] > asked_ns

        eventually(fresh, "the drives tell of themselves")
        return told["axes"]

    def no_torque(self) -> bool:
        """Whether no drive applies any force."""
        return all(axis["applied_force"] == 0.0 for axis in self.drives().values())

    def monitored(self) -> bool:
        """Whether a monitor sees it over Zenoh."""
        return self.name in console(f"monitor {self.name} --once")[1]
