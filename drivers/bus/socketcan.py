"""SocketCAN behind a Port: one raw CAN socket of the standard library (kernel: Documentation/networking/can.rst)."""

import fcntl
import socket
import struct
from pathlib import Path

from drivers.bus.counters import BusState
from drivers.bus.recvmmsg import SO_RXQ_OVFL, SO_TIMESTAMPNS

_CAN_RAW_ERR_FILTER = 2  # <linux/can/raw.h>
_EVERY_ERROR = 0x1FFFFFFF  # CAN_ERR_MASK, <linux/can.h>
_ARPHRD_CAN = 280  # <linux/if_arp.h>
_SIOCGIFFLAGS = 0x8913
_SIOCSIFFLAGS = 0x8914
_IFF_UP = 0x1
_IFF_RUNNING = 0x40
_IFREQ = struct.Struct("=16sH22x")  # name, flags
_FRAME_MEMORY = 768  # bytes of socket memory that one queued frame takes on 64-bit kernels


def is_can_interface(name: str) -> bool:
    """Whether the kernel has a CAN network interface of this name."""
    try:
        return int(Path(f"/sys/class/net/{name}/type").read_text(encoding="ascii")) == _ARPHRD_CAN
    except (OSError, ValueError):
        return False


class SocketCanMedium:
    """One raw CAN socket, with the options a control loop needs."""

    def __init__(self, channel: str, *, fd: bool, transmit_queue: int, echo: bool = False) -> None:
        """Open `channel`; raises OSError.

        transmit_queue: frames that may wait for the wire; more are refused (EAGAIN). It is enforced through SO_SNDBUF,
        which needs no privilege and, unlike the interface's txqueuelen, makes poll(2) tell the truth.
        echo: give back what is sent (CAN_RAW_RECV_OWN_MSGS) once it has left the controller, stamped with when. Off,
        it saves a frame per tick; should an echo arrive all the same, the Port tells it apart.
        """
        self._channel = channel
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _EVERY_ERROR)
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, echo)
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, fd)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, transmit_queue * _FRAME_MEMORY // 2)
            self._socket.bind((channel,))
        except OSError:
            self.close()
            raise
        self._ready = [self._socket.fileno()]
        self._send = self._socket.send

    def fileno(self) -> int:
        """The CAN socket's descriptor."""
        return self._ready[0]

    def ready(self) -> list[int]:
        """Descriptors to read from: always the socket, as asking costs as much as reading."""
        return self._ready

    def transmit(self, packet: bytes) -> bool:
        """Queue a frame; True. Raises OSError: BlockingIOError or ENOBUFS when the queue is full."""
        self._send(packet)
        return True

    def lost(self, fd: int) -> None:
        """A CAN socket has no other end that could leave."""

    def service(self, fd: int, packet: bytes) -> bool:
        """Nothing but frames comes out of a CAN socket: False."""
        return False

    def state(self) -> BusState:
        """What the interface tells: down, bus-off (a driver then takes the carrier away) or up."""
        try:
            flags = self._flags()
        except OSError:
            return BusState.DOWN
        if not flags & _IFF_UP:
            return BusState.DOWN
        return BusState.ERROR_ACTIVE if self._has_carrier(flags) else BusState.BUS_OFF

    def _has_carrier(self, flags: int) -> bool:
        """The flag follows the carrier by up to a second, so ask the driver's own word first."""
        try:
            return Path(f"/sys/class/net/{self._channel}/carrier").read_text(encoding="ascii").strip() == "1"
        except OSError:  # no sysfs of this network namespace
            return bool(flags & _IFF_RUNNING)

    def _flags(self) -> int:
        answer = fcntl.ioctl(self._socket, _SIOCGIFFLAGS, _IFREQ.pack(self._channel.encode(), 0))
        return int(_IFREQ.unpack(answer)[1])

    def _set_flags(self, flags: int) -> None:
        fcntl.ioctl(self._socket, _SIOCSIFFLAGS, _IFREQ.pack(self._channel.encode(), flags))

    def purge(self) -> bool:
        """Drop every frame that waits for the wire, by taking the interface down and up again.

        Linux has no other way to recall a queued frame. It needs CAP_NET_ADMIN: False without it. Milliseconds. An
        interface that is down holds none, and stays down: the person who took it down may be working on the bus.
        """
        try:
            flags = self._flags()
            if not flags & _IFF_UP:
                return True
            self._set_flags(flags & ~_IFF_UP)
            self._set_flags(flags | _IFF_UP)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
