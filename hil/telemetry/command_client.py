"""Commands to a rig and what became of them: on this machine through its Unix socket, from elsewhere over TLS.

On this machine the verdict is read from the control process' own record in the ring: a sidecar, or whatever has taken
its place, that says anything else is caught. From elsewhere the reply carries the MAC of the secret's holder.
"""

import contextlib
import errno
import os
import socket
import time
import zlib
from pathlib import Path
from typing import NamedTuple, TypeVar

from google.protobuf.message import DecodeError

from drivers.base.runtime import make_private
from drivers.base.text_file import words_of
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mapped_file import Closing
from hil.live.ring import RingError, RingReader
from hil.rig.file import build_rig
from hil.rig.schema import RigConfig
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_wire import LIMIT, PART, REPLY, REQUEST, WireError, frame, opened, peer, seal, unframe
from hil.telemetry.credentials import SIDECAR, Credentials, identity
from hil.telemetry.window import silent_axes

COMMAND_LIFE_NS = 300_000_000
_RETRY_S = 0.01
REPLY_S = 0.9  # the gateway waits half a second for the control process
TASK_S = 65.0  # longer than task_loader.PATIENCE_NS
_M = TypeVar("_M", pb.Challenge, pb.CommandReply)


class NoGatewayError(Exception):
    """Nobody took the command, or nobody who can be believed answered; the text says what is known."""


class Verdict(NamedTuple):
    """What the control process made of a command. state: after it; "-": not known."""

    accepted: bool
    reason: str
    state: str


class CommandClient(Closing):
    """One connection to a gateway. Raises NoGatewayError."""

    def __init__(self, connection: socket.socket, secret: bytes, ring: Path | None) -> None:
        self._socket = connection
        self._secret = secret
        self._ring = ring
        self._buffer = bytearray()
        self._sequence = 0
        connection.settimeout(REPLY_S)
        self._challenge = self._parse(pb.Challenge, self._receive())
        self._challenged_ns = time.monotonic_ns()

    def load_task(self, document: str) -> Verdict:
        """Ask for another task, a [task] as JSON, and wait until it is loaded or refused. Raises NoGatewayError."""
        return self._load(CommandKind.LOAD_TASK, document)

    def set_law(self, document: str) -> Verdict:
        """Ask for another law, a [law] as JSON, and wait until it is set or refused. Raises NoGatewayError."""
        return self._load(CommandKind.SET_LAW, document)

    def _load(self, kind: CommandKind, document: str) -> Verdict:
        data = zlib.compress(document.encode())
        parts = [data[at : at + PART] for at in range(0, len(data), PART)]
        for part in parts[:-1]:
            verdict = self.command(kind, part, more=True)
            if not verdict.accepted:
                return verdict
        return self.command(kind, parts[-1], patience_s=TASK_S)

    def command(
        self, kind: CommandKind, task: bytes = b"", *, more: bool = False, patience_s: float = REPLY_S
    ) -> Verdict:
        """Ask, and wait for the verdict. task: a part of what LOAD_TASK and SET_LAW load. Raises NoGatewayError."""
        reply = self._ask(pb.CommandRequest(kind=kind, task=task, more=more), patience_s)
        return self._verified(kind, reply) if self._ring and reply.tick else _told(reply)

    def goal(self, request: pb.GoalRequest) -> pb.CommandReply:
        """Ask to move (hil/telemetry/goal_gateway.py); the gateway's word on it. Raises NoGatewayError."""
        return self._ask(pb.CommandRequest(goal=request), REPLY_S)

    def _ask(self, request: pb.CommandRequest, patience_s: float) -> pb.CommandReply:
        self._sequence += 1
        now_ns = self._challenge.now_ns + time.monotonic_ns() - self._challenged_ns  # on the rig's clock
        request.sequence, request.expires_ns = self._sequence, now_ns + COMMAND_LIFE_NS
        nonce = self._challenge.nonce
        try:
            self._socket.sendall(frame(seal(request.SerializeToString(), REQUEST, nonce, self._secret)))
        except OSError as error:
            raise NoGatewayError(f"the gateway closed the connection: {error}") from None
        body = self._open(self._receive(patience_s), nonce)
        reply = self._parse(pb.CommandReply, body)
        if reply.sequence != self._sequence and reply.accepted:
            raise NoGatewayError("the reply belongs to another request")
        self._challenge, self._challenged_ns = reply.challenge, time.monotonic_ns()
        return reply

    def rig(self) -> RigConfig:
        """The rig that the control process runs; from elsewhere it is not known. Raises NoGatewayError, RigError."""
        if self._ring is not None:
            with contextlib.suppress(RingError), RingReader(self._ring) as reader:
                return build_rig(dict(reader.metadata["rig"]), carried=True)
        raise NoGatewayError("no control process whose rig could be read")

    def silent(self) -> str:
        """Axes that have not answered for long, by the newest tick's record, in words; from elsewhere nothing."""
        if self._ring is None:
            return ""
        with contextlib.suppress(RingError), RingReader(self._ring) as reader:
            reader.next = max(reader.written - 1, 0)
            records = reader.read(1, ("age_ticks",)).records
            if len(records):
                ages_s = records[-1]["age_ticks"] * (reader.period_ns * 1e-9)
                return silent_axes(reader.metadata["rig"]["axes"], ages_s.tolist())
        return ""

    def _verified(self, kind: CommandKind, reply: pb.CommandReply) -> Verdict:
        """The same from the control process' own record."""
        assert self._ring is not None
        try:
            with RingReader(self._ring) as reader:
                reader.next = reply.tick - 1
                records = reader.read(1, ("state", "flags", "n_commands", "commands")).records
        except RingError as error:
            raise NoGatewayError(f"the control process' record cannot be read: {error}") from None
        if not len(records):
            raise NoGatewayError("the gateway names a tick that is not in the control process' record")
        record = records[0]
        state = State(int(record["state"])).name
        if kind is CommandKind.ESTOP:
            return Verdict(state == "ESTOP", "" if state == "ESTOP" else "the record says otherwise", state)
        for command in record["commands"][: record["n_commands"]]:
            if (int(command["sequence"]), int(command["kind"])) == (reply.posted, kind):
                accepted = bool(command["accepted"])
                return Verdict(accepted, "" if accepted else reply.reason or "refused", state)
        raise NoGatewayError("the gateway names a tick whose record does not hold the command")

    def _receive(self, patience_s: float = REPLY_S) -> bytes:
        until = time.monotonic() + patience_s
        self._socket.settimeout(patience_s)
        try:
            while (message := unframe(self._buffer)) is None:
                received = self._socket.recv(LIMIT)
                if not received:
                    raise NoGatewayError("the gateway closed the connection without an answer")
                if time.monotonic() > until:
                    raise TimeoutError
                self._buffer += received
        except TimeoutError:
            raise NoGatewayError(f"the gateway has not answered within {patience_s:g} s: the sidecar hangs") from None
        except (OSError, WireError) as error:
            raise NoGatewayError(f"the gateway refused the connection: {error}") from None
        return message

    def _open(self, message: bytes, nonce: bytes) -> bytes:
        try:
            body = opened(message, REPLY, nonce, self._secret)
        except DecodeError:
            body = None
        if body is None:
            raise NoGatewayError("the reply is not authentic: its MAC is wrong")
        return body

    @staticmethod
    def _parse(kind: type[_M], data: bytes) -> _M:
        try:
            return kind.FromString(data)
        except DecodeError:
            raise NoGatewayError("the gateway's answer makes no sense") from None

    def close(self) -> None:
        """Leave."""
        self._socket.close()


def _told(reply: pb.CommandReply) -> Verdict:
    return Verdict(reply.accepted, reply.reason, reply.state or "-")


def local_client(directory: Path) -> CommandClient:
    """To the sidecar of the rig whose runtime directory this is. Raises NoGatewayError, RuntimeDirectoryError."""
    make_private(directory)  # nobody else can have put a socket there
    path, ring = directory / "commands", directory / "ring"
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(REPLY_S)
    handle = os.open(directory, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)  # paths of sockets must be short
    try:
        _connect(connection, f"/proc/self/fd/{handle}/{path.name}")
        _, uid = peer(connection)
        if uid not in (os.stat(directory).st_uid, 0):
            raise NoGatewayError(f"{path}: user {uid} listens there, who does not own it")
        return CommandClient(connection, b"", ring)
    except OSError as error:
        connection.close()
        nobody = error.errno in (errno.ENOENT, errno.ECONNREFUSED)
        why = "no sidecar listens there" if nobody else words_of(error)
        raise NoGatewayError(f"{path}: {why}; `hil sidecar FILE` starts one, as this user") from None
    except NoGatewayError:
        connection.close()
        raise
    finally:
        os.close(handle)


def _connect(connection: socket.socket, address: str) -> None:
    """Where more wait than the kernel keeps, a Unix socket refuses at once instead of waiting: ask again."""
    until = time.monotonic() + REPLY_S
    while True:
        try:
            connection.connect(address)
        except BlockingIOError:
            if time.monotonic() > until:
                raise
            time.sleep(_RETRY_S)
        else:
            return


def remote_client(where: str, credentials: Credentials) -> CommandClient:
    """To a sidecar elsewhere. where: "host:port". Raises NoGatewayError, CredentialsError."""
    host, _, port = where.rpartition(":")
    context, secret = credentials.context(server=False), credentials.secret
    try:
        plain = socket.create_connection((host.strip("[]"), int(port)), timeout=REPLY_S)
        connection = context.wrap_socket(plain)
    except (OSError, ValueError) as error:
        raise NoGatewayError(f"{where}: {error}") from None
    found = identity(connection.getpeercert())
    if found.role != SIDECAR:
        connection.close()
        raise NoGatewayError(f"{where}: {found.name!a} answers, whose role is {found.role!a}, not '{SIDECAR}'")
    try:
        return CommandClient(connection, secret, None)
    except NoGatewayError:
        connection.close()
        raise
