"""The control loop's access to a CAN bus: one Port, the same for SocketCAN and for the local bus.

Rules. Everything a bus can do to a control loop shows up in a counter or in the state. Nothing here waits or retries: a
torque that could not be sent in its tick is worth nothing in the next. Once a port is open, nothing the bus does raises
an exception.

Theory of operation. A Port sits on a Medium: one CAN socket, or the links of a local bus, which carry the same bytes.
`drain` empties every socket of it, once per tick, with one system call for up to 32 frames (receive_block.py): the fast
path, for a tick in which all frames are alike. Anything else (an error frame, an echo, an odd length, a count of lost
frames, a full block) takes the slow path, which looks at each message by itself. Of what has arrived, the newest
`receive_limit` frames are returned, so that a flood cannot delay a tick. The kernel stamps frames with the wall clock;
`drain` converts to the monotonic clock and keeps each stamp between the previous drain and the present one. So setting
the wall clock cannot move a sample in time. `send` hands a frame to the kernel or refuses it, at once.
"""

import errno
import socket
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Final, Literal, Protocol

from drivers.base.runtime import RuntimeDirectoryError
from drivers.base.text_file import words_of
from drivers.bus.counters import BusState, PortCounters
from drivers.bus.error_frames import decode_error
from drivers.bus.local_medium import LocalMedium
from drivers.bus.receive_block import ReceiveBlock, stamp
from drivers.bus.recvmmsg import SLOTS, STAMPED
from drivers.bus.socketcan import SocketCanMedium, is_can_interface
from drivers.config import KERNEL_INTERFACES, BusConfig
from drivers.frame import CAN_MTU, CANFD_MTU, ECHO, ERROR, FD, Frame, sort_by_time, to_bytes
from drivers.native import tuple_as

__all__ = ["BusState", "Medium", "Port", "PortCounters", "PortError", "Role", "open_port", "resolve_interface"]

Role = Literal["host", "device"]

_READS_PER_DRAIN = 16  # of up to SLOTS frames each: all that a babbling sender may cost one tick
_CLOCKS_READ_NS: Final = 20_000  # reading three clocks takes less than this unless something came between
_UNSIGNED_32 = 0xFFFFFFFF
_GONE = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EBADF)
_OWN_ECHO = int(socket.MSG_CONFIRM)  # a plain int: & with an enum takes a microsecond
_HEADER = 8  # bytes of a can_frame or canfd_frame before its data
_PACKET = struct.Struct("=IBBH64s")
_, _, _REFUSED, _OVERFLOW, _DISCARDED, _ERRORS, _NO_ACK, _BUS_OFF, _RESTARTED, _DOWN, _ECHO, _STATE = range(
    len(PortCounters._fields)
)
# Used in every tick; compiled code reads a Final faster than a global.
_RECEIVED: Final[int] = PortCounters._fields.index("received")
_SENT: Final[int] = PortCounters._fields.index("sent")
_make: Final = tuple_as
_counters: Final = PortCounters
_monotonic_ns: Final = monotonic_ns
_time_ns: Final = time_ns
_HOST_DEPTH = 2  # times the receive limit: room for a flood to be seen as one


class PortError(Exception):
    """A bus that cannot be opened; the text names the channel, the reason and what to do."""


class Medium(Protocol):
    """What a Port sits on: sockets that carry can_frame and canfd_frame bytes."""

    def fileno(self) -> int:
        """Readable when something has arrived."""

    def ready(self) -> Sequence[int]:
        """Descriptors to read from now."""

    def transmit(self, packet: bytes) -> bool:
        """Send without waiting; False when nobody was there to acknowledge. Raises OSError."""

    def lost(self, fd: int) -> None:
        """The other end of a descriptor has closed."""

    def service(self, fd: int, packet: bytes) -> bool:
        """Take a packet that is no frame; False when it means nothing here."""

    def state(self) -> BusState:
        """The bus' state as far as it can be asked for."""

    def purge(self) -> bool:
        """Drop what waits to be sent; False where something may still wait."""

    def close(self) -> None:
        """Leave the bus."""


class Port:
    """One member of a CAN bus, for use by one thread."""

    def __init__(
        self, open_medium: Callable[[], Medium], *, fd: bool, receive_limit: int, echo_id: int | None = None
    ) -> None:
        """Open the medium; raises what `open_medium` raises.

        fd: takes and sends FD frames (then classic ones too). receive_limit: frames one drain returns at most.
        echo_id: own frames with this identifier are returned by the next drain, marked ECHO, as the medium echoes them.
        """
        self._echo_id = echo_id
        self._open_medium = open_medium
        self._size = CANFD_MTU if fd else CAN_MTU  # an FD frame is an error to a classic controller
        self._receive_limit = receive_limit
        self._block = ReceiveBlock(self._size)
        self._counts: list[int] = list(PortCounters())
        self._use(open_medium())

    def _use(self, medium: Medium) -> None:
        self._medium = medium
        self._transmit, self._ready = medium.transmit, medium.ready
        self._counts[_STATE] = medium.state()
        self._dropped = 0  # the socket's own count, from its opening on
        self._drained_ns = stamp(monotonic_ns())
        self._has_drained = False

    @property
    def members(self) -> "Sequence[Port]":
        """The ports of the rig's segments: this one alone."""
        return (self,)

    def fileno(self) -> int:
        """Descriptor that is readable when frames have arrived, for poll(2); another one after `rebind`."""
        return self._medium.fileno()

    def drain(self, now_ns: int) -> list[Frame]:
        """Take everything that has arrived; return the newest `receive_limit` frames of it, oldest first.

        now_ns: CLOCK_MONOTONIC just before the call. The timestamp_ns of each frame is the kernel's time stamp, brought
        from CLOCK_REALTIME to CLOCK_MONOTONIC. It is kept between the previous drain and the present: setting the wall
        clock cannot move it out of that interval. It is cut to whole microseconds, as two clocks are not read any
        closer. Error frames and own echoes are counted, not returned (but see `echo_id`). What has gathered before the
        first drain of an opened bus is no flood: what is beyond the limit counts neither as discarded nor as overflow.
        """
        earliest_ns, self._drained_ns = self._drained_ns, stamp(now_ns)
        sources = self._ready()
        wall_ns = _time_ns()
        latest_ns = _monotonic_ns()
        offset_ns = wall_ns - latest_ns if latest_ns - now_ns < _CLOCKS_READ_NS else _wall_offset()
        if len(sources) == 1:
            frames = self._read(sources[0], offset_ns, earliest_ns, latest_ns)
        else:
            frames = []
            for fd in sources:
                frames += self._read(fd, offset_ns, earliest_ns, latest_ns)
            sort_by_time(frames)
        count = len(frames)
        self._counts[_RECEIVED] += count
        if count > self._receive_limit:
            if self._has_drained:
                self._counts[_DISCARDED] += count - self._receive_limit
            del frames[: -self._receive_limit]
        self._has_drained = True
        return frames

    def _read(self, fd: int, offset_ns: int, earliest_ns: int, latest_ns: int) -> list[Frame]:
        """All that one socket has."""
        try:
            frames = self._block.frames(fd, offset_ns, earliest_ns, latest_ns)
        except OSError as error:
            frames = None if self._note_receive_error(error) else []
        return self._sort_out(fd, offset_ns, earliest_ns) if frames is None else frames

    def _sort_out(self, fd: int, offset_ns: int, earliest_ns: int) -> list[Frame]:
        """The slow path: what the block holds, message by message, and then whatever else the socket has."""
        block, frames = self._block, list[Frame]()
        for _ in range(_READS_PER_DRAIN):
            if not self._take(fd, offset_ns, earliest_ns, frames) or 0 < block.count < SLOTS:
                break
            try:
                if not block.receive(fd):
                    break
            except OSError as error:
                if not self._note_receive_error(error):
                    break
        return frames

    def _take(self, fd: int, offset_ns: int, earliest_ns: int, frames: list[Frame]) -> bool:
        """Put the block's frames into `frames` and count everything else; False when the other end has closed."""
        block, latest_ns, first = self._block, monotonic_ns(), True
        messages = zip(block.results(), block.contents(), strict=True)
        for (control, message_flags, size), (can_id, length, flags, rest, data, _, s, ns, dropped) in messages:
            if size == 0:
                self._medium.lost(fd)
                return False
            if control > STAMPED:
                self._note_dropped(dropped)
            classic = size == CAN_MTU
            if not (classic or size == self._size) or length > size - _HEADER:
                self._note_unknown_frame(fd, _PACKET.pack(can_id, length, flags, rest, data)[:size])
            elif can_id & ERROR:
                self._note_error(can_id, data[:length])
            elif message_flags & _OWN_ECHO and can_id != self._echo_id:
                self._counts[_ECHO] += 1
            else:
                stamp_ns = s * 1_000_000_000 + ns - offset_ns if control else latest_ns
                stamp_ns = max(earliest_ns, min(stamp_ns, latest_ns))
                kind = 0 if classic else flags & ~ECHO | FD
                if message_flags & _OWN_ECHO:
                    self._counts[_ECHO] += 1
                    kind |= ECHO
                frames.append(Frame(can_id, data[:length], kind, stamp(stamp_ns)))
                if first and size == self._size:
                    block.expect(length, flags)
                first = False
        return True

    def _note_error(self, can_id: int, data: bytes) -> None:
        """Count an error frame and what it says."""
        report = decode_error(can_id, data)
        self._counts[_ERRORS] += 1
        self._counts[_NO_ACK] += report.no_ack
        self._counts[_BUS_OFF] += report.bus_off
        self._counts[_RESTARTED] += report.restarted
        self._counts[_OVERFLOW] += report.overflow if self._has_drained else 0
        if report.state is not None:
            self._counts[_STATE] = report.state

    def _note_dropped(self, dropped: int) -> None:
        """SO_RXQ_OVFL: the kernel's count for this socket, modulo 2^32."""
        if self._has_drained:
            self._counts[_OVERFLOW] += (dropped - self._dropped) & _UNSIGNED_32
        self._dropped = dropped

    def _note_unknown_frame(self, fd: int, packet: bytes) -> None:
        """A packet that is no frame to this port: the medium's own, or what a classic controller cannot read."""
        if not self._medium.service(fd, packet):
            self._counts[_ERRORS] += 1

    def _note_receive_error(self, error: OSError) -> bool:
        """Count a failed read; False when the socket has nothing more to give."""
        if error.errno == errno.ECONNRESET:  # a member left without reading all; what it sent can still be read
            return True
        self._note_down()
        return False

    def _note_down(self) -> None:
        self._counts[_DOWN] += 1
        self._counts[_STATE] = BusState.DOWN

    def send(self, frame: Frame) -> bool:
        """Hand a frame to the bus now or never; False: refused, counted, not to be tried again with an old torque.

        Raises ValueError for a frame with an impossible length.
        """
        try:
            acknowledged = self._transmit(to_bytes(frame))
        except OSError as error:
            if error.errno in _GONE:
                self._note_down()
            else:  # EAGAIN, ENOBUFS: the queue is full; EINVAL: an FD frame for a classic interface
                self._counts[_REFUSED] += 1
            return False
        self._counts[_SENT] += 1
        if not acknowledged:  # as a controller alone on its wire would report it
            self._counts[_NO_ACK] += 1
            self._counts[_ERRORS] += 1
        return True

    def counters(self) -> PortCounters:
        """Everything counted since the port was opened, and the bus' state."""
        return _make(_counters, self._counts)  # what PortCounters._make ends in, in every tick

    def rebind(self) -> bool:
        """Open the bus anew, after it went down or its adapter was unplugged; True when it can be used again.

        Takes milliseconds: not for a tick that moves something. What had not been read is gone. Counters go on.
        """
        try:
            medium = self._open_medium()
        except OSError:
            self._counts[_STATE] = BusState.DOWN
            return False
        old = self._medium
        self._use(medium)
        old.close()
        return self._counts[_STATE] == BusState.ERROR_ACTIVE

    def purge(self) -> bool:
        """Drop what waits to be sent, so that no old torque comes out when the bus recovers.

        False: something may still wait. SocketCAN: takes the interface down and up, which needs CAP_NET_ADMIN; call it
        off the loop and `rebind` afterwards. Local bus: what has been sent is its reader's; tells whether any waits.
        """
        return self._medium.purge()

    def close(self) -> None:
        """Leave the bus."""
        self._medium.close()


class EchoingPort(Port):
    """A Port on a medium that does not return a sender's own frames: it makes the echoes itself, with its own clock.

    On the local bus transmission takes no time, so a frame is out when it has been sent.
    """

    def _use(self, medium: Medium) -> None:
        super()._use(medium)
        self._echoes: list[Frame] = []

    def send(self, frame: Frame) -> bool:
        """As Port.send."""
        sent = super().send(frame)
        if sent and frame.can_id == self._echo_id:
            self._echoes.append(Frame(frame.can_id, frame.data, frame.flags | ECHO, stamp(_monotonic_ns())))
        return sent

    def drain(self, now_ns: int) -> list[Frame]:
        """As Port.drain, with the echoes where they belong in time; none takes the place of a frame received."""
        frames = super().drain(now_ns)
        if self._echoes:
            self._counts[_ECHO] += len(self._echoes)
            frames = self._echoes[: self._receive_limit - len(frames)] + frames
            sort_by_time(frames)
            self._echoes = []
        return frames


def _wall_offset() -> int:
    """CLOCK_REALTIME - CLOCK_MONOTONIC, ns; read until nothing has come between the readings."""
    for _ in range(3):
        before_ns = monotonic_ns()
        wall_ns = time_ns()
        after_ns = monotonic_ns()
        if after_ns - before_ns < _CLOCKS_READ_NS:
            break
    return wall_ns - after_ns


def resolve_interface(bus: BusConfig) -> str:
    """Which kind of bus `bus` means on this machine: "auto" is SocketCAN where the named CAN interface exists. Others
    than socketcan and local are python-can's (any_bus.py).
    """
    if bus.interface == "auto":
        return "socketcan" if is_can_interface(bus.channel) else "local"
    return bus.interface


def open_port(bus: BusConfig, *, role: Role, fd: bool, echo_id: int | None = None) -> Port:
    """Open the bus of a rig for its host or for its devices; one of several segments is segmented_port.py's.

    fd: the layout uses CAN FD. echo_id: of own frames that are to be given back, marked ECHO and stamped with when they
    were out. Raises PortError. "auto" falls back to the local bus only where no CAN interface of that name exists. One
    that exists and cannot be opened is an error, as a rig must not talk to an empty local bus by mistake.
    """

    def local() -> Medium:
        depth = _HOST_DEPTH * bus.receive_limit if role == "host" else bus.transmit_queue
        return LocalMedium(bus.channel, depth=depth)

    def socketcan() -> Medium:
        echo = echo_id is not None
        return SocketCanMedium(bus.channel, fd=fd, transmit_queue=bus.transmit_queue, echo=echo)

    kind = resolve_interface(bus)
    if kind not in KERNEL_INTERFACES:
        raise PortError(
            f"bus.interface = '{kind}': the control loop and emulated drives run on SocketCAN or the local bus alone; "
            "use the adapter's kernel driver (hil doctor knows the commands). hil bus, hil drives and hil bench bus "
            "take any interface of python-can"
        )
    try:
        if kind == "socketcan":
            _require_fd(bus.channel, fd)
            return Port(socketcan, fd=fd, receive_limit=bus.receive_limit, echo_id=echo_id)
        port = Port if echo_id is None else EchoingPort
        return port(local, fd=fd, receive_limit=bus.receive_limit, echo_id=echo_id)
    except (OSError, RuntimeDirectoryError) as error:
        raise PortError(f"bus.channel = '{bus.channel}' ({kind}): {_explain(error)}") from error


def _require_fd(channel: str, fd: bool) -> None:
    """Raise OSError when the interface exists and cannot carry FD frames."""
    try:
        mtu = int(Path(f"/sys/class/net/{channel}/mtu").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return
    if fd and mtu < CANFD_MTU:
        raise OSError(
            errno.EINVAL,
            f"the interface is set up for classic CAN; ip link set {channel} down; "
            f"ip link set {channel} type can bitrate ... dbitrate ... fd on (vcan: ip link set {channel} mtu 72)",
        )


def _explain(error: Exception) -> str:
    number = error.errno if isinstance(error, OSError) else None
    if number == errno.EAFNOSUPPORT:
        return (
            "this process may not use AF_CAN: the kernel has no CAN (modprobe can_raw), or systemd's "
            "RestrictAddressFamilies= does not list AF_CAN"
        )
    if number == errno.ENODEV:
        return 'no such interface; see `ip link`, or say bus.interface = "local"'
    return words_of(error)
