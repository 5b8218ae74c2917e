"""Several segments in one virtual time, for a rig whose axes are on more than one.

Each is a Wire of its own; only time is common. It passes from event to event of any of them. So what the segments
share, the stage, sees its frames in the order of their time; of one instant, in the order of the segments.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import chain

from drivers.frame import Frame, on_segment
from drivers.wire.faults import WireFault
from drivers.wire.node import WireNode
from drivers.wire.wire import Wire

Receiver = Callable[[Frame], None]


class WireSegments:
    """Wires, used as one. wires: by segment; a fault of one segment alone is injected there."""

    def __init__(self, wires: Sequence[Wire]) -> None:
        self.wires = list(wires)

    @property
    def now_ns(self) -> int:
        """Time reached."""
        return self.wires[0].now_ns

    @property
    def busy_ns(self) -> int:
        """Time the busiest segment was not idle so far."""
        return max(wire.busy_ns for wire in self.wires)

    @property
    def dropped(self) -> int:
        """Frames lost silently so far, on all segments."""
        return sum(wire.dropped for wire in self.wires)

    @property
    def nominal_ns(self) -> list[int]:
        """Duration of so many bits, which is the same on all segments."""
        return self.wires[0].nominal_ns

    @property
    def nodes(self) -> Mapping[str, WireNode]:
        """All nodes by name; of a name that is on several segments the last one."""
        return dict(chain.from_iterable(wire.nodes.items() for wire in self.wires))

    def inject(self, fault: WireFault) -> None:
        """Add a fault to the script of every segment, or of those on which the node is that it names."""
        concerned = [wire for wire in self.wires if fault.node is None or fault.node in wire.nodes]
        for wire in concerned or self.wires:
            wire.inject(fault)

    def advance(self, until_ns: int) -> None:
        """As Wire.advance, of all segments."""
        while (due_ns := min(wire.next_ns for wire in self.wires)) <= until_ns:
            for wire in self.wires:
                wire.advance(due_ns)
        for wire in self.wires:
            wire.advance(until_ns)


def marking(receive: Receiver, number: int) -> Receiver:
    """A receiver on that segment, which says so in the frames."""

    def receive_marked(frame: Frame) -> None:
        receive(on_segment(frame, number))

    return receive_marked
