"""The connection between two members of a local bus: one frame per packet, and how many may wait.

The first packet on a link is a handshake, which tells the other side how many frames it may leave waiting. Every other
packet is a frame, in the bytes that a SocketCAN socket would carry.
"""

import contextlib
import fcntl
import socket
import struct
from functools import cache
from typing import Final

from drivers.bus.error_frames import overflow_notice
from drivers.bus.recvmmsg import SO_TIMESTAMPNS
from drivers.frame import CANFD_MTU, to_bytes

FIRST_DEPTH = 16  # frames that may wait on a link before its handshake has been read
SIOCOUTQ = 0x5411  # bytes sent and not yet read by the other side, with the kernel's overhead
SIOCINQ = 0x541B  # bytes received and not yet read

_DEEPEST = 1 << 16
_LOOK_ONLY: Final = int(socket.MSG_PEEK)
_NO_SIGNAL: Final = int(socket.MSG_NOSIGNAL)  # a plain int is passed faster than an enum
_HANDSHAKE = struct.Struct("=4sI")  # first packet on a link; its size tells it from a frame
_HANDSHAKE_MARK = b"hil1"
_REPORTED_AT_ONCE: Final = 255  # lost frames that one overflow notice can count


class Link:
    """The connection to one other member.

    sock: receives what the other side sends. send: sends to it. own: it is this member itself (loopback).
    missed: frames the other side has lost since it was last told. agreed: the queue length it asks for is known.
    """

    __slots__ = ("agreed", "missed", "own", "send", "sender", "sock")

    def __init__(self, sock: socket.socket, depth: int = 0, sender: socket.socket | None = None) -> None:
        """depth: of the queue towards the other side; 0 while unknown."""
        self.sock = sock
        self.sender = sender or sock
        self.send = self.sender.send
        self.own = sender is not None
        self.missed = 0
        self.sock.setblocking(False)
        self.sender.setblocking(False)
        self.sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.agreed = depth > 0
        self.set_depth(depth or FIRST_DEPTH)

    def set_depth(self, frames: int) -> None:
        """Let `frames` frames wait for the other side; the kernel doubles what SO_SNDBUF is set to."""
        size = min(frames, _DEEPEST) * _bytes_per_frame() // 2
        self.sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size)

    def send_handshake(self, depth: int) -> None:
        """Tell the other side how many frames it may leave waiting."""
        self.send(_HANDSHAKE.pack(_HANDSHAKE_MARK, depth), _NO_SIGNAL)

    def take_handshake(self, packet: bytes) -> bool:
        """Adopt the queue length of the other side's handshake; False when the packet is no handshake."""
        if len(packet) != _HANDSHAKE.size or not packet.startswith(_HANDSHAKE_MARK):
            return False
        self.set_depth(_HANDSHAKE.unpack(packet)[1])
        self.agreed = True
        return True

    def peek_handshake(self) -> bool:
        """Adopt the handshake if it is the next packet; it is left there, as another thread may be about to read."""
        with contextlib.suppress(OSError):
            return self.take_handshake(self.sock.recv(CANFD_MTU, _LOOK_ONLY))
        return False

    def deliver(self, packet: bytes) -> bool:
        """Send without waiting; False when there is no room. Raises OSError when the other side has left."""
        try:
            if self.missed:
                self._notify()
            self.send(packet, _NO_SIGNAL)
            return True
        except BlockingIOError:
            if not self.agreed and self.peek_handshake():
                return self.deliver(packet)
            self.missed += 1
            return False

    def _notify(self) -> None:
        """Report to the other side how many frames it has lost. Raises BlockingIOError while there is no room."""
        while self.missed:
            reported = min(self.missed, _REPORTED_AT_ONCE)
            self.send(to_bytes(overflow_notice(reported)), _NO_SIGNAL)
            self.missed -= reported

    def close(self) -> None:
        """Close both ends held here."""
        self.sock.close()
        self.sender.close()


def unread(sock: socket.socket, which: int = SIOCOUTQ) -> int:
    """Bytes that have been sent, or received (SIOCINQ), and not been read."""
    return int(struct.unpack("i", fcntl.ioctl(sock, which, bytes(4)))[0])


@cache
def _bytes_per_frame() -> int:
    """What one queued frame takes of SO_SNDBUF: its bytes and the kernel's bookkeeping, which differs by kernel."""
    sender, receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with sender, receiver:
        sender.send(bytes(CANFD_MTU))
        return unread(sender)
