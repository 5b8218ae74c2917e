"""Ports on a local bus that are closed at the end of a test."""

from collections.abc import Callable, Iterator

import pytest

from drivers.bus.port import Port, open_port
from drivers.config import BusConfig

OpenPort = Callable[..., Port]


@pytest.fixture
def join() -> Iterator[OpenPort]:
    """Opens ports on the local bus "can0" and closes them at the end."""
    ports: list[Port] = []

    def open_local(role: str = "host", *, fd: bool = True, **keywords: int) -> Port:
        config = BusConfig(interface="local", **keywords)
        ports.append(open_port(config, role=role, fd=fd))  # type: ignore[arg-type]
        return ports[-1]

    yield open_local
    for port in ports:
        port.close()
