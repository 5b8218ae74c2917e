"""A Medium whose far end the test holds."""

import os
import socket

from drivers.bus.port import (
    BusState,
)
from drivers.bus.recvmmsg import SO_TIMESTAMPNS
from drivers.frame import Frame, to_bytes


class Cable:
    """A Medium whose far end the test holds."""

    def __init__(self, near: socket.socket, far: socket.socket) -> None:
        self.near, self.far = near, far
        near.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.next_error = 0
        self.present = BusState.ERROR_ACTIVE
        self.unknown: list[bytes] = []
        self.closed = False

    @classmethod
    def pair(cls) -> "Cable":
        return cls(*socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET))

    def fileno(self) -> int:
        return self.near.fileno()

    def ready(self) -> list[int]:
        return [self.near.fileno()]

    def transmit(self, packet: bytes) -> bool:
        if self.next_error:
            raise OSError(self.next_error, os.strerror(self.next_error))
        self.near.send(packet)
        return True

    def lost(self, fd: int) -> None:
        self.closed = True

    def service(self, fd: int, packet: bytes) -> bool:
        self.unknown.append(packet)
        return packet == b"handshake"

    def state(self) -> BusState:
        return self.present

    def purge(self) -> bool:
        return True

    def close(self) -> None:
        self.near.close()
        self.far.close()

    def arrive(self, *frames: Frame) -> None:
        for frame in frames:
            self.far.send(to_bytes(frame))
