"""A command server and gateway in this process, polled by a thread, before a mailbox that a stand-in empties."""

import threading
import time
from pathlib import Path
from types import TracebackType

import numpy as np

from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, LoadedLaw, LoadedTask
from hil.live.mailbox import Mailbox
from hil.live.ring import RingReader, RingWriter
from hil.live.stop_line import StopLine
from hil.live.task_file import TaskIntake
from hil.rig.file import load_rig
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import ESTOP
from hil.telemetry.command_server import CommandServer
from hil.telemetry.credentials import Credentials
from hil.telemetry.gateway import Gateway
from tests.support.paths import RIGS

RIG = load_rig(RIGS / "microscope-ideal.toml", ["safety.command_expiry_s=0.5"])
ACCEPTED = frozenset({CommandKind.STOP, CommandKind.HEARTBEAT, CommandKind.ACTIVATE, CommandKind.LOAD_TASK,
                      CommandKind.SET_LAW})  # fmt: skip


class CommandBench:
    """directory: the rig's. remote: as CommandServer takes it. entries: all that was recorded."""

    def __init__(self, directory: Path, remote: tuple[str, Credentials] | None = None) -> None:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.directory = directory
        self.entries: list[pb.CommandEntry] = []
        self.problems: list[str] = []  # what stands against the drives
        self.dead = False  # the control process takes nothing
        self._ended = threading.Event()
        self._stop = StopLine(directory)
        self._mailbox = Mailbox.create(directory / "mailbox")
        self._ring = RingWriter(directory / "ring", 256, period_ns=1_000_000, metadata={})
        self._reader = RingReader(directory / "ring")
        self._record = np.zeros(1, RECORD)[0]
        self._server = CommandServer(directory / "commands", remote)
        self._gateway = Gateway(RIG, directory / "stop", self.entries.append, lambda: self.problems, directory / "task")
        self.tasks: list[LoadedTask | None] = []  # what was taken in
        self.laws: list[LoadedLaw] = []  # the same of laws
        self._seen = 0
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._ended.is_set():
            now_ns = time.monotonic_ns()
            self._tick(now_ns)
            batch = self._reader.read()
            self._gateway.verdicts(batch.records, batch.first, now_ns)
            asked, ended = self._server.poll(now_ns)
            for connection in ended:
                if connection.closed_because:
                    self._gateway.note_rejected(connection.who, connection.closed_because, now_ns)
            for request in asked:
                self._gateway.take(request, self._mailbox, now_ns, "READY", self._record)
            self._gateway.advance(self._mailbox, now_ns, "READY")
            self._gateway.give_up(now_ns, "READY")
            time.sleep(0.002)

    def _tick(self, now_ns: int) -> None:
        if self.dead:
            return
        if self._mailbox.task_posted != self._seen:
            self._seen = self._mailbox.task_posted
            intake = TaskIntake(self.directory / "task", self._seen, RIG)
            while not intake.done:
                intake.work()
            if intake.law is None:
                self.tasks.append(intake.task)
            else:
                self.laws.append(intake.law)
            self._mailbox.answer_task(self._seen, ready=intake.task is not None or intake.law is not None)
        pressed, commands, record = self._stop.pressed(), self._mailbox.poll(), self._record
        state = State.ESTOP if pressed else State.READY
        record["now_ns"], record["state"], record["flags"] = now_ns, state, ESTOP * pressed
        record["n_commands"] = len(commands)
        for place, command in enumerate(commands):
            accepted = command.kind in ACCEPTED
            record["commands"][place] = (command.kind, accepted, command.sequence, command.expires_ns)
        self._ring.append(record)
        if pressed:
            self._stop.latched(state.name, 0)

    def __enter__(self) -> "CommandBench":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._ended.set()
        self._thread.join()
        for part in (self._server, self._reader, self._ring, self._mailbox, self._stop):
            part.close()
