"""`hil sidecar`: everything around the control process that may wait, fail or restart without disturbing it.

Drains the ring; publishes on Zenoh; records; hands authorised commands on. It may start before or after the control
process, and outlives any number of them: each gets a recording of its own.
"""

import itertools
import json
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from drivers.runtime import stop_signals, write_private
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cycle.event_table import KINDS, REFUSED_ACTION, Kind
from hil.cycle.tick import CommandKind
from hil.live import stop_page
from hil.live.mailbox import Mailbox, MailboxError
from hil.live.notes import read_problems
from hil.live.ring import RingError, RingReader
from hil.live.ring_events import RingEvents
from hil.live.runtime_paths import AlreadyServedError, RuntimePaths, runtime_paths, sole
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.telemetry import codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.blackbox import run_directory, save_black_boxes
from hil.telemetry.command_server import CommandServer
from hil.telemetry.credentials import Credentials, CredentialsError
from hil.telemetry.event_log import EventLog, own_event
from hil.telemetry.gateway import Gateway
from hil.telemetry.publisher import ListenError, Publisher
from hil.telemetry.recorder import Recorder
from hil.telemetry.window import Window

STATUS_NS = 100_000_000
DRAINED = 512  # ticks a round
NOTED = 32  # entries on commands a round
MAX_PERIOD = 0.1  # s; commands and the recorder's sign of life do not wait longer
SEE_OFF_S = 1.0  # how long a sidecar that is to end waits for a control process to end before it


class Attached:
    """One control process's ring and mailbox, followed from its first tick that is still there to its end."""

    def __init__(self, reader: RingReader, mailbox: Mailbox | None, recorder: Recorder | None, notes: Path) -> None:
        self.reader = reader
        self.mailbox = mailbox
        self.recorder = recorder
        self.metadata = reader.metadata
        rig = self.metadata["rig"]
        self.axes = list(rig["axes"])
        self.units = ["m" if axis["kind"] == "linear" else "rad" for axis in rig["axes"].values()]
        self.law = str(rig["law"]["name"])
        self.told = RingEvents(reader, notes)
        self.window = Window(max(1, round(1e9 / max(reader.period_ns, 1))), len(self.axes))
        self.batches = self.sent = self.dropped = 0
        self.lost = 0  # since the last batch
        self.caught_up = False  # the window is the present: the last round read the ring to its end
        self.recorder_errors = 0  # told
        self.over = False  # the control process is gone, and all it left is safe

    def close(self) -> None:
        """Finish the recording and let go of the files."""
        if self.recorder:
            self.recorder.close()
        if self.mailbox:
            self.mailbox.close()
        self.reader.close()


class Sidecar:
    """The loop's body. rig: for keys; what is published about a run, and why it refuses, comes from its ring."""

    def __init__(
        self, rig: RigConfig, paths: RuntimePaths, publisher: Publisher, commands: CommandServer, out: Path | None
    ) -> None:
        self.rig = rig
        self._paths = paths
        self._publisher = publisher
        self._commands = commands
        stop = paths.directory / stop_page.NAME
        self._gateway = Gateway(rig, stop, self._note_command, lambda: read_problems(paths.notes), paths.task)
        self._noted = 0  # entries of this round
        self._events = EventLog(rig.name, publisher)
        self._out = out
        self._status_due_ns = 0
        self._seen_run = -1
        self.attached: Attached | None = None
        self.status = pb.Status(rig=rig.name)

    def step(self, now_ns: int) -> None:
        """One round: new ticks, commands, status."""
        self._follow()
        alive = self.control_alive
        if not self._drain(now_ns) and not alive:
            self._conclude(now_ns)
        self._serve(now_ns, alive)
        if now_ns >= self._status_due_ns:
            self._status_due_ns = now_ns + STATUS_NS
            self.publish_status(now_ns)

    def _follow(self) -> None:
        """Attach to a control process that started; leave one whose ring was replaced."""
        current = self.attached
        if current and not current.reader.replaced:
            return
        try:
            reader = RingReader(self._paths.ring)
        except RingError:
            return
        if reader.run_id == self._seen_run or not reader.writer_alive:
            reader.close()
            return
        self._leave()
        self._seen_run = reader.run_id
        self._gateway.follow(reader.metadata)
        recorder = self._events.recorder = self._new_recorder(reader)
        self.attached = Attached(reader, self._open_mailbox(), recorder, self._paths.notes)
        now_ns = time.monotonic_ns()
        self._events.own(now_ns, own_event(Kind.SIDECAR, f"follows control process {reader.pid}", now_ns))

    def _open_mailbox(self) -> Mailbox | None:
        try:
            return Mailbox(self._paths.mailbox)
        except MailboxError:
            return None

    def _new_recorder(self, reader: RingReader) -> Recorder | None:
        if self._out is None:
            return None
        names = (self._out / f"run{f'-{number}' if number > 1 else ''}.mcap" for number in itertools.count(1))
        return Recorder(next(path for path in names if not path.is_file()), reader.metadata)  # nobody's earlier one

    def _leave(self) -> None:
        if self.attached:
            while self._drain(time.monotonic_ns()):
                pass
            if not self.attached.reader.writer_alive:
                self._conclude(time.monotonic_ns())
            if not self.attached.over:
                self._events.tell(self.attached.told.close())
            self._gateway.give_up(time.monotonic_ns(), self.attached.window.state, everything=True)
            self.publish_status(time.monotonic_ns())
            self.attached.close()
            self.attached = self._events.recorder = None

    def _conclude(self, now_ns: int) -> None:
        """The control process is gone and its ring is drained: finish the recording, or leave the black box be."""
        run = self.attached
        if run is None or run.over:
            return
        run.over = True
        self._events.tell(run.told.close())
        fate = "ended" if run.reader.ended else "was killed"
        why = () if run.reader.ended else ("it did not end by itself", "hil blackbox RIG, once this sidecar is gone")
        self._events.own(now_ns, own_event(Kind.SIDECAR, f"control process {run.reader.pid} {fate}", now_ns, *why))
        self.publish_status(now_ns)
        if run.recorder and run.recorder.ok:
            run.recorder.close()
            run.reader.mark_saved()

    def _drain(self, now_ns: int) -> bool:
        """Publish and record what is new; False when there was nothing."""
        run = self.attached
        if run is None:
            return False
        if run.recorder and run.recorder.ok and run.mailbox:
            run.mailbox.beat_recorder(now_ns)
        written = run.reader.written
        batch = run.reader.read(DRAINED)
        run.lost += batch.lost
        run.dropped += batch.lost
        records = batch.records
        # Not "fewer than asked for": of a full ring, the writer overtakes some of the first while they are copied.
        # Not for good either: a sidecar that was held up has old states to read first.
        run.caught_up = run.reader.next >= written
        if not len(records):
            return False
        message = codec.telemetry(records, len(run.axes), batch=run.batches, first=batch.first, lost=run.lost)
        data = message.SerializeToString()
        run.lost = 0
        run.batches += 1
        if self._publisher.put("telemetry", data):
            run.sent += len(records)
        else:
            run.dropped += len(records)
        if run.recorder:
            at = int(records["now_ns"][-1])
            run.recorder.write("telemetry", at, data)
            run.recorder.write("traffic", at, codec.traffic(records, first=batch.first).SerializeToString())
        self._events.tell(run.told.tell(batch))
        run.window.add(records)
        self._gateway.verdicts(records, batch.first, now_ns)
        return True

    def _serve(self, now_ns: int, alive: bool) -> None:
        run = self.attached
        state = run.window.state_at(now_ns) if run and run.caught_up else "-"
        if run and (run.mailbox is None or run.mailbox.replaced):
            run.mailbox = self._open_mailbox()
        self._noted = 0
        asked, ended = self._commands.poll(now_ns)
        for connection in ended:
            if connection.closed_because:
                self._gateway.note_rejected(connection.who, connection.closed_because, now_ns)
        mailbox = run.mailbox if run and alive else None
        last = run.window.last if run and run.caught_up else None
        for request in asked:
            self._gateway.take(request, mailbox, now_ns, state, last)
        self._gateway.advance(mailbox, now_ns, state)
        self._gateway.give_up(now_ns, state, everything=not alive)
        self._publisher.answer_queries({"rig": self._description, "events": self._events.history})
        self._events.turn(now_ns)

    def _note_command(self, entry: pb.CommandEntry) -> None:
        """To the recording and, for the journal, to standard output; of a flood only the first of each round."""
        self._noted += 1
        if self._noted > NOTED:
            return
        if self.attached and self.attached.recorder:
            self.attached.recorder.write("commands", entry.when_ns, entry.SerializeToString())
        if entry.kind != CommandKind.HEARTBEAT or not entry.accepted:
            name = CommandKind(entry.kind).name if entry.kind in set(CommandKind) else f"command {entry.kind}"
            verdict = "accepted" if entry.accepted else f"refused: {entry.reason}"
            print(f"{entry.who}: {name}: {verdict}; state {entry.state or '-'}", flush=True)
            if not entry.accepted:
                cause = f"{entry.reason}; asked by {entry.who}; the state is {entry.state or 'not known'}"
                self._events.tell([own_event(Kind.REQUEST, f"{name} refused", entry.when_ns, cause, REFUSED_ACTION)])

    def _description(self) -> bytes:
        """Which rig this is: the whole of it, as JSON."""
        run = self.attached
        return json.dumps(run.metadata if run else {"rig": self.rig.model_dump(mode="json")}).encode()

    def publish_status(self, now_ns: int) -> None:
        """Ten times a second, and once more at every end."""
        status = pb.Status(rig=self.rig.name, now_ns=now_ns)
        if run := self.attached:
            status.rig_hash = run.metadata["rig_hash"]
            status.realtime = run.metadata.get("realtime", "")
            status.axes.extend(run.axes)
            status.units.extend(run.units)
            status.law = run.law
            status.period_ns = run.reader.period_ns
            status.pid = run.reader.pid
            status.control_alive = run.reader.writer_alive
            status.control_ended = run.reader.ended
            if run.reader.writer_alive:
                status.drive_problems.extend(read_problems(self._paths.notes))
            status.produced = run.reader.written
            status.sent, status.dropped = run.sent, run.dropped
            if run.caught_up:
                run.window.fill(status)
            if run.recorder:
                status.recording = run.recorder.ok
                self._watch_recorder(run, now_ns)
                status.recorder_errors = run.recorder.errors
                status.recording_path = str(run.recorder.path)
        data = status.SerializeToString()
        self._publisher.put("status", data)
        if self.attached and self.attached.recorder:
            self.attached.recorder.write("status", now_ns, data)
        self.status = status

    def _watch_recorder(self, run: Attached, now_ns: int) -> None:
        """Tell once that a recording has failed."""
        recorder = run.recorder
        if recorder and recorder.errors > run.recorder_errors:
            event = own_event(Kind.RECORDER, f"cannot write {recorder.path}", now_ns, KINDS[Kind.RECORDER].cause)
            self._events.own(now_ns, event._replace(value=float(recorder.errors), limit=0.0))
            run.recorder_errors = recorder.errors

    @property
    def control_alive(self) -> bool:
        """A control process writes what is drained here."""
        return self.attached is not None and self.attached.reader.writer_alive

    def close(self) -> None:
        """Drain to the end, finish the recording."""
        self._leave()


class _StopFlag:
    """Set by SIGTERM, SIGINT or SIGHUP; `pause` returns at once when it is."""

    def __init__(self) -> None:
        self.set = False
        for number in stop_signals():
            signal.signal(number, self._stop)

    def _stop(self, *_: object) -> None:
        self.set = True


def _listening(rig: RigConfig, listen: list[str], credentials: Credentials | None, or_free_port: bool) -> Publisher:
    """A publisher on the endpoints wanted, or else on a free port where that is allowed. Raises ListenError."""
    try:
        return Publisher(rig.telemetry.key, rig.name, listen, credentials)
    except ListenError:
        if not or_free_port:
            raise
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    return Publisher(rig.telemetry.key, rig.name, [f"tcp/127.0.0.1:{port}"], credentials)


class Outside(NamedTuple):
    """What of a sidecar is open to other machines. commands: "host:port"; empty: none may command."""

    commands: str = ""
    credentials: Credentials | None = None


def serve(rig: RigConfig, out: Path | None, listen: list[str], outside: Outside, *, or_free_port: bool = False) -> None:
    """Run until told to stop by a signal. Raises ListenError, CredentialsError, OSError."""
    stop = _StopFlag()
    paths = runtime_paths(rig.name)
    period = min(1.0 / rig.telemetry.publish_hz, MAX_PERIOD)
    remote = (outside.commands, outside.credentials) if outside.commands and outside.credentials else None
    with (
        _listening(rig, listen, outside.credentials, or_free_port) as publisher,
        CommandServer(paths.commands, remote) as commands,
    ):
        write_private(paths.endpoint, publisher.listen[0])
        write_private(paths.access, json.dumps({"watch": publisher.listen, "commands": outside.commands}))
        sidecar = Sidecar(rig, paths, publisher, commands, out)
        print(f"sidecar of {rig.name}: listening on {', '.join(publisher.listen)}", flush=True)
        try:
            while not stop.set:
                sidecar.step(time.monotonic_ns())
                time.sleep(period)
            # Whoever ends both at once, as a demo that is killed does, still gets the stop in the recording.
            patience = time.monotonic() + SEE_OFF_S
            while sidecar.control_alive and time.monotonic() < patience:
                sidecar.step(time.monotonic_ns())
                time.sleep(period)
        finally:
            sidecar.close()
            paths.endpoint.unlink(missing_ok=True)
            paths.access.unlink(missing_ok=True)


@contextmanager
def _recordings(out: Path | None) -> Iterator[Path]:
    """Where recordings go: `out`, or a new directory, which is gone again if none was made."""
    directory = out or run_directory()
    try:
        yield directory
    finally:
        if out is None:
            with suppress(OSError):  # it holds something
                directory.rmdir()


def sidecar(
    rig: Annotated[Path, typer.Argument(help="rig file")],
    out: Annotated[Path | None, typer.Option(help="directory for recordings [runs/<time>]")] = None,
    listen: Annotated[str | None, typer.Option(help="Zenoh endpoint instead of the rig file's")] = None,
    or_free_port: Annotated[bool, typer.Option("--or-free-port", help="else on any free port of loopback")] = False,
    set_: Annotated[list[str] | None, typer.Option("--set", help="key=value over the rig file")] = None,
    credentials: Annotated[Path | None, typer.Option(help="directory, for TLS (see deploy/zenoh)")] = None,
    commands_from: Annotated[str, typer.Option(help="host:port where other machines' operators may command")] = "",
) -> None:
    """Publish, record and take commands for a control process. Ends on SIGTERM, SIGINT or SIGHUP."""
    config = load_rig(rig, set_ or ())
    paths = runtime_paths(config.name)
    if commands_from and credentials is None:
        raise typer.BadParameter("needs --credentials", param_hint="--commands-from")
    try:
        outside = Outside(commands_from, Credentials(credentials) if credentials else None)
        recordings = _recordings(out) if config.telemetry.record else nullcontext()
        with sole(paths, "sidecar"), recordings as directory:
            for saved in save_black_boxes(paths, directory or out):
                print(f"a control process was killed earlier; its last ticks are in {saved}", flush=True)
            endpoints = [listen] if listen else list(config.telemetry.listen)
            serve(config, directory, endpoints, outside, or_free_port=or_free_port)
    except (ListenError, AlreadyServedError, CredentialsError) as error:
        print(f"hil sidecar: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
