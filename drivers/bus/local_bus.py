"""The python-can interface "local": a CAN bus between the processes of one machine, without root or kernel modules.

    with can.Bus(interface="local", channel="can0", fd=True) as bus:
        bus.send(can.Message(arbitration_id=0x123, data=[1, 2, 3], is_extended_id=False))

It is for tools and tests; a control loop takes drivers.bus.port.Port, which sits on the same medium and is several
times faster. The module drivers/bus/local_medium.py says how the bus works and what happens to members that die or stop
reading.
"""

import errno
import socket
import struct
import time

import can
from can.bus import BusABC, CanProtocol
from can.typechecking import AutoDetectedConfig, CanFilters, Channel

from drivers.base.runtime import RuntimeDirectoryError
from drivers.bus.local_channel import channels
from drivers.bus.local_medium import LocalMedium
from drivers.bus.recvmmsg import SO_TIMESTAMPNS
from drivers.frame import (
    BRS,
    CANFD_MTU,
    ERROR,
    ESI,
    EXTENDED,
    EXTENDED_MASK,
    FD,
    REMOTE,
    STANDARD_MASK,
    Frame,
    from_bytes,
    to_bytes,
)

RECEIVE_QUEUE = 2048  # frames; programs send in bursts of a thousand, as no other bus of python-can minds
_CONTROL_SPACE = socket.CMSG_SPACE(struct.calcsize("@ll"))
_TIMESPEC = struct.Struct("@ll")
_RETRY_S = 0.001


class LocalBus(BusABC):
    """One member of a local bus, with python-can's usual behaviour."""

    def __init__(
        self,
        channel: Channel | None = None,
        can_filters: CanFilters | None = None,
        fd: bool = False,
        receive_own_messages: bool = False,
        receive_queue: int = RECEIVE_QUEUE,
        **kwargs: object,
    ) -> None:
        """Join the bus `channel`, "can0" where none is given; a number is a name, too.

        fd: take part in CAN FD traffic; without it FD frames are not received and cannot be sent, as with SocketCAN.
        receive_queue: frames that may wait to be read; more are lost, and an error frame tells how many.
        Raises can.CanInitializationError.
        """
        channel = "can0" if channel is None else channel
        try:
            self._medium = LocalMedium(str(channel), depth=receive_queue, loopback=receive_own_messages)
        except (OSError, ValueError, RuntimeDirectoryError) as error:
            raise can.CanInitializationError(f"local bus '{channel}': {error}") from error
        self._fd = fd
        self.channel = channel
        self.channel_info = f"local bus '{channel}'"
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """Readable when a message may have arrived."""
        self._check_open()
        return self._medium.fileno()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check_open()
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left = -1.0 if deadline is None else max(0.0, deadline - time.monotonic())
            sources = self._medium.wait(left)
            for fd in sources:
                message = self._read(fd)
                if message is not None:
                    return message, False
            if not sources and left == 0.0:
                return None, False

    def _read(self, fd: int) -> can.Message | None:
        """One message from one member; None for its handshake, its leaving, and FD frames that are not wanted."""
        link = self._medium.link(fd)
        if link is None:
            return None
        try:
            packet, control, _, _ = link.sock.recvmsg(CANFD_MTU, _CONTROL_SPACE, socket.MSG_DONTWAIT)
        except OSError:  # another thread was faster; or the member left without reading: its last frames follow
            return None
        if not packet:
            self._medium.lost(fd)
            return None
        frame = from_bytes(packet)
        if frame is None:
            self._medium.service(fd, packet)
            return None
        if frame.flags & FD and not self._fd:
            return None
        return to_message(frame, _stamp(control), self.channel, is_rx=not link.own)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send to every other member.

        timeout: seconds to wait for room when it fits into nobody's queue; none by default. Raises
        can.CanOperationError when there was none. That nobody is there at all is no error, as on a vcan interface.
        """
        self._check_open()
        if msg.is_fd and not self._fd:
            raise can.CanOperationError("an FD frame on a bus opened without fd=True")
        try:
            packet = to_bytes(from_message(msg))
        except ValueError as error:
            raise can.CanOperationError(str(error)) from error
        deadline = time.monotonic() + (timeout or 0.0)
        while True:
            try:
                self._medium.transmit(packet)
                return
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    raise can.CanOperationError("Transmit buffer full", errno.ENOBUFS) from None
                time.sleep(_RETRY_S)

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("Cannot operate on a closed bus")

    def shutdown(self) -> None:
        """Leave the bus; may be called again."""
        if not self._is_shutdown:
            super().shutdown()
            self._medium.close()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": "local", "channel": name} for name in channels()]


def to_message(frame: Frame, timestamp: float, channel: Channel | None = None, *, is_rx: bool = True) -> can.Message:
    """A frame as python-can's Message; timestamp in seconds."""
    can_id, data, flags, _ = frame
    extended = bool(can_id & EXTENDED)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=can_id & (EXTENDED_MASK if extended or can_id & ERROR else STANDARD_MASK),
        is_extended_id=extended,
        is_remote_frame=bool(can_id & REMOTE),
        is_error_frame=bool(can_id & ERROR),
        channel=channel,
        dlc=len(data),
        data=b"" if can_id & REMOTE else data,
        is_fd=bool(flags & FD),
        is_rx=is_rx,
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
    )


def from_message(message: can.Message) -> Frame:
    """python-can's Message as a frame; without its time."""
    can_id = message.arbitration_id
    can_id |= EXTENDED if message.is_extended_id else 0
    can_id |= REMOTE if message.is_remote_frame else 0
    can_id |= ERROR if message.is_error_frame else 0
    flags = 0
    if message.is_fd:
        flags = FD | (BRS if message.bitrate_switch else 0) | (ESI if message.error_state_indicator else 0)
    # A remote frame has a length and no data; in Linux' terms it is as long as the answer it asks for.
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return Frame(can_id, data, flags)


def _stamp(control: list[tuple[int, int, bytes]]) -> float:
    for level, kind, content in control:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
            seconds, nanoseconds = _TIMESPEC.unpack_from(content)
            return float(seconds + nanoseconds * 1e-9)
    return time.time()
