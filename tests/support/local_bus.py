"""Ports on the local bus, for tests of it."""

import select
import time
from collections.abc import Callable, Iterator

import pytest

from drivers.bus.port import Port, open_port
from drivers.config import BusConfig
from drivers.frame import Frame

PATIENCE_S = 20.0  # only a failing test waits this long

OpenPort = Callable[..., Port]


@pytest.fixture(name="join")
def joining() -> Iterator[OpenPort]:
    """Opens ports on the local bus "can0" and closes them at the end."""
    ports: list[Port] = []

    def open_local(role: str = "host", *, fd: bool = True, **keywords: int) -> Port:
        config = BusConfig(interface="local", **keywords)
        ports.append(open_port(config, role=role, fd=fd))  # type: ignore[arg-type]
        return ports[-1]

    yield open_local
    for port in ports:
        port.close()


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
