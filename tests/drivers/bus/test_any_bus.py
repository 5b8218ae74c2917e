"""Interfaces of python-can that are none of the kernel's: for tools, and for nothing that applies torque in a loop.

`virtual`, python-can's own bus within a process, stands for an adapter's.
"""

import signal
import threading
import time
from collections.abc import Iterator

import can
import pytest
from pydantic import ValidationError

from drivers.bus.any_bus import AnyPort, joined, open_bus
from drivers.bus.port import PortError, open_port
from drivers.config import BusConfig
from drivers.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frame

VIRTUAL = BusConfig(interface="virtual", channel="bench", options={"protocol": 1})  # CAN FD
FRAMES = [
    Frame(0x123, b"abc"),
    Frame(0x18DA0102 | EXTENDED, b""),
    Frame(0x7FF | REMOTE, bytes(5)),
    Frame(0x100, bytes(64), FD | BRS),
]


@pytest.fixture
def ports() -> Iterator[tuple[AnyPort, AnyPort]]:
    with joined(VIRTUAL) as one, joined(VIRTUAL) as other:
        yield one, other


def take(port: AnyPort, count: int) -> list[Frame]:
    frames = [port.wait(5.0) for _ in range(count)]
    return [frame for frame in frames if frame is not None] + port.drain(0)


def test_every_kind_of_frame_goes_through_it(ports: tuple[AnyPort, AnyPort]) -> None:
    one, other = ports
    before = time.monotonic_ns()
    for frame in FRAMES:
        assert one.send(frame)
    received = take(other, len(FRAMES))
    assert [frame._replace(timestamp_ns=0) for frame in received] == FRAMES
    assert all(before <= frame.timestamp_ns <= time.monotonic_ns() for frame in received)
    assert one.wait(0.0) is None


def test_a_port_that_is_closed_has_left_its_bus() -> None:
    for leave in ("close", "context"):
        bus = open_bus(BusConfig(interface="local"), fd=True)
        with joined(BusConfig(interface="local")) as port:
            other = port._bus
            assert [port.send(FRAMES[0]), bus.recv(5.0) is not None] == [True, True]
            if leave == "close":
                port.close()
        with pytest.raises(can.CanOperationError, match="closed bus"):
            other.recv(0.0)
        bus.shutdown()


def test_a_signal_at_the_end_of_a_wait_does_not_make_it_endless(ports: tuple[AnyPort, AnyPort]) -> None:
    port, other = ports
    before = signal.signal(signal.SIGALRM, lambda *_: time.sleep(0.05))  # beyond the time that was left
    rescue = threading.Timer(5.0, other.send, [Frame(0x123, b"")])
    rescue.start()
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.005)
        assert port.wait(0.02) is None
    finally:
        rescue.cancel()
        signal.signal(signal.SIGALRM, before)


def test_error_frames_are_no_traffic(ports: tuple[AnyPort, AnyPort]) -> None:
    one, other = ports
    assert one.send(Frame(ERROR | 4, bytes(8)))
    assert one.send(FRAMES[0])
    assert len(take(other, 1)) == 1
    assert other.wait(0.1) is None


def test_a_bus_that_refuses_or_fails_is_counted_and_no_exception(
    ports: tuple[AnyPort, AnyPort], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, _ = ports

    def fail(*_: object, **__: object) -> None:
        raise can.CanOperationError("the adapter is gone")

    monkeypatch.setattr(one._bus, "send", fail)
    monkeypatch.setattr(one._bus, "recv", fail)
    assert not one.send(FRAMES[0])
    assert one.drain(0) == []
    assert one.wait(0.2) is None
    assert one.refused == 1
    assert one.failed > 0


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (BusConfig(interface="no-such-thing"), "python-can knows .*slcan"),
        (BusConfig(interface="kvaser", channel="0"), r"bus\.channel = '0' \(kvaser\): "),
        (BusConfig(interface="slcan", channel="/dev/no-such-tty"), r"bus\.channel = '/dev/no-such-tty' \(slcan\): "),
    ],
    ids=lambda value: value.interface if isinstance(value, BusConfig) else "",
)
def test_what_cannot_be_opened_says_why(config: BusConfig, said: str) -> None:
    with pytest.raises(PortError, match=said):
        open_bus(config)


def test_control_loop_and_emulated_drives_refuse_it() -> None:
    with pytest.raises(PortError, match="run on SocketCAN or the local bus alone"):
        open_port(VIRTUAL, role="host", fd=True)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"interface": "local", "options": {"bitrate": 1}}, "options: none are taken"),
        ({"interface": "auto", "channel": "/dev/ttyACM0"}, "1 to 15 letters"),
        ({"interface": "p can"}, "interface"),
        ({"interface": "slcan", "channel": "a b"}, "channel"),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_rig_file(keys: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        BusConfig.model_validate(keys)
