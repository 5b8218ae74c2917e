"""What a SocketCanMedium asks of the kernel, held against <linux/can/raw.h>, <linux/sockios.h> and <linux/if.h>.

The kernel is a double that keeps one interface; the real one is asked in a virtual machine (tests/vm).
"""

import errno
import socket
from pathlib import Path
from typing import Any

import pytest

from drivers.bus import socketcan
from drivers.bus.counters import BusState
from drivers.bus.socketcan import SocketCanMedium, is_can_interface

UP, RUNNING, OTHERS = 0x1, 0x40, 0x1082  # others: IFF_BROADCAST, IFF_NOARP, IFF_MULTICAST
ERR_FILTER, RECV_OWN_MSGS, FD_FRAMES = ((101, number) for number in (2, 4, 5))  # SOL_CAN_RAW
SNDBUF, TIMESTAMPNS, RXQ_OVFL = ((1, number) for number in (7, 35, 40))  # SOL_SOCKET


class Kernel:
    """flags: of the interface can3; None: it is not there. history: what they were set to. options: of the socket."""

    def __init__(self, sys: Path) -> None:
        self.flags: int | None = UP | RUNNING | OTHERS
        self.history: list[int] = []
        self.options: dict[tuple[int, int], int] = {}
        self.kind: tuple[int, ...] = ()
        self.bound: tuple[str, ...] = ()
        self.sent: list[bytes] = []
        self.blocking = self.privileged = self.is_open = True
        self._sys = sys

    def socket(self, *kind: int) -> "Kernel":
        self.kind = kind
        return self

    def setblocking(self, blocking: bool) -> None:
        self.blocking = blocking

    def setsockopt(self, level: int, option: int, value: int) -> None:
        self.options[level, option] = value

    def bind(self, address: tuple[str, ...]) -> None:
        if address != ("can3",):
            raise OSError(errno.ENODEV, "no such device")
        self.bound = address

    def fileno(self) -> int:
        return 77

    def send(self, packet: bytes) -> int:
        self.sent.append(packet)
        return len(packet)

    def close(self) -> None:
        self.is_open = False

    def ioctl(self, asked: object, request: int, ifreq: bytes) -> bytes:
        assert (asked, len(ifreq), ifreq[:16]) == (self, 40, b"can3".ljust(16, b"\0"))
        if self.flags is None:
            raise OSError(errno.ENODEV, "no such device")
        if request == 0x8914:  # SIOCSIFFLAGS
            if not self.privileged:
                raise PermissionError(errno.EPERM, "not permitted")
            self.flags = int.from_bytes(ifreq[16:18], "little")
            self.history.append(self.flags)
        else:
            assert (request, ifreq[16:]) == (0x8913, bytes(24))  # SIOCGIFFLAGS
        return ifreq[:16] + self.flags.to_bytes(2, "little") + ifreq[18:]

    def path(self, name: str) -> Path:
        return self._sys / name.removeprefix("/sys/")

    def tell(self, name: str, text: str) -> None:
        """What sysfs says of the interface."""
        path = self.path(f"/sys/class/net/can3/{name}")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n", encoding="ascii")


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel(tmp_path)
    monkeypatch.setattr(socket, "socket", kernel.socket)
    monkeypatch.setattr(socketcan.fcntl, "ioctl", kernel.ioctl)
    monkeypatch.setattr(socketcan, "Path", kernel.path)
    return kernel


def medium(**different: Any) -> SocketCanMedium:
    return SocketCanMedium("can3", **{"fd": True, "transmit_queue": 16, **different})


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("echo", [None, False, True])
def test_a_socket_has_every_option_that_a_loop_needs(kernel: Kernel, fd: bool, echo: bool | None) -> None:
    port = medium(fd=fd, transmit_queue=10, **({} if echo is None else {"echo": echo}))
    assert kernel.kind == (socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    assert kernel.options == {
        ERR_FILTER: 0x1FFFFFFF,
        RECV_OWN_MSGS: bool(echo),
        FD_FRAMES: fd,
        TIMESTAMPNS: 1,
        RXQ_OVFL: 1,
        SNDBUF: 10 * 768 // 2,  # the kernel doubles it
    }
    assert (kernel.blocking, kernel.bound) == (False, ("can3",))
    assert (port.fileno(), port.ready()) == (77, [77])


def test_what_is_sent_goes_out_as_it_is_and_nothing_else_is_known_on_such_a_bus(kernel: Kernel) -> None:
    port = medium()
    assert port.transmit(b"a frame") is True
    assert kernel.sent == [b"a frame"]
    assert port.service(77, b"anything") is False
    port.lost(77)
    assert kernel.is_open
    port.close()
    assert not kernel.is_open


def test_a_socket_that_cannot_be_bound_is_closed(kernel: Kernel) -> None:
    with pytest.raises(OSError, match="no such device"):
        SocketCanMedium("can4", fd=True, transmit_queue=16)
    assert not kernel.is_open


@pytest.mark.parametrize(
    ("flags", "carrier", "state"),
    [
        (None, "1", BusState.DOWN),
        (OTHERS, "1", BusState.DOWN),
        (RUNNING | OTHERS, None, BusState.DOWN),
        (UP | RUNNING, "0", BusState.BUS_OFF),  # the flag is late
        (UP, "1", BusState.ERROR_ACTIVE),
        (UP | RUNNING, None, BusState.ERROR_ACTIVE),
        (UP | OTHERS, None, BusState.BUS_OFF),
    ],
)
def test_the_state_is_that_of_the_interface(
    kernel: Kernel, flags: int | None, carrier: str | None, state: BusState
) -> None:
    kernel.flags = flags
    if carrier is not None:
        kernel.tell("carrier", carrier)
    assert medium().state() is state


def test_a_purge_takes_the_interface_down_and_up_as_it_was(kernel: Kernel) -> None:
    kernel.flags = up = UP | OTHERS
    assert medium().purge() is True
    assert kernel.history == [OTHERS, up]


def test_an_interface_that_is_down_is_left_so_and_holds_nothing(kernel: Kernel) -> None:
    kernel.flags = RUNNING | OTHERS
    assert medium().purge() is True
    assert kernel.history == []


@pytest.mark.parametrize("there", [False, True])
def test_a_purge_that_is_not_permitted_says_so(kernel: Kernel, there: bool) -> None:
    kernel.privileged, kernel.flags = False, UP if there else None
    assert medium().purge() is False
    assert kernel.history == []


@pytest.mark.parametrize(("kind", "can"), [("280", True), ("1", False), ("none", False), (None, False)])
def test_an_interface_is_one_of_can_by_its_hardware_type(kernel: Kernel, kind: str | None, can: bool) -> None:
    if kind is not None:
        kernel.tell("type", kind)
    assert is_can_interface("can3") is can
