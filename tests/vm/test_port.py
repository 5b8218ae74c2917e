"""drivers/bus/port.py on a real CAN stack: everything that only SocketCAN can show."""

import os
import socket
import subprocess
import time
from collections.abc import Callable

import pytest

from drivers.bus.port import BusState, PortError
from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from tests.vm import links
from tests.vm.ports import drained_until, port_on, receive

pytestmark = pytest.mark.vcan


def bare(frames: list[Frame]) -> list[tuple[int, bytes, int]]:
    """Frames without their time stamps."""
    return [(frame.can_id, frame.data, frame.flags) for frame in frames]


def test_every_length_and_flag_crosses_the_kernel_unchanged(vcan: str) -> None:
    sent = [Frame(0x080 + length, bytes(range(length)), FD | BRS) for length in FD_LENGTHS]
    sent += [Frame(0x100 + length, bytes(range(length))) for length in range(9)]
    sent += [Frame(0x12345678 | EXTENDED, b"extended", FD), Frame(0x7FF, b"")]
    host, device = port_on(vcan), port_on(vcan)
    for batch in (sent[:16], sent[16:]):
        assert all(host.send(frame) for frame in batch)
        assert bare(receive(device, len(batch))) == bare(batch)
    assert host.counters().sent == device.counters().received == len(sent)
    host.close()
    device.close()


def test_a_receiver_tells_classic_from_fd_frames_of_the_same_length(vcan: str) -> None:
    host = port_on(vcan)
    links.run("cansend", vcan, "100#1122334455667788")
    links.run("cansend", vcan, "100##11122334455667788")
    links.run("cansend", vcan, "100##01122334455667788")
    frames = receive(host, 3)
    assert {frame.data for frame in frames} == {bytes.fromhex("1122334455667788")}
    assert [frame.flags & (FD | BRS) for frame in frames] == [0, FD | BRS, FD]
    host.close()


def test_candump_sees_exactly_what_a_port_sends(vcan: str) -> None:
    host = port_on(vcan)
    with links.candump(vcan, "-n", "3") as dump:
        host.send(Frame(0x080, bytes(24), FD | BRS))
        host.send(Frame(0x081, b"\x01\x02"))
        host.send(Frame(0x1ABCDEF0 | EXTENDED, b"\xff"))
        fast, classic, extended = links.dumped(dump)
    assert fast in ("080##1" + "00" * 24, "080##5" + "00" * 24)
    assert (classic, extended) == ("081#0102", "1ABCDEF0#FF")
    host.close()


def test_a_classic_port_never_hands_out_an_fd_frame(vcan: str) -> None:
    host = port_on(vcan, fd=False)
    links.run("cansend", vcan, "100##1" + "11" * 24)
    links.run("cansend", vcan, "101#22")
    assert bare(receive(host, 1)) == [(0x101, b"\x22", 0)]
    host.close()


def test_an_fd_port_on_a_classic_interface_is_refused_with_the_way_out(new_vcan: Callable[..., str]) -> None:
    classic = new_vcan(mtu=links.CAN_MTU)
    with pytest.raises(PortError, match=f"{classic}.*mtu 72"):
        port_on(classic, fd=True)


def test_an_interface_that_does_not_exist_is_named(vcan: str) -> None:
    with pytest.raises(PortError, match="nocan7"):
        port_on("nocan7")


@pytest.mark.parametrize(
    ("error_frame", "counter", "state"),
    [
        pytest.param("20000040#0000000000000000", "bus_off", BusState.BUS_OFF, id="bus-off"),
        pytest.param("20000004#0020000000000000", "errors", BusState.ERROR_PASSIVE, id="transmit passive"),
        pytest.param("20000020#0000000000000000", "no_ack", BusState.ERROR_ACTIVE, id="no acknowledgement"),
        pytest.param("20000100#0000000000000000", "restarted", BusState.ERROR_ACTIVE, id="restarted"),
        pytest.param("20000004#0001000000000000", "overflow", BusState.ERROR_ACTIVE, id="controller overflow"),
    ],
)
def test_an_error_frame_is_decoded_and_never_taken_for_traffic(
    vcan: str, error_frame: str, counter: str, state: BusState
) -> None:
    host = port_on(vcan)
    host.drain(time.monotonic_ns())
    links.run("cansend", vcan, error_frame)
    assert drained_until(host, lambda: host.counters().errors, "the error frame arrives") == []
    counters = host.counters()
    assert counters.errors == 1
    assert getattr(counters, counter) == 1
    assert counters.state is state
    host.close()


def test_own_frames_are_not_heard_again(vcan: str) -> None:
    host, device = port_on(vcan), port_on(vcan)
    host.send(Frame(0x080, b"torque"))
    device.send(Frame(0x100, b"sample"))
    receive(device, 1)
    assert bare(receive(host, 1)) == [(0x100, b"sample", 0)]
    host.close()
    device.close()


def test_own_echoes_are_counted_and_dropped_where_something_asked_the_kernel_for_them(vcan: str) -> None:
    host, device = port_on(vcan), port_on(vcan)
    with socket.socket(fileno=os.dup(host.fileno())) as same:
        same.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
    host.send(Frame(0x100, b"looks like a sample"[:8]))
    assert drained_until(host, lambda: host.counters().echo, "the echo arrives") == []
    device.send(Frame(0x100, b"sample"))
    assert bare(receive(host, 1)) == [(0x100, b"sample", 0)], "another program's frame is traffic, not an echo"
    assert host.counters().echo == 1
    host.close()
    device.close()


def test_a_remote_frame_keeps_its_flag(vcan: str) -> None:
    host = port_on(vcan)
    links.run("cansend", vcan, "100#R")
    assert receive(host, 1)[0].can_id == 0x100 | REMOTE
    host.close()


def test_time_stamps_are_monotonic_time_and_in_order(vcan: str) -> None:
    host, device = port_on(vcan), port_on(vcan)
    host.drain(time.monotonic_ns())
    before = time.monotonic_ns()
    for number in range(8):
        device.send(Frame(0x100 + number, b""))
    stamps = [frame.timestamp_ns for frame in receive(host, 8)]
    assert stamps == sorted(stamps)
    assert before - 1_000_000_000 <= stamps[0] <= stamps[-1] <= time.monotonic_ns()
    host.close()
    device.close()


def test_a_flood_is_drained_in_one_tick_and_the_newest_frames_are_kept(vcan: str) -> None:
    host, device = port_on(vcan, receive_limit=8), port_on(vcan)
    host.drain(time.monotonic_ns())
    for number in range(100):
        assert device.send(Frame(number, b""))
    links.eventually(lambda: device.counters().sent == 100, "all are sent")
    frames = drained_until(host, lambda: host.counters().received == 100, "all have arrived")
    assert [frame.can_id for frame in frames][-8:] == list(range(92, 100))
    assert host.counters().discarded == 100 - len(frames)
    host.close()
    device.close()


def test_a_receive_overflow_is_counted_frame_by_frame(vcan: str) -> None:
    host = port_on(vcan)
    links.run("cangen", vcan, "-g", "0", "-n", "3000", "-I", "123", "-L", "8")
    drained_until(host, lambda: host.counters().received > 0, "what fitted is read")
    links.run("cansend", vcan, "124#")  # the kernel tells of the loss with the next frame it delivers
    drained_until(host, lambda: host.counters().overflow > 0, "the loss is told")
    counters = host.counters()
    assert counters.received + counters.overflow == 3001
    host.close()


def test_a_full_transmit_queue_refuses_and_never_waits(vcan: str) -> None:
    links.run("tc", "qdisc", "add", "dev", vcan, "root", "netem", "limit", "1", "delay", "100s")
    host = port_on(vcan, transmit_queue=1)
    outcomes = [host.send(Frame(0x080, b"setpoint")) for _ in range(5)]
    assert outcomes[-1] is False
    counters = host.counters()
    assert counters.refused == outcomes.count(False) > 0
    assert counters.sent == outcomes.count(True)
    assert counters.state is BusState.ERROR_ACTIVE, "a full queue is not a dead bus"
    host.close()


def test_an_interface_taken_down_is_seen_and_the_port_comes_back_by_rebind(vcan: str) -> None:
    host, device = port_on(vcan), port_on(vcan)
    links.ip("link", "set", vcan, "down")
    drained_until(host, lambda: host.counters().state is BusState.DOWN, "the host sees it")
    assert host.send(Frame(0x080, b"torque")) is False
    assert host.counters().down >= 1
    assert host.rebind() is False, "still down"
    links.ip("link", "set", vcan, "up")
    assert host.rebind() is True
    assert device.rebind() is True
    assert host.send(Frame(0x080, b"again"))
    assert bare(receive(device, 1)) == [(0x080, b"again", 0)]
    assert host.counters().state is BusState.ERROR_ACTIVE
    host.close()
    device.close()


def test_an_adapter_pulled_out_and_plugged_in_again_is_found_by_rebind(vcan: str) -> None:
    host = port_on(vcan)
    links.remove(vcan)
    drained_until(host, lambda: host.counters().state is BusState.DOWN, "the host sees it")
    assert host.send(Frame(0x080, b"torque")) is False
    assert host.rebind() is False
    assert host.drain(time.monotonic_ns()) == []
    links.add_vcan(vcan)
    assert host.rebind() is True
    links.run("cansend", vcan, "100#AB")
    assert bare(receive(host, 1)) == [(0x100, b"\xab", 0)]
    host.close()


def test_removing_the_driver_module_is_seen_as_a_bus_that_is_down(vcan: str) -> None:
    host = port_on(vcan)
    try:
        links.run("rmmod", "vcan")
        drained_until(host, lambda: host.counters().state is BusState.DOWN, "the host sees it")
        assert host.send(Frame(0x080, b"torque")) is False
        assert host.rebind() is False
    finally:
        links.run("modprobe", "vcan")
    links.add_vcan(vcan)
    assert host.rebind() is True
    host.close()


def test_purge_leaves_nothing_waiting_to_be_sent(vcan: str) -> None:
    links.run("tc", "qdisc", "add", "dev", vcan, "root", "netem", "limit", "10", "delay", "100s")
    host, device = port_on(vcan), port_on(vcan)
    assert host.send(Frame(0x080, b"stale"))
    assert host.purge() is True, "root may take the interface down and up"
    links.run("tc", "qdisc", "delete", "dev", vcan, "root")
    assert host.rebind() is True
    assert device.rebind() is True
    assert host.send(Frame(0x081, b"fresh"))
    assert bare(receive(device, 1)) == [(0x081, b"fresh", 0)], "the stale torque never came"
    host.close()
    device.close()


def test_purge_leaves_an_interface_down_that_somebody_took_down(vcan: str) -> None:
    host = port_on(vcan)
    links.ip("link", "set", vcan, "down")
    assert host.purge() is True
    assert host.rebind() is False
    assert host.counters().state is BusState.DOWN
    host.close()


def test_random_foreign_traffic_in_every_format_is_survived(vcan: str) -> None:
    host = port_on(vcan)
    for options in (["-f", "-b", "-R"], ["-f", "-E"], ["-e", "-8"], ["-i"]):
        done = subprocess.run(
            ["cangen", vcan, "-g", "1", "-n", "60", "-p", "100", *options],
            capture_output=True,
            text=True,
            check=False,
            timeout=links.PATIENCE_S,
        )
        if "invalid option" in done.stderr:
            continue
        host.drain(time.monotonic_ns())
    links.run("cansend", vcan, "7FF#DEADBEEF")
    last = drained_until(host, lambda: host.counters().received > 100, "traffic arrives")
    assert host.counters().received > 100
    assert bare(last)[-1][0] == 0x7FF
    host.close()
