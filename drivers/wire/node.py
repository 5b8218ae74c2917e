"""One controller on the simulated CAN segment: transmit queue, error counters, recovery, what its driver would report.

A node queues frames and takes what arrives; when its frame goes out, and what becomes of it, is the segment's affair
(wire.py). It counts its own errors, but the rules for counting are in confinement.py.
"""

from collections import deque
from collections.abc import Callable, Container
from typing import Final

from drivers.arbitration import arbitration_key
from drivers.bus.counters import BusState, PortCounters
from drivers.frame import Frame
from drivers.wire.segment import Segment

PASSIVE_LIMIT = 127  # TEC or REC above it: error-passive (ISO 11898-1:2015, 12.1.4)
BUS_OFF_LIMIT = 255  # TEC above it: bus-off
RECOVERY = 128 * 11  # recessive bits

Entry = tuple[int, int, Frame, int]
READY: Final = 0  # of an Entry: earliest start, ns
KEY: Final = 1  # arbitration key
FRAME: Final = 2
DURATION: Final = 3  # SOF to EOF, ns


class WireNode:
    """A node with `fifo` queues as a qdisc does: its oldest frame alone sits in the controller and arbitrates. Without,
    it has a transmit buffer for each message, as drives do: its most urgent frame arbitrates.

    Made by `attach`. sent, received, refused, errors, no_ack, bus_off, restarted, down: cumulative, as in
    `PortCounters`. tec, rec: transmit and receive error counter. queue: what is not sent yet, the frame on the wire
    included. The other public attributes serve the simulation.
    """

    __slots__ = (
        "_segment",
        "accept",
        "alone",
        "attempt_ns",
        "bus_off",
        "cut_off",
        "down",
        "down_faults",
        "errors",
        "fifo",
        "interface_up",
        "is_bus_off",
        "name",
        "no_ack",
        "on_sent",
        "queue",
        "queue_length",
        "ready_ns",
        "rec",
        "receive",
        "received",
        "refused",
        "repeating",
        "restarted",
        "sent",
        "targets",
        "tec",
    )

    def __init__(
        self,
        segment: "Segment[WireNode]",
        name: str,
        receive: Callable[[Frame], None] | None,
        queue_length: int,
        accept: Container[int] | None,
        fifo: bool,
    ) -> None:
        if queue_length < 1:
            raise ValueError(f"node {name}: queue_length = {queue_length}, must be at least 1")
        self.name = name
        self.receive = receive
        self.queue_length = queue_length
        self.accept = accept
        self.fifo = fifo
        self.sent = self.received = self.refused = self.errors = 0
        self.no_ack = self.bus_off = self.restarted = self.down = 0
        self.tec = self.rec = 0
        self.is_bus_off = False
        self.interface_up = True
        self.down_faults = 0  # scripted reasons for the interface to be down; windows may overlap
        self.cut_off = 0  # likewise for being cut off from the others
        self.queue: deque[Entry] = deque()
        self.ready_ns = 0  # nothing of this node starts earlier: it is suspended, or has just come back
        self.attempt_ns = -1  # its next attempt while it is cut off from the others
        self.alone: Callable[[WireNode], None] | None = None  # tries to send its frames while it is cut off
        self.repeating = False  # the others have taken the oldest frame already
        self.on_sent: Callable[[int], None] | None = None
        self.targets: dict[int, tuple[WireNode, ...]] = {}  # who takes a frame of this node, by identifier
        self._segment = segment

    def send(self, frame: Frame, at_ns: int) -> bool:
        """Queue a frame that may start at `at_ns` (virtual ns, not before the wire's own time).

        False: refused, because the queue is full (ENOBUFS), the interface is down (ENETDOWN) or the node is bus-off.
        Raises ValueError for a time in the past and for a payload length the format does not have.
        """
        segment = self._segment
        now_ns = segment.now_ns
        if at_ns < now_ns:
            raise ValueError(f"node {self.name}: send at {at_ns} ns, but the wire is at {now_ns} ns")
        if not self.fifo and at_ns > now_ns:
            segment.at(at_ns, self.send, frame, at_ns)  # it takes its place among the others when it is due
            return True
        queue = self.queue
        if len(queue) >= self.queue_length or self.is_bus_off or not self.interface_up:
            if self.interface_up:
                self.refused += 1
            else:
                self.down += 1
            return False
        nominal, fast = segment.frame_bits(frame)
        if at_ns < self.ready_ns:
            at_ns = self.ready_ns
        entry = (at_ns, arbitration_key(frame[0]), frame, segment.nominal_ns[nominal] + segment.data_ns[fast])
        if self.fifo or not queue:
            queue.append(entry)
        else:
            self._insert(entry)
        if len(queue) == 1:
            if self.alone is not None:
                self.alone(self)
            else:
                segment.waiting.append(self)
        return True

    def _insert(self, entry: Entry) -> None:
        """Before what is less urgent and not on the wire."""
        position = 1 if self._segment.sender is self or self.repeating else 0
        while position < len(self.queue) and self.queue[position][KEY] <= entry[KEY]:
            position += 1
        self.queue.insert(position, entry)

    def purge(self) -> int:
        """Drop what is queued, except a frame on the wire at this moment. Returns how many were dropped."""
        queue = self.queue
        keep = 1 if self._segment.sender is self else 0
        dropped = len(queue) - keep
        while len(queue) > keep:
            queue.pop()
        if not queue:
            self.repeating = False
            if self in self._segment.waiting:
                self._segment.waiting.remove(self)
        return dropped

    def restart(self, at_ns: int) -> None:
        """Ask for recovery from bus-off: 128 times 11 recessive bits on the bus later the node is error-active."""
        if self.is_bus_off:
            self._segment.at(at_ns, self._recover, RECOVERY * self._segment.nominal_ns[1])

    def _recover(self, idle_wanted_ns: int) -> None:
        """Wait until the bus was idle for so long. (The recessive ends of frames count, too, in a real controller: on a
        busy bus it may be back earlier.)"""
        segment = self._segment
        if idle_wanted_ns > 0:
            # The frame on the wire enters busy_ns only at its end, so what is left of it is waited for here.
            busy_before_ns = segment.busy_ns
            wait_until_ns = max(segment.now_ns, segment.free_ns) + idle_wanted_ns
            segment.at(wait_until_ns, self._check_idle, busy_before_ns)
        elif self.is_bus_off:
            self.is_bus_off = False
            self.tec = self.rec = 0
            self.restarted += 1
            self.ready_ns = segment.now_ns
            topology_changed(segment)

    def _check_idle(self, busy_before_ns: int) -> None:
        self._recover(self._segment.busy_ns - busy_before_ns)

    def take(self, frame: Frame) -> None:
        """A frame arrives at this node, if it is on the bus."""
        if self.listening and self.receive is not None:
            self.received += 1
            self.receive(frame)

    def not_before(self, ready_ns: int) -> None:
        """Nothing of this node starts before `ready_ns`."""
        self.ready_ns = ready_ns
        if self.queue and self.queue[0][READY] < ready_ns:
            _, key, frame, duration_ns = self.queue[0]
            self.queue[0] = (ready_ns, key, frame, duration_ns)

    @property
    def listening(self) -> bool:
        """Takes part in the traffic: receives and acknowledges."""
        return self.interface_up and not self.is_bus_off and not self.cut_off

    @property
    def state(self) -> BusState:
        """Fault-confinement state of the controller."""
        if not self.interface_up:
            return BusState.DOWN
        if self.is_bus_off:
            return BusState.BUS_OFF
        if self.tec > PASSIVE_LIMIT or self.rec > PASSIVE_LIMIT:
            return BusState.ERROR_PASSIVE
        return BusState.ERROR_ACTIVE

    def counters(self) -> PortCounters:
        """What a port on this node reports."""
        return PortCounters(
            self.received, self.sent, self.refused, 0, 0, self.errors, self.no_ack, self.bus_off, self.restarted,
            self.down, 0, self.state,
        )  # fmt: skip


def attach(
    segment: Segment[WireNode],
    name: str,
    receive: Callable[[Frame], None] | None,
    queue_length: int,
    accept: Container[int] | None = None,
    fifo: bool = True,
) -> WireNode:
    """Put a node on the segment; arguments and errors as in `Wire.attach`."""
    if name in segment.nodes:
        raise ValueError(f"node {name!r} is attached already")
    node = segment.nodes[name] = WireNode(segment, name, receive, queue_length, accept, fifo)
    topology_changed(segment)
    return node


def topology_changed(segment: Segment[WireNode]) -> None:
    """A node joined or left: who takes whose frames is worked out anew."""
    for node in segment.nodes.values():
        node.targets.clear()
