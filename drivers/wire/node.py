"""One controller on the simulated CAN segment: its transmit queue, its error counters, what its driver would report."""

from collections import deque
from collections.abc import Callable, Container
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from drivers.bus.counters import BusState, PortCounters
from drivers.frame import BRS, EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK, Frame
from drivers.frame_length import ACK_TO_EOF, frame_bits

if TYPE_CHECKING:
    from drivers.wire.wire import Wire

PASSIVE_LIMIT = 127  # TEC or REC above it: error-passive (ISO 11898-1:2015, 12.1.4)
BUS_OFF_LIMIT = 255  # TEC above it: bus-off

Entry = tuple[int, int, Frame, int]
READY: Final = 0  # of an Entry: earliest start, ns
KEY: Final = 1  # arbitration key
FRAME: Final = 2
DURATION: Final = 3  # SOF to EOF, ns


@lru_cache(maxsize=4096)
def arbitration_key(can_id: int) -> int:
    """The arbitration field as an integer: of two frames that begin together the one with the lower key wins.

    11-bit identifiers: id, RTR, IDE = 0. 29-bit ones: base id, SRR = 1, IDE = 1, extension, RTR. So a base frame beats
    an extended frame with the same first 11 bits, and data beats remote.
    """
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        return (identifier >> 18) << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return (can_id & STANDARD_MASK) << 21 | remote << 20


class WireNode:
    """A node with `fifo` queues as a qdisc does: its oldest frame alone sits in the controller and arbitrates. Without,
    it has a transmit buffer for each message, as drives do: its most urgent frame arbitrates.

    Made by `Wire.attach`. sent, received, refused, errors, no_ack, bus_off, restarted, down: cumulative, as in
    `PortCounters`. tec, rec: transmit and receive error counter. queue: what is not sent yet, the frame on the wire
    included. The other public attributes serve the simulation.
    """

    __slots__ = (
        "_wire",
        "accept",
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
        wire: "Wire",
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
        self.repeating = False  # the others have taken the oldest frame already
        self.on_sent: Callable[[int], None] | None = None
        self.targets: dict[int, tuple[WireNode, ...]] = {}  # who takes a frame of this node, by identifier
        self._wire = wire

    def send(self, frame: Frame, at_ns: int) -> bool:
        """Queue a frame that may start at `at_ns` (virtual ns, not before the wire's own time).

        False: refused, because the queue is full (ENOBUFS), the interface is down (ENETDOWN) or the node is bus-off.
        Raises ValueError for a time in the past and for a payload length the format does not have.
        """
        wire = self._wire
        now_ns = wire.now_ns
        if at_ns < now_ns:
            raise ValueError(f"node {self.name}: send at {at_ns} ns, but the wire is at {now_ns} ns")
        if not self.fifo and at_ns > now_ns:
            wire.at(at_ns, self.send, frame, at_ns)  # it takes its place among the others when it is due
            return True
        queue = self.queue
        if len(queue) >= self.queue_length or self.is_bus_off or not self.interface_up:
            if self.interface_up:
                self.refused += 1
            else:
                self.down += 1
            return False
        nominal, fast = wire.frame_bits(frame)
        if at_ns < self.ready_ns:
            at_ns = self.ready_ns
        entry = (at_ns, arbitration_key(frame[0]), frame, wire.nominal_ns[nominal] + wire.data_ns[fast])
        if self.fifo or not queue:
            queue.append(entry)
        else:
            self._insert(entry)
        if len(queue) == 1:
            if self.cut_off:
                wire.node_faults.attempt_next(self)
            else:
                wire.waiting.append(self)
        return True

    def _insert(self, entry: Entry) -> None:
        """Before what is less urgent and not on the wire."""
        position = 1 if self._wire.sender is self or self.repeating else 0
        while position < len(self.queue) and self.queue[position][KEY] <= entry[KEY]:
            position += 1
        self.queue.insert(position, entry)

    def purge(self) -> int:
        """Drop what is queued, except a frame on the wire at this moment. Returns how many were dropped."""
        queue = self.queue
        keep = 1 if self._wire.sender is self else 0
        dropped = len(queue) - keep
        while len(queue) > keep:
            queue.pop()
        if not queue:
            self.repeating = False
            if self in self._wire.waiting:
                self._wire.waiting.remove(self)
        return dropped

    def restart(self, at_ns: int) -> None:
        """Ask for recovery from bus-off: 128 times 11 recessive bits on the bus later the node is error-active."""
        self._wire.confinement.restart(self, at_ns)

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


def elapsed_ns(frame: Frame, bit: int, nominal_ns: list[int], data_ns: list[int]) -> int:
    """Time from SOF to the end of bit `bit` (0: SOF) of a frame; bits behind its last one count as its last."""
    nominal, fast = frame_bits(frame)
    done = min(bit + 1, nominal + fast)
    if not frame.flags & BRS:
        return nominal_ns[done]
    in_data_phase = min(max(done - (nominal - ACK_TO_EOF), 0), fast)
    return nominal_ns[done - in_data_phase] + data_ns[in_data_phase]
