"""A CAN bus between the processes of one machine: no kernel module, no root, no broker.

A channel is a directory in the runtime directory. Every member has a listening AF_UNIX socket there, its door, and
one SOCK_SEQPACKET connection, a link, to every other member; a link carries exactly the bytes that a SocketCAN
socket would: `struct can_frame` or `struct canfd_frame`, one frame per packet, time-stamped by the kernel.

- Joining: under the channel's lock, connect to every door found, open one's own, then count up in the lock file,
  which every member has mapped: a look at that number, no system call, tells a member that somebody is at its door.
  So there is exactly one link per pair, and a new member hears everything that is sent after it has joined. (What it
  sends itself before the others have taken it in is stamped when they do, at their next read or write.)
- Leaving: the kernel closes a member's links however it ends, SIGKILL included; the others see it at once.
- A member that stops reading fills its own links only. A frame that does not fit is lost for that member alone, as
  it would be in a node whose receive buffer is full, and the member is told with the error frame that a
  controller uses for that: CAN_ERR_CRTL_RX_OVERFLOW (data[5]: how many were lost, at most 255 at a time).
- Queues are short, and their lengths are the receiver's choice: the name of a door says how many frames a link to
  it may hold, and the first packet on a link says it for the other direction. Links are used because the queue of an
  unconnected datagram socket is bound by net.unix.max_dgram_qlen: 10 on some machines, 512 on others, and only root
  can change it.

Frames never leave the machine: AF_UNIX could not carry them.
"""

import contextlib
import errno
import fcntl
import itertools
import mmap
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

from drivers.bus.counters import BusState
from drivers.bus.error_frames import overflow_notice
from drivers.bus.recvmmsg import SO_TIMESTAMPNS
from drivers.frame import CANFD_MTU, to_bytes
from drivers.runtime import make_private, runtime_dir

FIRST_DEPTH = 16  # frames that may wait on a link before its greeting has been read
JOIN_TIMEOUT_S = 2.0  # joining takes about a millisecond; who holds the lock for longer has been stopped

_BACKLOG = 128
_COUNT_BYTES = 8
_EVENTS = 64  # of one epoll_wait; the rest comes with the next
_FEW = 4  # links: no more are quicker tried one by one than asked about
_DEEPEST = 1 << 16
_LOOK_ONLY: Final = int(socket.MSG_PEEK)
_NO_SIGNAL: Final = int(socket.MSG_NOSIGNAL)  # a plain int is quicker to pass than an enum
_LOCK_POLL_S = 0.002
_SIOCOUTQ = 0x5411  # bytes sent and not yet read by the other side, with the kernel's overhead
_SIOCINQ = 0x541B  # bytes received and not yet read
_PATH_LIMIT = 107  # sun_path without its terminator, <sys/un.h>
_GREETING = struct.Struct("=4sI")  # first packet on a link; its size tells it from a frame
_GREETING_MARK = b"hil1"
_TOLD_AT_ONCE: Final = 255  # lost frames that one overflow notice can count
_DOORS = "*-*-*.sock"  # process, number within it, depth of its queues
_door_numbers = itertools.count()


class Link:
    """The connection to one other member.

    sock: what it sends arrives here. send: what goes to it. own: it is this member itself (loopback).
    missed: frames lost for the other side since it was last told. greeted: the depth it wants is known.
    """

    __slots__ = ("greeted", "missed", "own", "send", "sender", "sock")

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
        self.greeted = depth > 0
        self.set_depth(depth or FIRST_DEPTH)

    def set_depth(self, frames: int) -> None:
        """Let `frames` frames wait for the other side; the kernel doubles what SO_SNDBUF is set to."""
        size = min(frames, _DEEPEST) * _bytes_per_frame() // 2
        self.sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size)

    def greet(self, depth: int) -> None:
        """Tell the other side how many frames it may leave waiting."""
        self.send(_GREETING.pack(_GREETING_MARK, depth), _NO_SIGNAL)

    def take_greeting(self, packet: bytes) -> bool:
        """Follow the other side's greeting; False when the packet is none."""
        if len(packet) != _GREETING.size or not packet.startswith(_GREETING_MARK):
            return False
        self.set_depth(_GREETING.unpack(packet)[1])
        self.greeted = True
        return True

    def look_for_greeting(self) -> bool:
        """Follow the greeting if it is what comes next; it is left there, as another thread may be about to read."""
        with contextlib.suppress(OSError):
            return self.take_greeting(self.sock.recv(CANFD_MTU, _LOOK_ONLY))
        return False

    def deliver(self, packet: bytes) -> bool:
        """Send without waiting; False when there is no room. Raises OSError when the other side has left."""
        try:
            if self.missed:
                self._tell()
            self.send(packet, _NO_SIGNAL)
            return True
        except BlockingIOError:
            if not self.greeted and self.look_for_greeting():
                return self.deliver(packet)
            self.missed += 1
            return False

    def _tell(self) -> None:
        """Tell the other side how many frames it has lost; raises BlockingIOError while there is no room for that."""
        while self.missed:
            told = min(self.missed, _TOLD_AT_ONCE)
            self.send(to_bytes(overflow_notice(told)), _NO_SIGNAL)
            self.missed -= told

    def close(self) -> None:
        """Close both ends held here."""
        self.sock.close()
        self.sender.close()


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
        self._poll = select.epoll()  # links and door, once anybody waits for them
        self._watched = False
        self._joined = memoryview(bytes(_COUNT_BYTES)).cast("Q")  # [0]: how many have ever joined; all members share it
        self._seen = 0  # of them
        self._door = _packet_socket()
        self._door_fd = self._door.fileno()
        self._door_path: Path | None = None
        try:
            self._join(channel_dir(channel))
            if loopback:
                receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._add(Link(receiver, depth, sender))
        except BaseException:
            self.close()
            raise

    def _join(self, directory: Path) -> None:
        with _locked(directory) as lock:
            self._joined = _shared_count(lock)
            for path in sorted(directory.glob(_DOORS)):
                self._connect(path)
            self._open_door(directory)
            self._joined[0] += 1
            self._seen = self._joined[0]

    def _connect(self, path: Path) -> None:
        sock = _packet_socket()
        try:
            with _address(path) as address:
                sock.connect(address)
        except ConnectionRefusedError:  # its owner died without tidying up
            sock.close()
            path.unlink(missing_ok=True)
        except (FileNotFoundError, BlockingIOError):  # left just now; stopped for so long that its backlog is full
            sock.close()
        else:
            link = Link(sock, depth=int(path.stem.rpartition("-")[2]))
            self._add(link)
            with contextlib.suppress(OSError):  # gone already: reading will tell
                link.greet(self._depth)

    def _open_door(self, directory: Path) -> None:
        while (path := directory / f"{os.getpid()}-{next(_door_numbers)}-{self._depth}.sock").exists():
            pass
        self._door_path = path
        with _address(path) as address:
            self._door.bind(address)
        path.chmod(0o666)  # who may come in is the directory's business
        self._door.listen(_BACKLOG)

    def _add(self, link: Link) -> None:
        self._by_fd[link.sock.fileno()] = link
        self._note_whether_few()
        self._links = (*self._links, link)
        if self._watched:
            self._poll.register(link.sock, select.EPOLLIN)

    def _note_whether_few(self) -> None:
        self._few = list(self._by_fd) if len(self._by_fd) <= _FEW else None

    def _watch(self) -> None:
        """From now on the epoll set tells of what arrives.

        Not before somebody asks for it: on a socket that is waited for, each frame costs its sender and its reader
        0.1 to 0.4 us more, also where it is the far end that waits.
        """
        with self._change:
            if not self._watched:
                self._watched = True
                for source in (self._door, *(link.sock for link in self._by_fd.values())):
                    self._poll.register(source, select.EPOLLIN)

    def _admit(self) -> None:
        """Take in whoever waits at the door."""
        with self._change:
            joined = self._joined[0]
            while True:
                try:
                    sock, _ = self._door.accept()
                except OSError:  # nobody (left); or no descriptors left, then they keep waiting
                    break
                link = Link(sock)
                if link.look_for_greeting():
                    sock.recv(CANFD_MTU)  # nobody else reads here yet
                self._add(link)
            self._seen = joined  # not before they are in: another thread, about to send, would leave them out

    @property
    def others(self) -> int:
        """How many other members there are, as far as this one has noticed."""
        return sum(not link.own for link in self._links)

    def fileno(self) -> int:
        """A descriptor that is readable when something has arrived; stays the same while members come and go."""
        self._watch()
        return self._poll.fileno()

    def wait(self, timeout: float) -> list[int]:
        """Descriptors with something to read, after at most `timeout` seconds (negative: no limit).

        Takes in who is at the door.
        """
        if not self._watched:
            self._watch()
        found = [fd for fd, _ in self._poll.poll(timeout, _EVENTS)]
        if self._door_fd in found:
            self._admit()
            return [fd for fd, _ in self._poll.poll(0, _EVENTS) if fd != self._door_fd]
        return found

    def ready(self) -> list[int]:
        """Descriptors to read from now, whether or not something is there.

        A member that waits (`fileno`) is woken by a knock at its door, before the count goes up, and has to answer it
        then: else it would be woken again and again, and where it takes precedence over who is joining, for ever.
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
        if self._joined[0] != self._seen:  # who has joined before this frame is sent shall receive it
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
            read = fd < 0 or _waiting(link.sock, _SIOCINQ) == 0
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
        """Handle a packet that is no frame: the other side's greeting; False for anything else."""
        link = self._by_fd.get(fd)
        return link is not None and link.take_greeting(packet)

    def state(self) -> BusState:
        """A local bus has no controller that could go error-passive."""
        return BusState.ERROR_ACTIVE

    def purge(self) -> bool:
        """Whether nothing that was sent still waits to be read; what waits is its reader's and cannot be recalled."""
        return not any(_waiting(link.sender) for link in self._links)

    def close(self) -> None:
        """Leave the bus."""
        if self._door_path is not None:
            self._door_path.unlink(missing_ok=True)
            self._door_path = None
        with self._change:
            links, self._links = self._links, ()
            self._by_fd.clear()
        for link in links:
            link.close()
        self._door.close()
        self._poll.close()


def channel_dir(channel: str) -> Path:
    """The directory of a channel, made when missing."""
    directory = runtime_dir() / "bus" / channel
    make_private(directory.parent)
    make_private(directory)
    return directory


def channels() -> list[str]:
    """Names of the channels that somebody has used on this machine."""
    try:
        return sorted(path.name for path in (runtime_dir() / "bus").iterdir())
    except OSError:
        return []


def _packet_socket() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)


@contextlib.contextmanager
def _locked(directory: Path) -> Iterator[int]:
    """Hold the channel's lock; raises TimeoutError when another process keeps it. It ends with its holder."""
    deadline = time.monotonic() + JOIN_TIMEOUT_S
    fd = os.open(directory / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        while True:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise TimeoutError(
                        errno.ETIMEDOUT,
                        f"another process has been joining this bus for {JOIN_TIMEOUT_S} s; is one stopped (state T)?",
                        str(directory),
                    ) from None
                time.sleep(_LOCK_POLL_S)
        yield fd
    finally:
        fcntl.flock(fd, fcntl.LOCK_UN)  # closing alone would not do: a mapping holds a duplicate of the descriptor
        os.close(fd)


@contextlib.contextmanager
def _address(path: Path) -> Iterator[str]:
    """`path` in a form short enough for a socket address."""
    if len(os.fsencode(path)) <= _PATH_LIMIT:
        yield str(path)
        return
    fd = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{fd}/{path.name}"
    finally:
        os.close(fd)


def _shared_count(lock: int) -> memoryview:
    """The number in the channel's lock file, shared with every other member; lives as long as it is referred to."""
    os.ftruncate(lock, _COUNT_BYTES)
    return memoryview(mmap.mmap(lock, _COUNT_BYTES)).cast("Q")


def _waiting(sock: socket.socket, which: int = _SIOCOUTQ) -> int:
    """Bytes that have been sent, or received (_SIOCINQ), and not been read."""
    return int(struct.unpack("i", fcntl.ioctl(sock, which, bytes(4)))[0])


@cache
def _bytes_per_frame() -> int:
    """What one queued frame takes of SO_SNDBUF: its bytes and the kernel's bookkeeping, which differs by kernel."""
    sender, receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with sender, receiver:
        sender.send(bytes(CANFD_MTU))
        return _waiting(sender)
