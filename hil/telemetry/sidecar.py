"""`hil sidecar`: everything around the control process that may wait, fail or restart without disturbing it.

Drains the ring; publishes on Zenoh; records; hands authorised commands on. It may start before or after the control
process, and outlives any number of them: each gets a recording of its own.
"""

import faulthandler
import json
import signal
import socket
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from mcap_protobuf.schema import build_file_descriptor_set

from drivers.base.runtime import stop_signals, write_private
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cycle.tick import CommandKind
from hil.events.notes import read_problems, read_tip
from hil.live import stop_page
from hil.live.mailbox import Mailbox, MailboxError
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import AlreadyServedError, RuntimePaths, runtime_paths, sole
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.attached import Attached
from hil.telemetry.blackbox import recordings_in, save_black_boxes
from hil.telemetry.cell_watch import CellWatch
from hil.telemetry.codec import Records
from hil.telemetry.command_server import CommandServer
from hil.telemetry.credentials import Credentials, CredentialsError
from hil.telemetry.event_log import EventLog
from hil.telemetry.gateway import Gateway
from hil.telemetry.goal_gateway import GoalGateway
from hil.telemetry.publisher import ListenError, Publisher
from hil.telemetry.run_recorder import Limits, RunRecorder, Store
from hil.telemetry.sidecar_progress import ProgressFile
from hil.telemetry.tick_schema import TickSchema

PROGRESS = "progress"  # file in the rig's runtime directory
STATUS_NS = 100_000_000
MOTION_NS = 20_000_000
DRAINED = 512  # ticks a round
NOTED = 32  # entries on commands a round
MAX_PERIOD = 0.1  # s; commands and the recorder's sign of life do not wait longer
SEE_OFF_S = 1.0  # how long a sidecar that is to end waits for a control process to end before it


class Sidecar:
    """The loop's body. rig: for keys; what is published about a run, and why it refuses, comes from its ring."""

    def __init__(
        self, rig: RigConfig, paths: RuntimePaths, publisher: Publisher, commands: CommandServer, store: Store | None
    ) -> None:
        self.rig = rig
        self._paths = paths
        self._publisher = publisher
        self._commands = commands
        stop = paths.directory / stop_page.NAME
        self._goals = GoalGateway(paths.goals, self._note_lease)
        self._gateway = Gateway(
            rig, stop, self._note_command, lambda: read_problems(paths.notes), paths.task, self._goals
        )
        self._goals.tell = self.motion
        self._noted = 0  # entries of this round
        self._events = EventLog(rig.name, publisher, paths.notes)
        self._store = store
        self._progress = ProgressFile(paths.directory / PROGRESS)
        self._status_due_ns = self._motion_due_ns = 0
        self._seen_run = -1
        self.attached: Attached | None = None
        self.status = pb.Status(rig=rig.name)

    def step(self, now_ns: int) -> None:
        """One round: new ticks, commands, status."""
        self._follow()
        alive = self.control_alive
        if not self._drain(now_ns) and not alive:
            self._conclude(now_ns)
        if self.attached and not self.attached.over:
            self.attached.record(now_ns)
        self._serve(now_ns, alive)
        if now_ns >= self._status_due_ns:
            self._status_due_ns = now_ns + STATUS_NS
            self.publish_status(now_ns)
        if now_ns >= self._motion_due_ns:
            self._motion_due_ns = now_ns + MOTION_NS
            if self.attached and self._publisher.wanted("motion"):
                self._publisher.put("motion", self.motion(now_ns).SerializeToString())

    def _follow(self) -> None:
        """Attach to a control process that started; leave one whose ring was replaced."""
        current = self.attached
        if current and not current.reader.replaced:
            return
        try:
            reader = RingReader(self._paths.ring)
        except RingError:
            return
        progress = self._progress.read(reader.run_id)
        # A control process that ended while no sidecar ran may have left ticks that no recording has.
        done = min(progress.published, progress.recorded) if self._store else progress.published
        unfinished = progress.published > 0 and done < reader.written
        if reader.run_id == self._seen_run or not (reader.writer_alive or unfinished):
            reader.close()
            return
        self._leave()
        self._seen_run = reader.run_id
        self._gateway.follow(reader.metadata)
        limits, save = Limits.of(self.rig.telemetry), self._progress.write
        recorder = RunRecorder(self._store, reader, limits, progress, save) if self._store else None
        self._events.follow(reader, progress.published, recorder)
        self.attached = Attached(reader, self._open_mailbox(), progress, recorder)

    def _open_mailbox(self) -> Mailbox | None:
        try:
            return Mailbox(self._paths.mailbox)
        except MailboxError:
            return None

    def _leave(self) -> None:
        if self.attached:
            reader, written = self.attached.reader, self.attached.reader.written
            while (reader.next < written or not reader.writer_alive) and self._drain(time.monotonic_ns()):
                pass  # of one that is written as fast as it is read there is no end: the rest is the next sidecar's
            if not reader.writer_alive:
                self._conclude(time.monotonic_ns())
            self._events.leave()
            self._gateway.give_up(time.monotonic_ns(), self.attached.window.state, everything=True)
            self.publish_status(time.monotonic_ns())
            self.attached.close()
            self._progress.write(self.attached.progress)
            self.attached = None

    def _conclude(self, now_ns: int) -> None:
        """The control process is gone and its ring is drained: finish the recording, or leave the black box be."""
        run = self.attached
        if run is None or run.over:
            return
        run.over = True
        self._events.conclude(run.reader, now_ns)
        self.publish_status(now_ns)
        run.end_recording(now_ns)
        if run.progress.recorded == run.reader.written:
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
        run.dropped += batch.lost
        records = batch.records
        # Not "fewer than asked for": of a full ring, the writer overtakes some of the first while they are copied.
        # Not for good either: a sidecar that was held up has old states to read first.
        run.caught_up = run.reader.next >= written
        if not len(records):
            return False
        run.progress.published = run.reader.next
        self._progress.write(run.progress)  # before they are published: who takes over after a kill sends none again
        messages = list(run.encoder.encode(records, batch.first))
        sent = sum(self._publisher.put("tick", data) for data in messages)
        run.progress.sent += sent
        self._progress.write(run.progress)
        run.dropped += len(messages) - sent
        if run.recorder and run.snapshots:
            run.recorder.take(records, messages, batch.first)
            run.snapshots.watch(records, batch.first)
        self._events.batch(batch)
        run.window.add(records)
        if run.motion:
            run.motion.add(records)
        if run.cells:
            self._tell_cells(run.cells, records, run.recorder)
        self._gateway.verdicts(records, batch.first, now_ns)
        return True

    def _tell_cells(self, cells: CellWatch, records: Records, recorder: RunRecorder | None) -> None:
        """Every phase that a cell came to, published and recorded."""
        for told in cells.add(records):
            data = cells.tell(told).SerializeToString()
            self._publisher.put("cells", data)
            if recorder:
                recorder.write("cells", told.now_ns, data)

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
        answers = {"rig": self._description, "schema": self._schema, "events": self._events.history}
        cells = run.cells if run else None
        self._publisher.answer_queries({**answers, "cells": cells.told if cells else bytes})
        self._events.turn(now_ns)

    def _note_lease(self, who: str, what: str) -> None:
        """Who moves the rig from elsewhere, to the recording and the journal."""
        self._note_command(pb.CommandEntry(who=who, when_ns=time.monotonic_ns(), accepted=True, reason=what))

    def _note_command(self, entry: pb.CommandEntry) -> None:
        """To the recording and, for the journal, to standard output; of a flood only the first of each round."""
        self._noted += 1
        if self._noted > NOTED:
            return
        if self.attached and self.attached.recorder:
            self.attached.recorder.write("commands", entry.when_ns, entry.SerializeToString())
        if entry.kind != CommandKind.HEARTBEAT or not entry.accepted:
            known = CommandKind(entry.kind).name if entry.kind in set(CommandKind) else f"command {entry.kind}"
            name = "moving" if entry.accepted and not entry.kind else known
            verdict = (entry.reason or "accepted") if entry.accepted else f"refused: {entry.reason}"
            print(f"{entry.who}: {name}: {verdict}; state {entry.state or '-'}", flush=True)
            self._events.request(name, entry)

    def _description(self) -> bytes:
        """Which rig this is: the whole of it, as JSON."""
        run = self.attached
        return json.dumps(run.metadata if run else {"rig": self.rig.model_dump(mode="json")}).encode()

    def _schema(self) -> bytes:
        """The FileDescriptorSet of all that is published: enough to decode it without this package."""
        run = self.attached
        schema = run.encoder.schema if run else TickSchema(self.rig.model_dump(mode="json"))
        files = build_file_descriptor_set(pb.Status)
        files.MergeFrom(schema.files)
        return bytes(files.SerializeToString())

    def motion(self, now_ns: int) -> pb.Motion:
        """What the axes do, for who moves them; empty until the ring was read to its end."""
        run = self.attached
        if run is None or run.motion is None or not run.caught_up:
            return pb.Motion()
        found = run.motion.tell(now_ns, run.holder(self._paths.goals))
        self._goals.fill(found)
        return found

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
                status.tip = read_tip(self._paths.notes) if run.window.rests else ""
            status.produced = run.reader.written
            status.sent, status.dropped = run.progress.sent, run.dropped
            if run.caught_up:
                run.window.fill(status)
                if (latched := self._events.latched) and latched.name == status.fault.lower():
                    status.latched.CopyFrom(latched)
            if run.recorder:
                status.recording = run.recorder.ok
                status.recorder_errors = run.recorder.errors
                status.recording_path = run.recorder.path
        data = status.SerializeToString()
        self._publisher.put("status", data)
        if self.attached and self.attached.recorder:
            self.attached.recorder.write("status", now_ns, data)
        self.status = status

    def rest(self, seconds: float) -> None:
        """Until the next round. Who moves the rig from elsewhere is heard at once."""
        seconds = self._goals.patience(seconds)
        if (awaited := self._goals.awaited) is None:
            time.sleep(seconds)
        else:
            awaited.await_word(seconds)

    @property
    def control_alive(self) -> bool:
        """A control process writes what is drained here."""
        return self.attached is not None and self.attached.reader.writer_alive

    def close(self) -> None:
        """Drain to the end, finish the recording."""
        self._leave()
        self._progress.close()


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


def serve(
    rig: RigConfig, store: Store | None, listen: list[str], outside: Outside, *, or_free_port: bool = False
) -> None:
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
        sidecar = Sidecar(rig, paths, publisher, commands, store)
        print(f"sidecar of {rig.name}: listening on {', '.join(publisher.listen)}", flush=True)
        try:
            while not stop.set:
                sidecar.step(time.monotonic_ns())
                sidecar.rest(period)
            # Whoever ends both at once, as a demo that is killed does, still gets the stop in the recording.
            patience = time.monotonic() + SEE_OFF_S
            while sidecar.control_alive and time.monotonic() < patience:
                sidecar.step(time.monotonic_ns())
                time.sleep(period)
        finally:
            sidecar.close()
            paths.endpoint.unlink(missing_ok=True)
            paths.access.unlink(missing_ok=True)


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
    faulthandler.enable()  # a crash in native code tells the journal where
    config = load_rig(rig, set_ or ())
    paths = runtime_paths(config.name)
    if commands_from and credentials is None:
        raise typer.BadParameter("needs --credentials", param_hint="--commands-from")
    try:
        outside = Outside(commands_from, Credentials(credentials) if credentials else None)
        recordings = recordings_in(out) if config.telemetry.record else nullcontext()
        with sole(paths, "sidecar"), recordings as directory:
            for saved in save_black_boxes(paths, directory or out):
                print(f"a control process was killed earlier; its last ticks are in {saved}", flush=True)
            endpoints = [listen] if listen else list(config.telemetry.listen)
            store = Store(directory, out or directory.parent, out is not None) if directory else None
            serve(config, store, endpoints, outside, or_free_port=or_free_port)
    except (ListenError, AlreadyServedError, CredentialsError) as error:
        print(f"hil sidecar: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
