"""What the kernel itself does, which drivers/bus/port.py counts on. A new kernel that differs shows here."""

import errno
import socket
import struct
import subprocess
from collections.abc import Callable

import can
import pytest

from drivers.frame import ERROR, FD_LENGTHS
from tests.vm import links

pytestmark = pytest.mark.vcan

CAN_RAW_ERR_FILTER, SO_RXQ_OVFL, MSG_CONFIRM = 2, 40, 0x800  # linux/can/raw.h, asm-generic/socket.h, linux/socket.h
RECEIVE_S = links.PATIENCE_S


def open_bus(channel: str, **options: object) -> can.BusABC:
    return can.Bus(channel, interface="socketcan", **options)


def raw_socket(channel: str) -> socket.socket:
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind((channel,))
    raw.settimeout(RECEIVE_S)
    return raw


def error_of(call: Callable[[], object]) -> int | None:
    """errno of a system call, None when it succeeds."""
    try:
        call()
    except OSError as error:
        return error.errno
    return None


def test_every_fd_length_crosses_with_its_bit_rate_switch_flag(vcan: str) -> None:
    with open_bus(vcan, fd=True) as sender, open_bus(vcan, fd=True) as receiver:
        for length in FD_LENGTHS:
            payload = bytes(range(length))
            sender.send(
                can.Message(arbitration_id=0x123, data=payload, is_fd=True, bitrate_switch=True, is_extended_id=False)
            )
            received = receiver.recv(RECEIVE_S)
            assert received is not None
            assert (received.is_fd, received.bitrate_switch, bytes(received.data)) == (True, True, payload)


def test_a_classic_interface_refuses_fd_frames(new_vcan: Callable[..., str]) -> None:
    classic = new_vcan(mtu=links.CAN_MTU)
    with open_bus(classic, fd=True) as sender, pytest.raises(can.CanOperationError):
        sender.send(can.Message(arbitration_id=0x123, data=bytes(12), is_fd=True, is_extended_id=False))


def test_an_fd_frame_is_invisible_to_a_socket_that_did_not_ask_for_fd(vcan: str) -> None:
    with open_bus(vcan, fd=True) as sender, open_bus(vcan, fd=False) as receiver:
        sender.send(can.Message(arbitration_id=0x123, data=bytes(12), is_fd=True, is_extended_id=False))
        sender.send(can.Message(arbitration_id=0x124, data=b"classic", is_extended_id=False))
        received = receiver.recv(RECEIVE_S)
        assert received is not None
        assert received.arbitration_id == 0x124


def test_error_frames_reach_only_sockets_that_asked_for_them(vcan: str) -> None:
    bus_off = struct.pack("=IB3x8s", ERROR | 0x40, 8, bytes(8))
    with raw_socket(vcan) as sender, raw_socket(vcan) as deaf, raw_socket(vcan) as asking:
        asking.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, 0x1FFFFFFF)
        sender.send(bus_off)
        sender.send(struct.pack("=IB3x8s", 0x55, 0, bytes(8)))
        assert struct.unpack("=I", asking.recv(16)[:4])[0] == ERROR | 0x40
        assert struct.unpack("=I", deaf.recv(16)[:4])[0] == 0x55


def test_a_socket_hears_its_own_frames_only_when_it_asks(vcan: str) -> None:
    frame = struct.pack("=IB3x8s", 0x80, 8, b"setpoint")
    with raw_socket(vcan) as quiet, raw_socket(vcan) as echoing:
        echoing.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        echoing.send(frame)
        received, _, flags, _ = echoing.recvmsg(16)
        assert received == frame
        assert flags & socket.MSG_DONTROUTE, "the kernel marks what was sent on this machine"
        assert flags & MSG_CONFIRM, "sent by this very socket"
        quiet.send(frame)
        _, _, flags, _ = echoing.recvmsg(16)
        assert not flags & MSG_CONFIRM, "another socket's frame is not confirmed"


def test_a_receive_overflow_is_counted_by_the_kernel_and_keeps_the_oldest(vcan: str) -> None:
    with raw_socket(vcan) as receiver, raw_socket(vcan) as sender:
        receiver.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        for number in range(200):
            sender.send(struct.pack("=IB3x8s", number, 0, bytes(8)))
        kept = 0
        receiver.setblocking(False)
        while True:
            try:
                data, _, _, _ = receiver.recvmsg(16)
            except BlockingIOError:
                break
            assert struct.unpack("=I", data[:4])[0] == kept, "old data is what an overflow leaves"
            kept += 1
        assert 0 < kept < 200
        receiver.settimeout(RECEIVE_S)
        sender.send(struct.pack("=IB3x8s", 0x7FF, 0, bytes(8)))
        _, ancillary, _, _ = receiver.recvmsg(16, 64)
        dropped = [struct.unpack("=I", value)[0] for level, kind, value in ancillary if kind == SO_RXQ_OVFL]
        assert dropped == [200 - kept]


def test_an_interface_that_goes_down_tells_its_sockets(vcan: str) -> None:
    with raw_socket(vcan) as bound:
        links.ip("link", "set", vcan, "down")
        assert error_of(lambda: bound.recv(16)) == errno.ENETDOWN
        assert error_of(lambda: bound.send(bytes(16))) == errno.ENETDOWN
        links.ip("link", "set", vcan, "up")
        assert bound.send(struct.pack("=IB3x8s", 1, 0, bytes(8))) == 16, "up again: the same socket sends again"


def test_an_interface_that_is_removed_leaves_its_sockets_unbound(vcan: str) -> None:
    with raw_socket(vcan) as bound:
        links.remove(vcan)
        assert error_of(lambda: bound.recv(16)) in (errno.ENODEV, errno.ENETDOWN)
        assert error_of(lambda: bound.send(bytes(16))) in (errno.ENXIO, errno.ENODEV)


def test_a_short_queue_refuses_with_enobufs(vcan: str) -> None:
    links.run("tc", "qdisc", "add", "dev", vcan, "root", "netem", "limit", "1", "delay", "100s")
    frame = struct.pack("=IB3x8s", 0x80, 8, b"setpoint")
    with raw_socket(vcan) as sender:
        sender.send(frame)
        assert errno.ENOBUFS in [error_of(lambda: sender.send(frame)) for _ in range(3)]


def test_candump_and_cansend_agree_with_python_can(vcan: str) -> None:
    with open_bus(vcan, fd=True) as bus, links.candump(vcan, "-n", "2") as dump:
        bus.send(
            can.Message(arbitration_id=0x080, data=bytes(24), is_fd=True, bitrate_switch=True, is_extended_id=False)
        )
        links.run("cansend", vcan, "101##1" + "11" * 16)
        received = bus.recv(RECEIVE_S)
        assert received is not None
        assert (received.arbitration_id, bytes(received.data)) == (0x101, b"\x11" * 16)
        own, foreign = links.dumped(dump)
        assert own in ("080##1" + "00" * 24, "080##5" + "00" * 24), "bit 2 says FD once more; not every kernel shows it"
        assert foreign in ("101##1" + "11" * 16, "101##5" + "11" * 16)


def test_removing_the_module_removes_every_interface(vcan: str, new_vcan: Callable[..., str]) -> None:
    other = new_vcan()
    with raw_socket(vcan) as bound:
        subprocess.run(["rmmod", "vcan"], check=True, timeout=links.PATIENCE_S)
        try:
            assert not links.exists(vcan)
            assert not links.exists(other)
            assert error_of(lambda: bound.send(bytes(16))) in (errno.ENXIO, errno.ENODEV)
        finally:
            subprocess.run(["modprobe", "vcan"], check=True, timeout=links.PATIENCE_S)


def test_a_virtual_bus_has_no_transmit_queue_that_could_be_short(vcan: str) -> None:
    """vcan delivers within the sender's system call: txqueuelen 1 refuses nothing there. On a controller it does."""
    links.ip("link", "set", vcan, "txqueuelen", "1")
    with raw_socket(vcan) as sender:
        assert [error_of(lambda: sender.send(bytes(16))) for _ in range(200)] == [None] * 200
