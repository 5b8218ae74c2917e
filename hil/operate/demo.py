"""`hil demo RIG`: emulated stage, control process and sidecar as real processes, shown live, summed up at the end."""

import json
import os
import shutil
import signal
import sys
import time
from collections import deque
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console
from rich.live import Live

from drivers.protocols.base import DriveStatus
from drivers.runtime import make_private, read_private, runtime_dir
from hil.cli.exit_status import EXIT_FAULT
from hil.cli.options import Overrides, RigFile
from hil.cli.output import print_plant_notes, write_json
from hil.cli.processes import Family
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import DEMO_PREFIX, RuntimePaths, runtime_paths_in
from hil.operate.monitor import EVENTS_KEPT, banner, drive_words, line, view
from hil.rig.file import load_rig
from hil.rig.provenance import control_path
from hil.rig.schema import RigConfig
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.blackbox import run_directory
from hil.telemetry.client import DEFAULT_ENDPOINT, NoSidecarError, RigClient
from hil.telemetry.command_client import NoGatewayError, local_client
from hil.telemetry.recording import RecordingError
from sim_plant.config import REAL_STAGES

START_S = 60.0  # for three Python processes to be up, and the rig ACTIVE, on a busy machine
STOP_S = 3.0
POLL_S = 0.02
LINE_INTERVAL_S = 1.0
STALL_FAULTS = (
    "ENCODER_LOST",
    "ENCODER_DEAD",
    "DRIVE_WATCHDOG",
    "DRIVE_DISABLED",
    "OVERRUN",
    "OVERRUN_BURST",
    "OVERRUN_LONG",
    "RECEIVE_FLOOD",
    "BAD_FRAMES",
    "TRANSMIT_REFUSED",
    "TRANSMIT_BLOCKED",
    "ENABLE_TIMEOUT",
)  # faults that a host stalling the emulator or the loop for milliseconds causes
SHOWN_STALLS = 20  # one by one; the summary says how many there were
LOG_WIDTH = 120  # of tables where there is no terminal
# The demo may meet neither a real bus nor a machine that grants no real time: it is for laptops.
ALWAYS = ("bus.interface=local", "timing.allow_degraded=true", "telemetry.record=true")


class DemoError(Exception):
    """The demo cannot go on; the text says why."""


class Interrupted(Exception):  # not an error
    """SIGINT or SIGTERM."""


class Scene(NamedTuple):
    """The demo's rig and its folders."""

    rig: RigConfig
    rig_file: Path
    overrides: tuple[str, ...]
    runtime: Path
    out: Path

    @property
    def paths(self) -> RuntimePaths:
        """The rig's files in the private runtime directory."""
        return runtime_paths_in(self.runtime, self.rig.name)


class Signals:
    """Notes SIGINT and SIGTERM; they take effect where `check` is called, so that no shutdown is cut short."""

    def __init__(self) -> None:
        self.seen = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, _frame: object) -> None:
        self.seen = number

    def check(self) -> None:
        """Raises Interrupted once a signal has come."""
        if self.seen:
            raise Interrupted


def private_runtime() -> Path:
    """A runtime directory for this demo alone; those of demos that are gone are removed."""
    base = runtime_dir()
    for old in base.glob(f"{DEMO_PREFIX}*"):
        pid = old.name.removeprefix(DEMO_PREFIX)
        if pid.isdigit() and not Path(f"/proc/{pid}").exists():
            shutil.rmtree(old, ignore_errors=True)
    directory = base / f"{DEMO_PREFIX}{os.getpid()}"
    make_private(directory)
    return directory


class Demo:
    """One demonstration from start to summary."""

    def __init__(self, scene: Scene, console: Console, signals: Signals) -> None:
        self.scene = scene
        self._signals = signals
        self.console = console
        self.troubles: list[str] = []
        self.status = pb.Status()
        self.events: deque[pb_events.Event] = deque(maxlen=EVENTS_KEPT)
        self._family = Family()
        self._said_s = 0.0
        self.stalls = 0
        self._refusal = ""

    def run(self, seconds: float) -> None:
        """Start, activate, watch for `seconds`, stop. What goes wrong is in `troubles` afterwards."""
        rig = self.scene.rig
        with self._family:
            try:
                self._start()
                with RigClient(self._await_endpoint(), rig.telemetry.key, rig.name) as client:
                    self._await_active(client)
                    self._watch(client, seconds)
            except (DemoError, NoSidecarError) as error:
                self.troubles.append(str(error))
            except Interrupted:
                self.console.print("interrupted: stopping the stage")
            self._finish()

    def _start(self) -> None:
        scene = self.scene
        environment = {**os.environ, "HIL_RUNTIME_DIR": str(scene.runtime), "PYTHONUNBUFFERED": "1"}
        overrides = [word for text in scene.overrides for word in ("--set", text)]
        rig = [str(scene.rig_file), *overrides]
        listen = ["--listen", DEFAULT_ENDPOINT, "--or-free-port", "--out", str(scene.out)]
        start = self._family.start
        self.emulator = start("emulator", ["emulate", *rig], environment, scene.out / "emulator.log")
        self.sidecar = start("sidecar", ["sidecar", *rig, *listen], environment, scene.out / "sidecar.log")
        # It is there once the drives are on the bus: a frame nobody acknowledges is a fault.
        self._await_file(scene.paths.emulator, "the emulated stage was not on the bus")
        self.control = start("control process", ["run", *rig], environment, scene.out / "control.log")
        pids = ", ".join(f"{child.name} {child.pid}" for child in self._family.children)
        self.console.print(f"started {pids}", soft_wrap=True)

    def _await_file(self, place: Path, otherwise: str) -> None:
        """Until one of the processes has made this file, which says that it is ready."""
        until = time.monotonic() + START_S
        while not place.exists():
            self._check_alive()
            if time.monotonic() > until:
                raise DemoError(f"{otherwise} within {START_S:.0f} s")
            time.sleep(POLL_S)

    def _await_endpoint(self) -> str:
        """Where the sidecar listens, as soon as it does."""
        place = self.scene.paths.endpoint
        self._await_file(place, "the sidecar did not listen")
        endpoint = read_private(place).decode()
        self.console.print(f"watch it from a second terminal: hil monitor {self.scene.rig.name} (it is at {endpoint})")
        return endpoint

    def _check_alive(self) -> None:
        self._signals.check()
        gone = self._family.ended()
        if gone:
            raise DemoError(gone.fate())

    def _await_active(self, client: RigClient) -> None:
        until = time.monotonic() + START_S
        while self.status.state != "ACTIVE":
            self._look(client)
            if time.monotonic() > until:
                raise DemoError(f"the rig did not become ACTIVE within {START_S:.0f} s: {self._where()}")
            time.sleep(POLL_S)
        self.console.print("activated through the command gateway")

    def _where(self) -> str:
        status = self.status
        words = zip(status.axes, status.drive_status, strict=False)
        drives = "".join(f"; {axis}: {drive_words(bits).plain.strip()}" for axis, bits in words)
        told = banner(status, list(self.events)).plain
        return f"state {status.state or 'unknown'}, {told or 'no fault'}{drives}{self._refusal}"

    def _operate(self) -> None:
        """What an operator does: activate what is READY; reset what stopped because this machine held a process up."""
        status = self.status
        if status.state in ("FAULT", "ESTOP"):
            if status.fault not in STALL_FAULTS:
                raise DemoError(f"the rig stopped: {self._where()}")
            self._command(CommandKind.RESET)
        elif tripped(status):
            self._command(CommandKind.RESET)
        elif status.state == "READY" and status.recording:
            self._command(CommandKind.ACTIVATE)

    def _note_stall(self, before: pb.Status) -> None:
        status = self.status
        stopped = status.state == "FAULT" != before.state and status.fault in STALL_FAULTS
        if stopped or (tripped(status) and not tripped(before)):
            self.stalls += 1
            what = (
                banner(status, list(self.events)).plain
                if stopped
                else f"a drive's watchdog tripped at tick {status.index}"
            )
            if self.stalls <= SHOWN_STALLS:
                self.console.print(f"{what}: this machine held a process up; resetting", soft_wrap=True)

    def _command(self, kind: CommandKind) -> None:
        try:
            with local_client(self.scene.paths.directory) as gateway:
                verdict = gateway.command(kind)
        except NoGatewayError as error:  # this machine holds the sidecar up: the next status is another chance
            self._refusal = f"; {kind.name} got no answer: {error}"
            return
        self._refusal = "" if verdict.accepted else f"; {kind.name} was refused: {verdict.reason}"

    def _look(self, client: RigClient) -> bool:
        """Take in the newest status and act on it. Raises DemoError when a process ended, Interrupted on a signal."""
        self._check_alive()
        status = client.status()
        self.events.extend(client.events())
        if status is None:
            return False
        before, self.status = self.status, status
        self._note_stall(before)
        self._operate()
        return True

    def _watch(self, client: RigClient, seconds: float) -> None:
        until = time.monotonic() + seconds
        if not self.console.is_terminal:
            while time.monotonic() < until:
                self._look(client)
                self._say_line(until - time.monotonic())
                time.sleep(POLL_S)
            return
        with Live(view(self.status), console=self.console, auto_refresh=False, transient=True) as live:
            while time.monotonic() < until:
                if self._look(client):
                    live.update(view(self.status, events=list(self.events)), refresh=True)
                time.sleep(POLL_S)

    def _say_line(self, left: float) -> None:
        now = time.monotonic()
        if now - self._said_s >= LINE_INTERVAL_S:
            self._said_s = now
            self.console.print(f"{left:5.1f} s to go  {line(self.status)}", soft_wrap=True, markup=False)

    def _finish(self) -> None:
        """End the control process (its last torque is zero), then the sidecar with its recording, then the stage."""
        if not hasattr(self, "control"):
            return
        if self.control.exit_status is None and not self.control.end(STOP_S):
            self.troubles.append(self.control.fate())
        self.sidecar.end(STOP_S)
        self.emulator.end(STOP_S)
        self._report_drives()

    def _report_drives(self) -> None:
        """A control process that died leaves the stage to the drives' watchdogs: say what they did."""
        if self.control.exit_status == 0:
            return
        try:
            state = json.loads(read_private(self.scene.paths.emulator))
        except (OSError, ValueError):
            self.troubles.append("the emulator left no word of its drives")
            return
        self.troubles.extend(drive_report(state))


def tripped(status: pb.Status) -> bool:
    """Whether a drive's watchdog keeps the rig from READY. Nothing moves in CONNECTED, so that is no fault of the rig
    and stops nothing; but it stays until an operator's RESET.
    """
    return status.state == "CONNECTED" and any(bits & DriveStatus.WATCHDOG for bits in status.drive_status)


def drive_report(state: dict[str, Any]) -> list[str]:
    """What each emulated drive did after the last command, from the emulator's status file."""
    lines = []
    for name, axis in state["axes"].items():
        if axis["trips"]:
            last = axis["trips"][-1]
            lines.append(
                f"drive {name}: zero torque {last['zero_after_ms']:.1f} ms after the last command "
                f"(it was applying {last['force_until_then']:.4g}); now {axis['applied_force']:g}"
            )
        else:
            lines.append(f"drive {name}: applies {axis['applied_force']:g}; its watchdog did not trip")
    return lines


def summed_up(scene: Scene, console: Console) -> dict[str, Any] | None:
    """Read the recording back; write summary.json and tracking.png; print the tables."""
    from hil.cli.pictures import tracking_picture  # matplotlib takes a second: not while the loop runs
    from hil.operate.summary import load_run, show, summarise

    try:
        run = load_run(scene.out / "run.mcap")
    except RecordingError as error:
        console.print(f"no summary: {error}", soft_wrap=True)
        return None
    summary = summarise(run)
    write_json(summary, str(scene.out / "summary.json"))
    tracking_picture(scene.out / "tracking.png", run.rig, run, run.lateness, run.marks)
    show(summary, run.rig, console)
    return summary


def _what_next(scene: Scene, console: Console) -> None:
    rig, out = scene.rig_file, scene.out
    other = "structured-kalman" if scene.rig.law.name == "pd-feedforward" else "pd-feedforward"
    console.print(
        f"in {out}/: summary.json, tracking.png, run.mcap, and the processes' logs\n"
        "next, try:\n"
        f"  hil replay {out}/run.mcap                     every torque frame again, byte for byte\n"
        f"  hil demo {rig} --set law.name={other}\n"
        f"  hil sim {rig} --seconds 20       the same in exact virtual time\n"
        "  hil doctor                                    what this machine grants a real-time loop",
        soft_wrap=True,
        highlight=False,
    )


def _that_keeps_up(rig: Path, overrides: tuple[str, ...]) -> tuple[RigConfig, tuple[str, ...], str]:
    """The rig, the overrides it takes, and what to say of them: interpreted, the emulator of a stage with guides, a
    mode and noise takes longer for a period than a period lasts.
    """
    chosen = (*overrides, *ALWAYS)
    config = load_rig(rig, chosen)
    stated = any(override.startswith("plant.stage=") for override in overrides)
    if config.plant.stage not in REAL_STAGES or stated or control_path() == "compiled":
        return config, chosen, ""
    note = (
        f"the emulated stage is an ideal one here: interpreted code is too slow for {config.plant.stage} live (make "
        "compiled, or the Debian package, is not; hil sim has it in virtual time; --set plant.stage=... insists)"
    )
    chosen = (*chosen, "plant.stage=ideal")
    return load_rig(rig, chosen), chosen, note


def demo(
    rig: RigFile,
    seconds: Annotated[float, typer.Option(min=0.5, max=1e6, help="how long the task runs")] = 20.0,
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="directory for what the run leaves [runs/<time>]")] = None,
) -> None:
    """Exit status 0: it went as planned, but for stops because this machine held up a process, which are shown; 1:
    something failed, and the output says what; 3: it ended in another fault; 130 or 143: interrupted.
    """
    config, chosen, note = _that_keeps_up(rig, tuple(overrides or ()))
    signals = Signals()
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = LOG_WIDTH
    scene = Scene(config, rig, chosen, private_runtime(), out or run_directory())
    scene.out.mkdir(parents=True, exist_ok=True)
    console.print(f"demo of {config.name}: {config.description}", soft_wrap=True)
    console.print(
        "the stage is emulated, the bus is local to this demo, and it runs even where no real time is granted",
        soft_wrap=True,
    )
    if note:
        console.print(note, soft_wrap=True)
    print_plant_notes(console, config)
    stage = Demo(scene, console, signals)
    try:
        stage.run(seconds)
        summary = summed_up(scene, console)
    finally:
        shutil.rmtree(scene.runtime, ignore_errors=True)
    if stage.stalls:
        console.print(f"{stage.stalls} stop(s) because this machine held up a process: shown, reset, activated again")
    for trouble in stage.troubles:
        console.print(trouble, soft_wrap=True, markup=False)
    if signals.seen:
        sys.exit(128 + signals.seen)
    if summary and summary["latched"]:
        if summary["latched"]["name"] not in STALL_FAULTS:
            sys.exit(EXIT_FAULT)
        console.print("this machine held up a process at the very end: the time was up before that stop was reset")
    if stage.troubles or summary is None:
        sys.exit(1)
    _what_next(scene, console)
