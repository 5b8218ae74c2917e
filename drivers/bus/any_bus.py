"""A bus through any interface of python-can, for tools: adapters without a driver in the kernel, too.

The control loop and emulated drives take drivers.bus.port instead, on SocketCAN or the local bus: an adapter's library
in user space waits, allocates and locks when it likes.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import Empty, Queue
from threading import Event, Thread
from time import monotonic_ns
from typing import Any

import can

from drivers.base.text_file import words_of
from drivers.bus.local_bus import from_message, to_message
from drivers.bus.port import PortError, resolve_interface
from drivers.config import KERNEL_INTERFACES, BusConfig
from drivers.frame import Frame

MOST_FRAMES = 256  # of one drain; more is a flood, and is left for the next
_POLL_S = 0.05


def open_bus(config: BusConfig, *, fd: bool = True) -> can.BusABC:
    """Join the bus of a rig, or one named by options. fd: with CAN FD, where the adapter is not told by its options.

    Raises PortError: no such interface, its library is missing, or it refuses.
    """
    name = resolve_interface(config)
    options: dict[str, Any] = dict(config.options)
    if name in KERNEL_INTERFACES:
        options["fd"] = fd
    else:
        options.setdefault("bitrate", config.bitrate)
        if fd and options.get("fd"):
            options.setdefault("data_bitrate", config.data_bitrate)
    channel: str | int = int(config.channel) if config.channel.isdecimal() else config.channel
    try:
        return can.Bus(interface=name, channel=channel, **options)
    except can.CanInterfaceNotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise PortError(f"bus.interface = '{name}': {error}; python-can knows {known}") from error
    except Exception as error:  # each adapter's library fails in its own way
        raise PortError(f"bus.channel = '{config.channel}' ({name}): {words_of(error)}") from error


class AnyPort:
    """What bring-up and measurements need of a Port. A thread reads, and stamps each frame when it has come.

    refused: frames that could not be sent. failed: attempts to read from a bus that is down.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.refused = 0
        self.failed = 0
        # No SimpleQueue: a signal at the end of its time-out makes CPython 3.11 wait for ever (a negative time left).
        self._frames: Queue[Frame] = Queue()
        self._closing = Event()
        self._reader = Thread(target=self._read, daemon=True, name=f"read {bus.channel_info}")
        self._reader.start()

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(_POLL_S)
            except can.CanError:  # the interface is down, or its adapter gone
                self.failed += 1
                self._closing.wait(_POLL_S)
                continue
            if message is not None and not message.is_error_frame:
                self._frames.put(from_message(message)._replace(timestamp_ns=monotonic_ns()))

    def drain(self, now_ns: int) -> list[Frame]:
        """What has arrived, error frames apart; now_ns is not looked at."""
        frames: list[Frame] = []
        with suppress(Empty):
            while len(frames) < MOST_FRAMES:
                frames.append(self._frames.get_nowait())
        return frames

    def wait(self, timeout_s: float) -> Frame | None:
        """The next frame; None where none came in that time."""
        try:
            return self._frames.get(timeout=timeout_s)
        except Empty:
            return None

    def send(self, frame: Frame) -> bool:
        """Send a frame; False where the adapter refused it, which is counted."""
        try:
            self._bus.send(to_message(frame, 0.0))
        except can.CanError:
            self.refused += 1
            return False
        return True

    def close(self) -> None:
        """Leave the bus."""
        self._closing.set()
        self._reader.join()
        self._bus.shutdown()


@contextmanager
def joined(config: BusConfig, *, fd: bool = True) -> Iterator[AnyPort]:
    """An AnyPort for as long as the context lasts. Raises PortError."""
    port = AnyPort(open_bus(config, fd=fd))
    try:
        yield port
    finally:
        port.close()
