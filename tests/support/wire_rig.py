"""A simulated segment with a host and four drives, for tests of the wire."""

from drivers.frame import Frame
from drivers.frame_length import frame_bits
from drivers.wire.faults import WireFault
from drivers.wire.node import WireNode
from drivers.wire.wire import Wire

BIT = 1000  # ns at 1 Mbit/s
MS = 1_000_000
COMMAND = Frame(0x080, bytes(range(8)))
FEEDBACK = [Frame(0x100 + axis, bytes([axis, 255, axis, 0, 7, 7, 7, 7])) for axis in range(4)]


class Rig:
    """A host and four drives that answer a command at its reception, on a 1 Mbit/s segment."""

    def __init__(self, *faults: WireFault, drives: int = 4, **options: object) -> None:
        self.wire = Wire(1_000_000, 5_000_000, faults=faults, **options)  # type: ignore[arg-type]
        self.at_host: list[Frame] = []
        self.at_drive: dict[str, list[Frame]] = {}
        self.host = self.wire.attach("host", self.at_host.append)
        self.drives = [self._drive(f"drive{axis}", FEEDBACK[axis]) for axis in range(drives)]

    def _drive(self, name: str, answer: Frame) -> WireNode:
        heard = self.at_drive[name] = []

        def receive(frame: Frame) -> None:
            heard.append(frame)
            node.send(answer, frame.timestamp_ns)

        node = self.wire.attach(name, receive, accept={COMMAND.can_id})
        return node

    def ticks(self, count: int, start: int = 0) -> None:
        for tick in range(start, start + count):
            self.host.send(COMMAND, tick * MS)
            self.wire.advance((tick + 1) * MS)


def bits(frame: Frame) -> int:
    return sum(frame_bits(frame))


def pair(*faults: WireFault, queue_length: int = 16) -> tuple[Wire, WireNode, list[Frame], WireNode]:
    """A sender and a listener."""
    wire = Wire(1_000_000, faults=faults)
    heard: list[Frame] = []
    sender = wire.attach("sender", None, queue_length)
    listener = wire.attach("listener", heard.append)
    return wire, sender, heard, listener
