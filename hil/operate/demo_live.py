"""The live part of `hil demo`: emulated stage, control process and sidecar as real processes, watched and operated."""

import contextlib
import json
import os
import shutil
import signal
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.live import Live

from drivers.base.runtime import make_private, read_private, runtime_dir
from drivers.protocols.base import DriveStatus
from hil.cli.processes import Family
from hil.cycle.axis_homing import HOMING_REQUIRED
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import DEMO_PREFIX, RuntimePaths, runtime_paths_in
from hil.operate.dead_man import NAMED
from hil.operate.monitor import EVENTS_KEPT, banner, drive_words, line, view
from hil.operate.stalls import by_this_computer
from hil.rig.schema import RigConfig
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import DEFAULT_ENDPOINT, NoSidecarError, RigClient
from hil.telemetry.command_client import NoGatewayError, local_client

START_S = 60.0  # for three Python processes to be up, and the rig ACTIVE, on a busy machine
STOP_S = 3.0
RECORDED_S = 30.0  # for the sidecar to write the rest of the recording; nothing moves any more
POLL_S = 0.02
LINE_INTERVAL_S = 1.0
SHOWN_STALLS = 20  # one by one; the summary says how many there were
RECORDING = "run.mcap"
_IN_MOTION = ("ACTIVE", "HOMING", "STOPPING")
# The demo may meet neither a real bus nor a machine that grants no real time: it is for laptops.
ALWAYS = ("bus.interface=local", "timing.allow_degraded=true", "telemetry.record=true")


class DemoError(Exception):
    """The demo cannot go on; the text says why."""


class TooBusyError(DemoError):
    """This computer held a process up for so long that the rig stopped, or did not start."""


class Interrupted(Exception):  # not an error
    """SIGINT or SIGTERM."""


class Scene(NamedTuple):
    """The demo's rig and its folders. emulated: the stage is, and is started, too."""

    rig: RigConfig
    rig_file: Path
    overrides: tuple[str, ...]
    runtime: Path
    out: Path
    emulated: bool = True

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

    def __init__(
        self,
        scene: Scene,
        console: Console,
        signals: Signals,
        *,
        insists: bool,
        holds: bool,
        held: Callable[[], bool] | None = None,
    ) -> None:
        """insists: go on after a stop that this computer caused; else that ends it, and `busy` says what happened.
        holds: the stage holds where it stands, and waits for goals. held: whether the operator's key is
        (hil/operate/dead_man.py); None: the stage moves without one.
        """
        self.scene = scene
        self.busy = ""
        self._insists = insists
        self._holds = holds
        self._signals = signals
        self.console = console
        self.troubles: list[str] = []
        self.status = pb.Status()
        self.events: deque[pb_events.Event] = deque(maxlen=EVENTS_KEPT)
        self._family = Family()
        self._said_s = 0.0
        self.stalls = 0
        self._refusal = ""
        self._stopped = False  # by an operator beside this demo
        self._homing = False  # asked for by this demo, and the stage has not been ACTIVE since
        self._held = held
        self._may_move = held is None
        self._beat_s = 0.0

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
                if isinstance(error, TooBusyError) and not self._insists:
                    self.busy = str(error)
                else:
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
        self.emulator = None
        if scene.emulated:
            self.emulator = start("emulator", ["emulate", *rig], environment, scene.out / "emulator.log")
        self.sidecar = start("sidecar", ["sidecar", *rig, *listen], environment, scene.out / "sidecar.log")
        # It is there once the drives are on the bus: a frame nobody acknowledges is a fault.
        if scene.emulated:
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
                raise TooBusyError(f"{otherwise} within {START_S:.0f} s")
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
        until, asked = time.monotonic() + START_S, False
        while self.status.state != "ACTIVE":
            self._look(client)
            if self.status.state == "READY" and not self._may_move:
                until = time.monotonic() + START_S  # the operator takes the time it takes
                if not asked:
                    self.console.print(f"hold {NAMED}: the stage moves while it is held, and stops when it is let go")
                asked = True
            if time.monotonic() > until:
                raise TooBusyError(f"the rig did not become ACTIVE within {START_S:.0f} s: {self._where()}")
            time.sleep(POLL_S)
        self.console.print("activated through the command gateway")
        if self._holds:
            self._say_how_to_move()

    def _say_how_to_move(self) -> None:
        rig = self.scene.rig
        name, axis = rig.name, rig.axis_names[0]
        unit = "mm" if rig.axes[axis].kind == "linear" else "deg"
        self.console.print(
            "it holds; move it from a second terminal, Ctrl-C here ends it:\n"
            f"  hil move {name} {axis}=0.5{unit}\n"
            f"  hil jog {name} {axis}=-1{unit}/s",
            soft_wrap=True,
            highlight=False,
        )

    @property
    def stalled(self) -> bool:
        """Whether this computer caused the fault that is latched."""
        latched = self.status.latched
        return by_this_computer(self.status.fault, latched.cause, latched.run_ns, self.events)

    def _where(self) -> str:
        status = self.status
        words = zip(status.axes, status.drive_status, strict=False)
        drives = "".join(f"; {axis}: {drive_words(bits).plain.strip()}" for axis, bits in words)
        told = banner(status, list(self.events)).plain
        return f"state {status.state or 'unknown'}, {told or 'no fault'}{drives}{self._refusal}"

    def _operate(self) -> None:
        """What an operator does: activate what is READY, unless another operator stopped it; reset what stopped because
        this machine held a process up.
        """
        status = self.status
        if status.state in ("FAULT", "ESTOP"):
            if not self.stalled:
                pressed = "hil estop or a page's E-STOP" if status.state == "ESTOP" else "a fault of the stage"
                raise DemoError(f"{pressed} stopped the rig: {self._where()}")
            self._homing = False
            self._command(CommandKind.RESET)
        elif tripped(status):
            self._command(CommandKind.RESET)
        elif status.state == "READY" and status.recording and self._may_move and not self._stopped:
            self._begin()

    def _begin(self) -> None:
        """Home where that is asked for, then activate. A stage that is not homed after that was stopped meanwhile."""
        if HOMING_REQUIRED not in self._refusal:
            self._command(CommandKind.ACTIVATE_HOLD if self._holds else CommandKind.ACTIVATE)
        elif self._homing:
            self._note_operator()
        else:
            self._homing = True
            self._command(CommandKind.HOME)

    def _note_stall(self, before: pb.Status) -> None:
        status = self.status
        stopped = status.state == "FAULT" != before.state and self.stalled
        if stopped or (tripped(status) and not tripped(before)):
            what = f"{status.fault} stopped the stage" if stopped else "a drive's watchdog tripped"
            told = f"this computer was too busy: {what} at tick {status.index}"
            if not self._insists:
                raise TooBusyError(told)
            self.stalls += 1
            if self.stalls <= SHOWN_STALLS:
                self.console.print(f"{told}; resetting", soft_wrap=True)

    def _note_stop(self, before: pb.Status) -> None:
        """A rig that was brought to rest by somebody's command stays so until somebody's command activates it."""
        state = self.status.state
        homed = before.state == "HOMING" and self._homing
        if state == "READY" and before.state in _IN_MOTION and not homed:
            self._note_operator()
        elif state == "ACTIVE":
            self._stopped = self._homing = False

    def _note_operator(self) -> None:
        self._stopped, self._homing = True, False
        begins = "home" if HOMING_REQUIRED in self._refusal else "activate-hold" if self._holds else "activate"
        self.console.print(
            f"stopped by an operator; to go on: hil command {self.scene.rig.name} {begins}", soft_wrap=True
        )

    def _beat(self) -> None:
        """The operator's heartbeat, where the rig file asks for one: four times as often as it must come."""
        if self._held is not None:
            self._may_move = self._held()
        every_s, now_s = 0.25 * self.scene.rig.safety.heartbeat_s, time.monotonic()
        known = self.status.state in ("READY", *_IN_MOTION)
        if every_s and known and self._may_move and now_s - self._beat_s >= every_s:
            self._beat_s = now_s
            with contextlib.suppress(NoGatewayError), local_client(self.scene.paths.directory) as gateway:
                gateway.command(CommandKind.HEARTBEAT)

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
        self._beat()
        status = client.status()
        self.events.extend(client.events())
        if status is None:
            return False
        before, self.status = self.status, status
        self._note_stall(before)
        self._note_stop(before)
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
            to_go = "" if self._holds else f"{left:5.1f} s to go  "
            self.console.print(f"{to_go}{line(self.status)}", soft_wrap=True, markup=False)

    def _finish(self) -> None:
        """End the control process (its last torque is zero), then the sidecar with its recording, then the stage."""
        if not hasattr(self, "control"):
            return
        if self.control.exit_status is None and not self.control.end(STOP_S):
            self.troubles.append(self.control.fate())
        self.sidecar.end(RECORDED_S)
        if self.emulator:
            self.emulator.end(STOP_S)
        if self.busy:
            self.troubles.clear()  # its processes ended late, too
        elif self.emulator:
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
