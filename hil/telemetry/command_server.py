"""The sidecar's listening sockets for commands, and the connections to them.

Nothing here waits. Every bound is a constant below: connections, their age before they are of use, bytes a message,
messages a round. When a bound is reached, the connection that has been idle longest gives way, of the same address
where one address has its share. A client that opens thousands and says nothing keeps nobody else out.
"""

import contextlib
import os
import select
import socket
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from google.protobuf.message import DecodeError

from hil.live.mapped_file import Closing
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_wire import LIMIT, REPLY, REQUEST, WireError, challenge, frame, opened, peer, seal, unframe
from hil.telemetry.credentials import OPERATOR, Credentials, identity

CONNECTIONS = 64  # on each socket
PER_ADDRESS = 16  # of them
ACCEPTS = 64  # a round
BACKLOG = 1024  # waiting to be accepted
FIRST_WORD_NS = 2_000_000_000  # for TLS and a first request
IDLE_NS = 10_000_000_000


class Asked(NamedTuple):
    """A request. refusal: why it is refused whatever it asks for; empty when it is not."""

    connection: "Connection"
    request: pb.CommandRequest
    refusal: str

    @property
    def who(self) -> str:
        """Who asks."""
        return self.connection.who


class Connection:
    """One peer. who: its name for the record. refusal: why it may ask for nothing; empty where it may."""

    def __init__(self, peer_socket: socket.socket, who: str, address: str, secret: bytes, now_ns: int) -> None:
        self._socket = peer_socket
        self.who = who
        self.address = address
        self.refusal = ""
        self.open = True
        self.closed_because = ""  # where it never got as far as to ask
        self.heard_ns = now_ns
        self.last_sequence = 0
        self.upload = b""  # the parts of a task so far
        self.waiting = False  # for the reply to its request
        self.spoke = False
        self._secret = secret
        self._nonce = b""
        self._buffer = bytearray()
        self._ready = not isinstance(peer_socket, ssl.SSLSocket)
        if self._ready:
            self._send_challenge(now_ns)

    def await_word(self, seconds: float) -> None:
        """Rest for so long, or until it says something."""
        buffered = isinstance(self._socket, ssl.SSLSocket) and self._socket.pending()
        if self.waiting:
            time.sleep(seconds)
        elif not buffered:
            select.select([self._socket], [], [], seconds)

    def overdue(self, now_ns: int) -> bool:
        """It has been of no use for too long."""
        return not self.waiting and now_ns - self.heard_ns > (IDLE_NS if self.spoke else FIRST_WORD_NS)

    def poll(self, now_ns: int) -> Asked | None:
        """Go on with TLS, or take one request. Closes the connection at the peer's end, or at nonsense."""
        try:
            if not self._ready:
                self._shake_hands(now_ns)
                return None
            return None if self.waiting else self._receive(now_ns)
        except (ssl.SSLWantReadError, ssl.SSLWantWriteError, BlockingIOError):
            return None
        except (OSError, WireError, DecodeError) as error:
            self.close(str(error))
            return None

    def _shake_hands(self, now_ns: int) -> None:
        assert isinstance(self._socket, ssl.SSLSocket)
        self._socket.do_handshake()
        found = identity(self._socket.getpeercert())
        self.who = f"certificate {found.name!a}, role {found.role!a}, from {self.address}"
        if found.role != OPERATOR:
            self.refusal = f"not authorised: the certificate's role is {found.role!a}, not '{OPERATOR}'"
        self._ready = True
        self._send_challenge(now_ns)

    def _send_challenge(self, now_ns: int) -> None:
        first = challenge(now_ns)
        self._nonce = first.nonce
        self._send(first.SerializeToString())

    def _receive(self, now_ns: int) -> Asked | None:
        received = self._socket.recv(LIMIT)
        if not received:
            self.close("")
            return None
        self._buffer += received
        message = unframe(self._buffer)
        if message is None:
            return None
        self.heard_ns = now_ns
        self.spoke = self.waiting = True
        body = opened(message, REQUEST, self._nonce, self._secret)
        if body is None:
            return Asked(self, pb.CommandRequest(), self.refusal or "not authorised: the message's MAC is wrong")
        return Asked(self, pb.CommandRequest.FromString(body), self.refusal)

    def answer(self, reply: pb.CommandReply) -> None:
        """Reply to the request that waits, with the next challenge."""
        following = challenge(reply.now_ns)
        reply.challenge.CopyFrom(following)
        self.waiting = False
        self.heard_ns = max(self.heard_ns, reply.now_ns)  # silence counts from here: a task takes long to get ready
        self._send(seal(reply.SerializeToString(), REPLY, self._nonce, self._secret))
        self._nonce = following.nonce

    def _send(self, message: bytes) -> None:
        data = frame(message)
        with contextlib.suppress(OSError):  # a peer that does not read, or is gone, loses its connection
            if self._socket.send(data) == len(data):
                return
        self.close("does not read")

    def close(self, reason: str) -> None:
        """Close; idempotent. reason: for the log, where the peer never got as far as to ask."""
        if self.open:
            self.open = False
            self.closed_because = reason if not self._ready else ""
            self._socket.close()


class Listener:
    """One listening socket and its connections."""

    def __init__(self, listening: socket.socket, admit: Callable[[socket.socket, str, int], Connection | None]) -> None:
        self._listening = listening
        self._admit = admit
        self.connections: list[Connection] = []

    def poll(self, now_ns: int) -> tuple[list[Asked], list[Connection]]:
        """New requests, and connections that ended in this round."""
        self._accept(now_ns)
        asked = [request for connection in self.connections if (request := connection.poll(now_ns))]
        for connection in self.connections:
            if connection.overdue(now_ns):
                connection.close("said nothing")
        ended = [connection for connection in self.connections if not connection.open]
        self.connections = [connection for connection in self.connections if connection.open]
        return asked, ended

    def _accept(self, now_ns: int) -> None:
        for _ in range(ACCEPTS):
            try:
                accepted, address = self._listening.accept()
            except OSError:  # none waits, or there are no descriptors left
                return
            accepted.setblocking(False)
            connection = self._admit(accepted, str(address[0]) if address else "", now_ns)
            if connection:
                self._make_room(connection.address)
                self.connections.append(connection)

    def _make_room(self, address: str) -> None:
        waiting = [connection for connection in self.connections if connection.open and not connection.waiting]
        neighbours = [connection for connection in waiting if connection.address == address]
        crowded = neighbours if len(neighbours) >= PER_ADDRESS else waiting
        if len(neighbours) >= PER_ADDRESS or len(self.connections) >= CONNECTIONS:
            if crowded:
                min(crowded, key=lambda connection: (connection.spoke, connection.heard_ns)).close("gave way")
            self.connections = [connection for connection in self.connections if connection.open]

    def close(self) -> None:
        """Close everything."""
        self._listening.close()
        for connection in self.connections:
            connection.close("")


class CommandServer(Closing):
    """Commands on this machine through the Unix socket at `path`; from elsewhere only where `remote` says so.

    remote: where to listen ("host:port") and as whom. Raises OSError, CredentialsError.
    """

    def __init__(self, path: Path, remote: tuple[str, Credentials] | None = None) -> None:
        self.path = path
        self._listeners = [Listener(_listen_locally(path), _admit_local)]
        self._inode = os.stat(path).st_ino
        if remote:
            self._listeners.append(_remote_listener(*remote))

    def poll(self, now_ns: int) -> tuple[list[Asked], list[Connection]]:
        """One round: new requests, and connections that ended."""
        rounds = [listener.poll(now_ns) for listener in self._listeners]
        return [request for asked, _ in rounds for request in asked], [c for _, ended in rounds for c in ended]

    def close(self) -> None:
        """Stop listening; the socket's file goes."""
        for listener in self._listeners:
            listener.close()
        with contextlib.suppress(OSError):
            if os.stat(self.path).st_ino == self._inode:
                self.path.unlink()


def _listen_locally(path: Path) -> socket.socket:
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    directory = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)  # paths of sockets must be short
    try:
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        listening.bind(f"/proc/self/fd/{directory}/{path.name}")
        path.chmod(0o600)
        listening.listen(BACKLOG)
    except OSError as error:
        listening.close()
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        os.close(directory)
    return listening


def _admit_local(accepted: socket.socket, _address: str, now_ns: int) -> Connection | None:
    pid, uid = peer(accepted)
    connection = Connection(accepted, f"uid {uid} (pid {pid})", f"uid {uid}", b"", now_ns)
    if uid not in (os.geteuid(), 0):
        connection.refusal = f"not authorised: uid {uid} is neither the sidecar's user {os.geteuid()} nor root"
    return connection


def _remote_listener(where: str, credentials: Credentials) -> Listener:
    host, _, port = where.rpartition(":")
    context, secret = credentials.context(server=True), credentials.secret

    def admit(accepted: socket.socket, address: str, now_ns: int) -> Connection | None:
        try:
            secured = context.wrap_socket(accepted, server_side=True, do_handshake_on_connect=False)
        except OSError:  # it is gone already
            accepted.close()
            return None
        return Connection(secured, f"somebody at {address}", address, secret, now_ns)

    listening = socket.create_server((host.strip("[]"), int(port)), backlog=BACKLOG)
    listening.setblocking(False)
    return Listener(listening, admit)
