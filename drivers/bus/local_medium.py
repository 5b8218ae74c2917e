"""A CAN bus between the processes of one machine: no kernel module, no root, no broker.

A channel is a directory in the runtime directory (local_channel.py). Every member has a listening AF_UNIX socket there
and one SOCK_SEQPACKET connection, a link (local_link.py), to every other member. A link carries exactly the bytes that
a SocketCAN socket would: `struct can_frame` or `struct canfd_frame`, one frame per packet, time-stamped by the kernel.

Rules and theory of operation:

- Joining: under the channel's lock, connect to every listening socket found, open one's own, then count up in the lock
  file, which every member has mapped. A changed count is the join notice, and reading it needs no system call. So there
  is exactly one link per pair, and a new member receives everything that is sent after it has joined. (What it sends
  itself before the others have accepted it is stamped when they do, at their next read or write.)
- Leaving: the kernel closes a member's links however it ends, SIGKILL included; the others see it at once.
- A member that stops reading fills its own links only. A frame that does not fit is lost for that member alone, as it
  would be in a node whose receive buffer is full. The member is told with the error frame that a controller uses for
  that: CAN_ERR_CRTL_RX_OVERFLOW (data[5]: how many were lost, at most 255 at a time).
- Queues are short, and the receiver chooses their lengths: the name of a listening socket says how many frames a link
  to it may hold, and the handshake says it for the other direction. Links are used because the queue of an unconnected
  datagram socket is bound by net.unix.max_dgram_qlen: 10 on some machines, 512 on others, and only root can change it.

Frames never leave the machine: AF_UNIX cannot carry them.
"""

import contextlib
import errno
import itertools
import mmap
import os
import select
import socket
import threading
from pathlib import Path

from drivers.base.shared_map import unmap
from drivers.bus.counters import BusState
from drivers.bus.local_channel import (
    COUNT_BYTES,
    LISTENING_SOCKETS,
    address,
    channel_dir,
    locked,
    packet_socket,
    shared_count,
)
from drivers.bus.local_link import SIOCINQ, Link, unread
from drivers.frame import CANFD_MTU

_BACKLOG = 128
_EVENTS = 64  # of one epoll_wait; the rest comes with the next
_FEW = 4  # links: up to so many, trying each is faster than asking which are readable
_socket_numbers = itertools.count()


def _alone() -> memoryview:
    """A count of joins that no other member sees."""
    return memoryview(bytes(COUNT_BYTES)).cast("Q")


class LocalMedium:
    """One member of a local bus. One thread may receive while another sends."""

    def __init__(self, channel: str, *, depth: int, loopback: bool = False) -> None:
        """Join `channel`.

        depth: frames that each other member may leave waiting for this one (the kernel makes it at least 6, and at
        most what net.core.wmem_max holds). loopback: hear one's own frames too. Raises OSError where joining fails.
        """
        self.channel = channel
        self._depth = depth
        self._change = threading.Lock()  # held while the set of links changes
        self._links: tuple[Link, ...] = ()
        self._by_fd: dict[int, Link] = {}
        self._few: list[int] | None = []  # the links' descriptors, where there are no more than _FEW
        self._poll = select.epoll()  # links and listening socket, once anybody waits for them
        self._watched = False
        self._shared: mmap.mmap | None = None
        self._joined = _alone()  # [0]: how many have ever joined; all members share it
        self._seen = 0  # of them
        self._listening = packet_socket()
        self._listening_fd = self._listening.fileno()
        self._path: Path | None = None
        try:
            self._join(channel_dir(channel))
            if loopback:
                receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._add(Link(receiver, depth, sender))
        except BaseException:
            self.close()
            raise

    def _join(self, directory: Path) -> None:
        with locked(directory) as lock:
            self._shared = shared_count(lock, directory)
            self._joined = memoryview(self._shared).cast("Q")
            for path in sorted(directory.glob(LISTENING_SOCKETS)):
                self._connect(path)
            self._listen(directory)
            self._joined[0] += 1
            self._seen = self._joined[0]

    def _connect(self, path: Path) -> None:
        sock = packet_socket()
        try:
            with address(path) as name:
                sock.connect(name)
        except ConnectionRefusedError:  # its owner died without removing it
            sock.close()
            path.unlink(missing_ok=True)
        except (FileNotFoundError, BlockingIOError):  # left just now; stopped for so long that its backlog is full
            sock.close()
        else:
            link = Link(sock, depth=int(path.stem.rpartition("-")[2]))
            self._add(link)
            with contextlib.suppress(OSError):  # it has left already: reading will report that
                link.send_handshake(self._depth)

    def _listen(self, directory: Path) -> None:
        while (path := directory / f"{os.getpid()}-{next(_socket_numbers)}-{self._depth}.sock").exists():
            pass
        self._path = path
        with address(path) as name:
            self._listening.bind(name)
        path.chmod(0o666)  # the directory decides who may enter
        self._listening.listen(_BACKLOG)

    def _add(self, link: Link) -> None:
        self._by_fd[link.sock.fileno()] = link
        self._note_whether_few()
        self._links = (*self._links, link)
        if self._watched:
            self._poll.register(link.sock, select.EPOLLIN)

    def _note_whether_few(self) -> None:
        self._few = list(self._by_fd) if len(self._by_fd) <= _FEW else None

    def _watch(self) -> None:
        """From now on the epoll set reports what arrives.

        Only once somebody asks for it: on a socket that is in an epoll set, each frame costs its sender and its reader
        0.1 to 0.4 us more, whichever end waits.
        """
        with self._change:
            if not self._watched:
                self._watched = True
                for source in (self._listening, *(link.sock for link in self._by_fd.values())):
                    self._poll.register(source, select.EPOLLIN)

    def _admit(self) -> None:
        """Accept every member that is joining."""
        with self._change:
            joined = self._joined[0]
            while True:
                try:
                    sock, _ = self._listening.accept()
                except OSError:  # nobody (left), or out of descriptors: then they keep waiting
                    break
                link = Link(sock)
                if link.peek_handshake():
                    sock.recv(CANFD_MTU)  # nobody else reads here yet
                self._add(link)
            self._seen = joined  # only now: another thread, about to send, would leave them out

    @property
    def others(self) -> int:
        """How many other members there are, as far as this one knows."""
        return sum(not link.own for link in self._links)

    def fileno(self) -> int:
        """A descriptor that is readable when something has arrived; stays the same while members come and go."""
        self._watch()
        return self._poll.fileno()

    def wait(self, timeout: float) -> list[int]:
        """Descriptors with something to read, after at most `timeout` seconds (negative: no limit).

        Accepts members that are joining.
        """
        if not self._watched:
            self._watch()
        found = [fd for fd, _ in self._poll.poll(timeout, _EVENTS)]
        if self._listening_fd in found:
            self._admit()
            return [fd for fd, _ in self._poll.poll(0, _EVENTS) if fd != self._listening_fd]
        return found

    def ready(self) -> list[int]:
        """Descriptors to read from now, whether or not something is there.

        A member that waits (`fileno`) is woken by the join notice of another one, before the count goes up, and has to
        accept it then. Else it would be woken again and again, for ever where it has the higher priority.
        """
        if self._watched:
            return self.wait(0.0)
        if self._joined[0] != self._seen:
            self._admit()
        few = self._few
        return self.wait(0.0) if few is None else few

    def link(self, fd: int) -> Link | None:
        """The link with this descriptor; None when it has been dropped meanwhile."""
        return self._by_fd.get(fd)

    def transmit(self, packet: bytes) -> bool:
        """Give a frame's bytes to every other member; never waits.

        False: nobody was there to acknowledge it. Raises BlockingIOError when it fitted into nobody's queue.
        """
        if self._joined[0] != self._seen:  # whoever has joined before this frame is sent receives it
            self._admit()
        delivered = False
        for link in self._links:
            try:
                if link.deliver(packet):
                    delivered = True
            except OSError:
                self._part(link)
        if delivered or not self.others:
            return delivered
        raise BlockingIOError(errno.EAGAIN, "the receive queue of every member is full")

    def _part(self, link: Link) -> None:
        """Stop sending to a member that has left; what it sent before it left is still to be read."""
        with self._change:
            self._links = tuple(other for other in self._links if other is not link)
            fd = link.sock.fileno()  # -1: a reading thread has closed it already
            read = fd < 0 or unread(link.sock, SIOCINQ) == 0
        if read:
            self.lost(fd)

    def lost(self, fd: int) -> None:
        """The member behind this descriptor has left, and everything it sent has been read."""
        with self._change:
            link = self._by_fd.pop(fd, None)
            self._note_whether_few()
            if link is not None:
                self._links = tuple(other for other in self._links if other is not link)
                link.close()  # takes it out of the epoll set as well

    def service(self, fd: int, packet: bytes) -> bool:
        """Handle a packet that is no frame: the other side's handshake; False for anything else."""
        link = self._by_fd.get(fd)
        return link is not None and link.take_handshake(packet)

    def state(self) -> BusState:
        """A local bus has no controller that could go error-passive."""
        return BusState.ERROR_ACTIVE

    def purge(self) -> bool:
        """Whether nothing that was sent still waits to be read; what waits is its reader's and cannot be recalled."""
        return not any(unread(link.sender) for link in self._links)

    def close(self) -> None:
        """Leave the bus."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
            self._path = None
        with self._change:
            links = list(self._by_fd.values())  # those of members that left, but have not been read out, as well
            self._links = ()
            self._by_fd.clear()
        for link in links:
            link.close()
        self._listening.close()
        self._poll.close()
        if self._shared is not None:
            self._joined.release()
            unmap(self._shared)
            self._shared, self._joined, self._seen = None, _alone(), 0
