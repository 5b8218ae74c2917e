"""The emulated stage as a process: answers frames as they come, on the monotonic clock.

Physics follows the frames' own time stamps, not the instants at which this process got to run. A stall of the host
delays the answers, but moves no sample and expires no watchdog that a command fed in time.

Commands that come at a steady rate are fetched by the stage's own timer, a little after each is due. A process that
waits for a frame is woken by its sender, who pays for the interrupt of another core: microseconds as a rule, now and
then milliseconds where a hypervisor delivers it. No drive on a real bus is woken at the control loop's expense.
"""

import gc
import json
import os
import select
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.base.runtime import stop_signals, write_private
from drivers.bus.counters import BusState
from drivers.bus.port import Port
from drivers.protocols.base import DriveStatus
from sim_plant.emulator import EmulatedStage

PRIORITY = 20  # SCHED_FIFO, below every control process: a drive is never late because a desktop redraws
_LONGEST_WAIT_MS = 50
_HEARTBEAT_WAIT_MS = 2  # where drives speak unasked: how late they may be
_REPORT_NS = 500_000_000
_REBIND_NS = 200_000_000
_LONGEST_NAP_NS = 5_000_000
_ALL_OF_A_CORE = 0.9  # the kernel leaves a real-time process 95 %
_PATIENCE = 4  # reports in turn with no time left


class StopSignals:
    """SIGTERM, SIGINT and SIGHUP as a readable descriptor, so that waiting for frames ends at once."""

    def __init__(self) -> None:
        self._reader, self._writer = socket.socketpair()
        self.seen = False

    def __enter__(self) -> "StopSignals":
        self._writer.setblocking(False)
        self._old_fd = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        self._old = {number: signal.signal(number, self._note) for number in stop_signals()}
        return self

    def __exit__(self, *exception: object) -> None:
        signal.set_wakeup_fd(self._old_fd)
        for number, handler in self._old.items():
            signal.signal(number, handler)
        self._reader.close()
        self._writer.close()

    def _note(self, _number: int, _frame: object) -> None:
        self.seen = True

    def fileno(self) -> int:
        """Readable once a signal has come."""
        return self._reader.fileno()


def promote() -> bool:
    """Ask for modest real time and a still garbage collector; False where the kernel refuses (see the status)."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError:
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


class Rhythm:
    """When the next command is due, judged by the last three."""

    def __init__(self) -> None:
        self._last_ns = -1
        self._gaps = _LONGEST_NAP_NS, _LONGEST_NAP_NS

    def heard(self, command_ns: int) -> None:
        """A command came at this instant; the one before again where none has."""
        if command_ns != self._last_ns:
            self._gaps = self._gaps[1], command_ns - self._last_ns
            self._last_ns = command_ns

    def fetch_ns(self) -> int:
        """When to look for the next command: a tenth of a gap after it is due. In the past where no rhythm is known.

        The shorter of the last two gaps counts, so that a command left out does not make its successor late.
        """
        gap_ns = min(self._gaps)
        return self._last_ns + gap_ns + gap_ns // 10 if gap_ns < _LONGEST_NAP_NS else self._last_ns


class Emulator:
    """The process' loop around an EmulatedStage whose clock starts now (time.monotonic_ns).

    status_path: where the drives' state is written as JSON: as soon as they are on the bus, which tells others that
    they are, after every watchdog expiry, twice a second, and at the end. too_slow: called once, when the stage has
    taken all of a core for two seconds: its answers come later and later then, or never in time. watched: called in
    every step, when the stage has reached its instant.
    """

    def __init__(
        self,
        stage: EmulatedStage,
        port: Port,
        status_path: Path | None = None,
        too_slow: Callable[[], object] = lambda: None,
        watched: Callable[[], object] = lambda: None,
    ) -> None:
        self.stage = stage
        self.port = port
        self.realtime = False
        self.status_error = ""  # why the status could not be written when that last happened
        self._status_path = status_path
        self._reported_ns = 0
        self._reported_trips = 0
        self._rebind_ns = 0
        self.rhythm = Rhythm()
        self.busy = 0.0  # of a core, over the last half second
        self._too_slow = too_slow
        self._watched = watched
        self._busy_reports = 0
        self._judged_ns, self._cpu_ns = time.monotonic_ns(), time.process_time_ns()

    def run(self) -> None:
        """Answer until SIGTERM, SIGINT or SIGHUP; the last status is on disk when this returns."""
        with StopSignals() as stop:
            self.realtime = promote()
            self._write_status(running=True)
            while not stop.seen:
                self.wait(stop)
                self.step(time.monotonic_ns())
        self._write_status(running=False)

    def wait(self, stop: StopSignals) -> None:
        """Until the next command can be fetched; until anything comes, where it is not there then."""
        now_ns = time.monotonic_ns()
        longest_ms = _HEARTBEAT_WAIT_MS if self.stage.speaks_unasked else _LONGEST_WAIT_MS
        until_expiry_ms = min(max(0, self.stage.deadline_ns - now_ns) / 1e6, longest_ms)
        until_command_ms = (self.rhythm.fetch_ns() - now_ns) / 1e6
        if until_command_ms > 0:
            select.select([stop], [], [], min(until_command_ms, until_expiry_ms) / 1e3)
            return
        poll = select.poll()
        poll.register(stop.fileno(), select.POLLIN)
        for port in self.port.members:
            if port.counters().state is not BusState.DOWN:
                poll.register(port.fileno(), select.POLLIN)
        poll.poll(until_expiry_ms)

    def step(self, now_ns: int) -> None:
        """Answer all frames that have come, then let the stage live until now_ns (read before they were fetched)."""
        for frame in self.port.drain(now_ns):
            for answer in self.stage.on_frame(frame):
                self.port.send(answer)
            self.rhythm.heard(self.stage.drives[0].last_command_ns)
        for unasked in self.stage.advance(now_ns):
            self.port.send(unasked)
        self._watched()
        if self.port.counters().state is BusState.DOWN and now_ns - self._rebind_ns > _REBIND_NS:
            self._rebind_ns = now_ns
            for port in self.port.members:
                if port.counters().state is BusState.DOWN:
                    port.rebind()
        trips = sum(len(drive.trips) for drive in self.stage.drives)
        if trips != self._reported_trips or now_ns - self._reported_ns > _REPORT_NS:
            self._reported_trips = trips
            self._reported_ns = now_ns
            self._judge(now_ns)
            self._write_status(running=True)

    def _judge(self, now_ns: int) -> None:
        """Whether there is time left beside the stage."""
        if now_ns - self._judged_ns < _REPORT_NS:
            return
        cpu_ns = time.process_time_ns()
        self.busy = (cpu_ns - self._cpu_ns) / (now_ns - self._judged_ns)
        self._judged_ns, self._cpu_ns = now_ns, cpu_ns
        self._busy_reports = self._busy_reports + 1 if self.busy > _ALL_OF_A_CORE else 0
        if self._busy_reports == _PATIENCE:
            self._too_slow()
            self._too_slow = lambda: None

    def status(self, *, running: bool) -> dict[str, Any]:
        """Everything a demo or a test needs to judge the drives; SI units, times in ns of the monotonic clock."""
        stage = self.stage
        position = stage.position.tolist()
        axes = {}
        for drive, name, force in zip(stage.drives, stage.axis_names, stage.applied_force, strict=True):
            axes[name] = {
                "position": position[drive.axis],
                "applied_force": force,
                "status": str(DriveStatus(drive.status)),
                "last_command_ns": drive.last_command_ns,
                "stale_commands": drive.stale,
                "trips": [
                    {
                        "last_command_ns": trip.command_ns,
                        "zero_ns": trip.expired_ns,
                        "zero_after_ms": (trip.expired_ns - trip.command_ns) / 1e6,
                        "force_until_then": trip.force,
                    }
                    for trip in drive.trips[-20:]
                ],
            }
        return {
            "running": running,
            "now_ns": stage.now_ns,
            "realtime": self.realtime,
            "busy": self.busy,
            "commands": stage.commands,
            "rejected": {reason.name.lower(): count for reason, count in stage.rejected.items() if count},
            "axes": axes,
            "port": {key: int(value) for key, value in self.port.counters()._asdict().items()},
        }

    def _write_status(self, *, running: bool) -> None:
        if self._status_path is None:
            return
        # Without an indent: with one, json builds functions that refer to each other, which are garbage that only the
        # collector would find, and there is none here.
        try:
            write_private(self._status_path, json.dumps(self.status(running=running)))
        except OSError as error:  # no room, or its directory is gone: the stage goes on for whoever drives it
            self.status_error = f"{self._status_path}: {error.strerror}"
