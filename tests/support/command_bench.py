"""A command server and gateway in this process, polled by a thread, before a mailbox that a stand-in empties."""

import threading
import time
from pathlib import Path
from types import TracebackType

from hil.cycle.record_builder import RecordBuilder
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, OperatorCommand
from hil.live.mailbox import Mailbox
from hil.live.ring import RingReader, RingWriter
from hil.live.stop_line import StopLine
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import ESTOP
from hil.telemetry.command_server import CommandServer
from hil.telemetry.credentials import Credentials
from hil.telemetry.gateway import Gateway
from tests.support.records import bare_tick, put_tick

EXPIRY_S = 0.5
ACCEPTED = frozenset({CommandKind.STOP, CommandKind.HEARTBEAT, CommandKind.ACTIVATE})


class CommandBench:
    """directory: the rig's. remote: as CommandServer takes it. entries: all that was recorded."""

    def __init__(self, directory: Path, remote: tuple[str, Credentials] | None = None) -> None:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.directory = directory
        self.entries: list[pb.CommandEntry] = []
        self.dead = False  # the control process takes nothing
        self._ended = threading.Event()
        self._stop = StopLine(directory)
        self._mailbox = Mailbox.create(directory / "mailbox")
        self._ring = RingWriter(directory / "ring", 256, period_ns=1_000_000, metadata={})
        self._reader = RingReader(directory / "ring")
        self._records = RecordBuilder(1)
        self._server = CommandServer(directory / "commands", remote)
        self._gateway = Gateway(EXPIRY_S, directory / "stop", self.entries.append)
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
                self._gateway.take(request, self._mailbox, now_ns, "READY")
            self._gateway.give_up(now_ns, "READY")
            time.sleep(0.002)

    def _tick(self, now_ns: int) -> None:
        if self.dead:
            return
        commands: list[tuple[OperatorCommand, bool]] = [(c, c.kind in ACCEPTED) for c in self._mailbox.poll()]
        pressed = self._stop.pressed()
        state = State.ESTOP if pressed else State.READY
        put_tick(self._records, bare_tick(0, now_ns, flags=ESTOP * pressed), state)
        self._ring.append(self._records.traffic(commands, [], []))
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
