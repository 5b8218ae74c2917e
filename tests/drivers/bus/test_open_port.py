"""Which bus a rig opens, and what is said where it cannot be opened."""

import errno
import socket
from pathlib import Path
from typing import Any

import pytest

from drivers.bus.port import (
    PortError,
    open_port,
    resolve_interface,
)
from drivers.config import BusConfig


def test_auto_means_the_local_bus_where_no_can_interface_has_that_name() -> None:
    assert resolve_interface(BusConfig(channel="lo")) == "local"  # exists, but is no CAN interface
    assert resolve_interface(BusConfig(channel="nosuch0")) == "local"
    assert resolve_interface(BusConfig(interface="socketcan", channel="nosuch0")) == "socketcan"


def test_auto_means_socketcan_where_the_interface_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    def read_text(path: Path, **how: Any) -> str:
        return "280\n" if path == Path("/sys/class/net/can7/type") else honest(path, **how)

    honest = Path.read_text
    monkeypatch.setattr(Path, "read_text", read_text)
    assert resolve_interface(BusConfig(channel="can7")) == "socketcan"
    with pytest.raises(PortError, match=r"'can7' \(socketcan\): "):  # never the local bus instead
        open_port(BusConfig(channel="can7"), role="host", fd=True)


@pytest.mark.parametrize(
    ("mtu", "fd", "refused"),
    [("16", True, True), ("71", True, True), ("72", True, False), ("16", False, False), ("none", True, False)],
)
def test_an_interface_set_up_for_classic_can_takes_no_layout_with_fd(
    monkeypatch: pytest.MonkeyPatch, mtu: str, fd: bool, refused: bool
) -> None:
    def read_text(path: Path, **how: Any) -> str:
        return f"{mtu}\n" if path == Path("/sys/class/net/can7/mtu") else honest(path, **how)

    honest = Path.read_text
    monkeypatch.setattr(Path, "read_text", read_text)
    with pytest.raises(PortError, match=r"'can7' \(socketcan\): ") as said:
        open_port(BusConfig(interface="socketcan", channel="can7"), role="host", fd=fd)
    assert ("the interface is set up for classic CAN; ip link set can7 down" in str(said.value)) is refused


def test_a_socketcan_interface_that_does_not_exist_is_named() -> None:
    with pytest.raises(
        PortError, match=r"^bus\.channel = 'nosuch0' \(socketcan\): (no such interface|this process may)"
    ):
        open_port(BusConfig(interface="socketcan", channel="nosuch0"), role="host", fd=True)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(errno.EAFNOSUPPORT, "x"), "RestrictAddressFamilies= does not list AF_CAN"),
        (OSError(errno.ENODEV, "x"), "no such interface"),
        (OSError(errno.EPERM, "Operation not permitted"), "Operation not permitted"),
    ],
)
def test_a_bus_that_cannot_be_opened_says_why(monkeypatch: pytest.MonkeyPatch, error: OSError, text: str) -> None:
    def fail(*args: object, **keywords: object) -> None:
        raise error

    monkeypatch.setattr(socket, "socket", fail)
    with pytest.raises(PortError, match=text):
        open_port(BusConfig(interface="local"), role="host", fd=True)
