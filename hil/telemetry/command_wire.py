"""How commands travel: length-prefixed messages over a Unix socket or TLS, and their authentication.

The sidecar speaks first, with a challenge. A request is answered by a reply that carries the next challenge. From
elsewhere both carry a MAC (hmac, SHA-256) with the operators' secret. It is over direction, challenge and the
message's bytes, and so over kind, sequence, nonce and expiry. A message of another connection, another time or the
other direction is worth nothing. On a Unix socket the kernel says who asks (SO_PEERCRED), and no secret is needed.
"""

import hmac
import os
import socket
import struct

from hil.telemetry import telemetry_pb2 as pb

LIMIT = 2**15  # bytes of a message; whoever announces more is cut off
PART = LIMIT - 1024  # of a task that does not fit one
NONCE_BYTES = 16
REQUEST, REPLY = b"hil request", b"hil reply"
_LENGTH = struct.Struct(">H")
_PEER = struct.Struct("3i")  # struct ucred: pid, uid, gid


class WireError(Exception):
    """The peer sent what no peer sends."""


def frame(message: bytes) -> bytes:
    """As it is sent. Raises ValueError beyond LIMIT."""
    if len(message) > LIMIT:
        raise ValueError(f"a message of {len(message)} bytes; at most {LIMIT}")
    return _LENGTH.pack(len(message)) + message


def unframe(buffer: bytearray) -> bytes | None:
    """Take the first whole message out of what was received; None until it is there. Raises WireError."""
    if len(buffer) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack_from(buffer)
    if length > LIMIT:
        raise WireError(f"a message of {length} bytes; at most {LIMIT}")
    end = _LENGTH.size + length
    if len(buffer) < end:
        return None
    message = bytes(buffer[_LENGTH.size : end])
    del buffer[:end]
    return message


def challenge(now_ns: int) -> pb.Challenge:
    """A new one."""
    return pb.Challenge(nonce=os.urandom(NONCE_BYTES), now_ns=now_ns)


def seal(body: bytes, direction: bytes, nonce: bytes, secret: bytes) -> bytes:
    """The message that carries `body`. secret: empty on a Unix socket."""
    return pb.Authenticated(body=body, mac=_mac(body, direction, nonce, secret)).SerializeToString()


def opened(message: bytes, direction: bytes, nonce: bytes, secret: bytes) -> bytes | None:
    """The body of a sealed message; None where the MAC is not the one it must have. Raises DecodeError."""
    sealed = pb.Authenticated.FromString(message)
    valid = hmac.compare_digest(sealed.mac, _mac(sealed.body, direction, nonce, secret))
    return sealed.body if valid else None


def _mac(body: bytes, direction: bytes, nonce: bytes, secret: bytes) -> bytes:
    return hmac.digest(secret, direction + nonce + body, "sha256") if secret else b""


def peer(connection: socket.socket) -> tuple[int, int]:
    """Process and user at the other end of a Unix socket, as the kernel knows them (unix(7), SO_PEERCRED)."""
    pid, uid, _ = _PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
    return pid, uid
