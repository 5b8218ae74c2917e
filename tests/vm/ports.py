"""Opening the project's own Port on a kernel interface, and waiting for what a real bus delivers in its own time."""

import select
import time
from collections.abc import Callable

from drivers.bus.port import Port, open_port
from drivers.config import BusConfig
from drivers.frame import Frame
from tests.vm import links


def bus_config(channel: str, **values: object) -> BusConfig:
    """[bus] of a rig on a kernel interface: never the local bus by mistake."""
    return BusConfig.model_validate({"interface": "socketcan", "channel": channel, **values})


def port_on(channel: str, *, fd: bool = True, **values: object) -> Port:
    """A host's port."""
    return open_port(bus_config(channel, **values), role="host", fd=fd)


def receive(port: Port, count: int) -> list[Frame]:
    """The next `count` frames; fails when they do not come."""
    frames: list[Frame] = []
    deadline = time.monotonic() + links.PATIENCE_S
    while len(frames) < count:
        frames += port.drain(time.monotonic_ns())
        if len(frames) < count:
            assert time.monotonic() < deadline, f"{len(frames)} of {count} frames came: {frames}"
            select.select([port.fileno()], [], [], 1.0)
    return frames


def drained_until(port: Port, holds: Callable[[], object], what: str) -> list[Frame]:
    """Drain until something about the port holds; returns all frames that came meanwhile."""
    frames: list[Frame] = []

    def look() -> object:
        frames.extend(port.drain(time.monotonic_ns()))
        return holds()

    links.eventually(look, what)
    return frames
