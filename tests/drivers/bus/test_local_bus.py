"""The local bus: everyone but the sender hears a frame; who dies vanishes; who stops reading harms only himself."""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.bus import local_channel
from drivers.bus.counters import BusState
from drivers.bus.local_channel import channel_dir
from drivers.bus.local_link import FIRST_DEPTH, Link
from drivers.bus.local_medium import LocalMedium
from drivers.bus.port import Port, PortCounters, PortError, open_port
from drivers.config import BusConfig
from drivers.frame import BRS, FD, Frame, to_bytes
from tests.drivers.bus.conftest import OpenPort
from tests.support.local_member import HELLO, PING, PONG, STOP
from tests.support.paths import ROOT

PATIENCE_S = 20.0  # only a failing test waits this long


@pytest.fixture
def member() -> Iterator[Callable[[str], "subprocess.Popen[str]"]]:
    """Starts member processes on "can0"; none outlives the test."""
    processes: list[subprocess.Popen[str]] = []

    def start(manner: str) -> "subprocess.Popen[str]":
        processes.append(
            subprocess.Popen(
                [sys.executable, "-m", "tests.support.local_member", "can0", manner],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                cwd=ROOT,
            )
        )
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def take(port: Port) -> list[tuple[int, bytes]]:
    return [(frame.can_id, frame.data) for frame in port.drain(time.monotonic_ns())]


def wait_for(port: Port, can_id: int, number: int = 1) -> Frame:
    """The next frame with this identifier, or the last of the next `number`; fails the test when they do not come."""
    deadline = time.monotonic() + PATIENCE_S
    poll = select.poll()
    poll.register(port.fileno(), select.POLLIN)
    found: list[Frame] = []
    while len(found) < number:
        if time.monotonic() > deadline:
            pytest.fail(f"{len(found)} of {number} frames {can_id:#x} within {PATIENCE_S} s")
        poll.poll(100)
        found += [frame for frame in port.drain(time.monotonic_ns()) if frame.can_id == can_id]
    return found[-1]


def test_everyone_but_the_sender_hears_a_frame(join: OpenPort) -> None:
    first, second, third = join(), join("device"), join("device")
    assert second.send(Frame(0x123, bytes(24), FD | BRS))
    for other in (first, third):
        (frame,) = other.drain(time.monotonic_ns())
        assert frame._replace(timestamp_ns=0) == Frame(0x123, bytes(24), FD | BRS)
        assert 0 < frame.timestamp_ns <= time.monotonic_ns()
    assert take(second) == []


@pytest.mark.parametrize("senders", [2, 3, 7])
def test_frames_of_several_senders_come_out_in_the_order_in_which_they_were_sent(join: OpenPort, senders: int) -> None:
    host, devices = join(), [join("device") for _ in range(senders)]
    assert take(host) == []  # takes them in
    for number in range(12):
        devices[number % senders].send(Frame(0x100 + number, b""))
    assert [can_id for can_id, _ in take(host)] == [0x100 + number for number in range(12)]


def test_a_lone_sender_is_told_that_nobody_acknowledged(join: OpenPort) -> None:
    port = join()
    assert port.send(Frame(1, b""))
    assert port.counters() == PortCounters(sent=1, errors=1, no_ack=1)


def test_a_member_hears_what_is_sent_after_it_has_joined_and_nothing_from_before(join: OpenPort) -> None:
    sender = join()
    sender.send(Frame(1, b"before"))
    late = join()
    sender.send(Frame(1, b"after"))
    assert take(late) == [(1, b"after")]


def test_a_member_that_leaves_is_noticed_by_the_next_frame(join: OpenPort) -> None:
    stays, leaves = join(), join()
    leaves.send(Frame(2, b"goodbye"))
    leaves.close()
    stays.send(Frame(1, b""))
    assert take(stays) == [(2, b"goodbye")]
    assert stays.counters().no_ack == 1
    assert (stays.counters().down, stays.counters().state) == (0, BusState.ERROR_ACTIVE)


def test_channels_are_separate_buses(join: OpenPort) -> None:
    here, there = join(channel="can0"), join(channel="can1")
    here.send(Frame(1, b""))
    assert take(there) == []


def test_nothing_is_left_behind_and_nobody_else_may_enter(join: OpenPort) -> None:
    ports = [join(), join()]
    directory = channel_dir("can0")
    assert len(list(directory.glob("*.sock"))) == 2
    assert directory.stat().st_mode & 0o077 == 0
    for port in ports:
        port.close()
    assert list(directory.glob("*.sock")) == []


def test_who_leaves_keeps_nothing_open() -> None:
    def left_open() -> int:
        LocalMedium("can0", depth=8).close()
        return len(os.listdir("/proc/self/fd"))

    assert left_open() == left_open()


def test_a_path_too_long_for_a_socket_address_works_too(
    join: OpenPort, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / ("long" * 40)))
    first, second = join(), join()
    first.send(Frame(1, b"x"))
    assert take(second) == [(1, b"x")]


STEPS = st.lists(st.tuples(st.sampled_from(["join", "leave", "send"]), st.integers(0, 7)), max_size=40)
_names = count()


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(STEPS)
def test_whoever_joins_or_leaves_each_frame_reaches_exactly_the_others(steps: list[tuple[str, int]]) -> None:
    config = BusConfig(interface="local", channel=f"steps{next(_names)}")
    members: list[Port] = []
    expected: dict[Port, list[tuple[int, bytes]]] = {}
    for number, (what, which) in enumerate(steps):
        if what == "join" and len(members) < 6:
            members.append(open_port(config, role="host", fd=False))
            expected[members[-1]] = []
        elif members and what == "leave":
            port = members.pop(which % len(members))
            assert sorted(take(port)) == expected.pop(port)
            port.close()
        elif members:
            sender = members[which % len(members)]
            assert sender.send(Frame(number, b"data"))
            for port in members:
                if port is not sender:
                    expected[port].append((number, b"data"))
    for port in members:
        assert sorted(take(port)) == expected[port]  # numbered in the order of sending
        assert port.counters().overflow == 0
        port.close()


def test_a_full_member_loses_frames_alone_and_is_told_how_many(join: OpenPort) -> None:
    sender, reads, sleeps = join(), join(receive_limit=32), join("device", transmit_queue=16)
    take(sender)  # the handshakes, with the depths
    for number in range(300):
        assert sender.send(Frame(0x100, number.to_bytes(2, "little")))
        assert take(reads) == [(0x100, number.to_bytes(2, "little"))]
    assert sender.counters() == PortCounters(sent=300)
    assert reads.counters() == PortCounters(received=300)
    kept = take(sleeps)
    assert kept == [(0x100, number.to_bytes(2, "little")) for number in range(16)]
    sender.send(Frame(0x101, b""))  # behind two notices, as one can tell of 255 losses
    assert take(sleeps) == [(0x101, b"")]
    assert sleeps.counters() == PortCounters(received=17, errors=2, overflow=284)


def test_a_bus_of_full_members_refuses_a_frame_like_a_full_transmit_queue(join: OpenPort) -> None:
    sender, device = join(), join("device", transmit_queue=10)
    take(sender)
    assert [sender.send(Frame(1, b"")) for _ in range(13)] == [True] * 10 + [False] * 3
    assert sender.counters() == PortCounters(sent=10, refused=3)
    assert not sender.purge()
    assert len(take(device)) == 10
    assert sender.purge()
    assert sender.send(Frame(1, b""))


def test_of_a_member_that_left_and_was_heard_out_nothing_is_kept_once_something_is_sent(join: OpenPort) -> None:
    stays, leaves = join("device"), join()
    for port in (stays, leaves):
        take(port)
    leaves.close()
    assert len(stays._medium._by_fd) == 1
    assert stays.send(Frame(1, b""))
    assert (len(stays._medium._by_fd), stays.counters().no_ack) == (0, 1)


def test_a_host_that_did_not_read_for_a_while_sees_a_flood_as_one(join: OpenPort) -> None:
    """Twice what a drain returns is kept for it: frames were discarded, it is told, not that just so many came."""
    sender, host = join("device"), join(receive_limit=16)
    for port in (sender, host):
        take(port)
    assert sum(sender.send(Frame(1, bytes((number,)))) for number in range(100)) == 2 * 16
    assert take(host) == [(1, bytes((number,))) for number in range(16, 32)]
    assert host.counters().discarded == 16


@pytest.mark.parametrize("reader_joins_first", [True, False])
def test_a_queue_is_as_deep_as_its_reader_asked_for_though_it_has_never_read(
    join: OpenPort, reader_joins_first: bool
) -> None:
    if reader_joins_first:
        reader, sender = join("device", transmit_queue=30), join()
    else:
        sender, reader = join(), join("device", transmit_queue=30)
    assert sum(sender.send(Frame(1, b"")) for _ in range(100)) == 30 - reader_joins_first  # the sender's handshake
    assert len(take(reader)) == 30 - reader_joins_first


def test_a_handshake_that_comes_late_is_adopted_when_the_queue_runs_full() -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    link = Link(here)
    assert sum(link.deliver(to_bytes(Frame(1, b""))) for _ in range(50)) == FIRST_DEPTH
    Link(there).send_handshake(30)
    assert sum(link.deliver(to_bytes(Frame(2, b""))) for _ in range(50)) == 30 - FIRST_DEPTH - 1  # one is the notice
    link.close()
    there.close()


def test_the_two_halves_of_a_rig_meet_across_processes(join: OpenPort, member: Callable[[str], object]) -> None:
    host = join()
    member("echo")
    wait_for(host, HELLO)
    host.send(Frame(PING, b"here"))
    assert wait_for(host, PONG).data == b"here"


def test_a_killed_member_vanishes(join: OpenPort, member: "Callable[[str], subprocess.Popen[str]]") -> None:
    host, witness = join(), join()
    victim = member("echo")
    wait_for(host, HELLO)
    directory = channel_dir("can0")
    assert len(list(directory.glob(f"{victim.pid}-*.sock"))) == 1
    victim.kill()
    victim.wait()
    witness.close()
    host.send(Frame(PING, b""))
    assert host.counters().no_ack == 1  # nobody left
    newcomer = join()
    assert list(directory.glob(f"{victim.pid}-*.sock")) == []  # swept by the next to join
    newcomer.send(Frame(1, b"just us"))
    assert take(host) == [(1, b"just us")]


def test_a_stopped_process_stalls_nobody_and_learns_what_it_missed(
    join: OpenPort, member: "Callable[[str], subprocess.Popen[str]]"
) -> None:
    host = join()
    lame, lively = member("count"), member("echo")
    wait_for(host, HELLO, 2)
    os.kill(lame.pid, signal.SIGSTOP)
    os.waitpid(lame.pid, os.WUNTRACED)
    total = 400
    for number in range(total):
        assert host.send(Frame(PING, number.to_bytes(2, "little")))
        assert wait_for(host, PONG).data == number.to_bytes(2, "little")
    os.kill(lame.pid, signal.SIGCONT)
    while lame.poll() is None:  # its queue is full of old frames until it has read them
        host.send(Frame(STOP, b""))
        take(host)
    assert lively.wait(PATIENCE_S) == 0
    assert lame.stdout is not None
    received, lost = map(int, lame.stdout.read().split())
    assert received + lost >= total
    assert lost >= total - 2 * 32  # twice its receive limit may wait


def test_a_member_stopped_while_joining_is_named_as_the_reason(join: OpenPort, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_channel, "JOIN_TIMEOUT_S", 0.05)
    with (
        local_channel.locked(channel_dir("can0")),
        pytest.raises(PortError, match=r"another process has been joining this bus for 0\.05 s; is one stopped"),
    ):
        join()


def test_a_member_that_waits_accepts_a_join_before_the_other_has_joined(join: OpenPort) -> None:
    """It may have precedence on the core on which the other is joining: waking for nothing would keep that one out."""
    waits = join("device")
    poll = select.poll()
    poll.register(waits.fileno(), select.POLLIN)
    (listening,) = channel_dir("can0").glob("*.sock")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as joining:
        joining.connect(str(listening))  # the first thing that joining does; counting up is the last
        assert poll.poll(0)
        assert take(waits) == []
        assert not poll.poll(0)
        joining.send(to_bytes(Frame(1, b"in")))
        assert take(waits) == [(1, b"in")]
        waits.send(Frame(2, b"out"))
        assert joining.recv(100) == to_bytes(Frame(2, b"out"))


def test_a_local_bus_can_be_rebound(join: OpenPort) -> None:
    host, device = join(), join("device")
    assert host.rebind()
    host.send(Frame(1, b""))
    assert take(device) == [(1, b"")]
    assert host.counters() == PortCounters(sent=1)


def test_a_member_whose_descriptor_another_thread_has_closed_is_left_out(join: OpenPort) -> None:
    with contextlib.closing(LocalMedium("can0", depth=8)) as medium:
        port = join()
        port.send(Frame(0x10, b"here", FD))
        assert medium.transmit(to_bytes(Frame(0x11, b"here", FD)))
        (link,) = medium._links
        link.close()  # while a sending thread still has it in hand
        medium._part(link)
        assert medium._links == ()
        assert medium.transmit(to_bytes(Frame(0x12, b"gone", FD))) is False
