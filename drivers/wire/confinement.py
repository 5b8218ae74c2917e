"""Error frames, error counters and bus-off on the simulated CAN segment (ISO 11898-1:2015, 10.11 and 12.1.4).

Rules: a transmit error adds 8 to the sender's TEC, a receive error 1 to each receiver's REC, a success takes 1 from
both. Above 127 a node is error-passive and lets the others go first; above 255 its TEC takes it off the bus, and it
stays there until it is restarted (`WireNode.restart`).
"""

from drivers.frame_length import INTERMISSION
from drivers.wire.node import BUS_OFF_LIMIT, FRAME, PASSIVE_LIMIT, WireNode, topology_changed
from drivers.wire.segment import Segment

# bits at the nominal rate
ERROR_FRAME = 12 + 8  # the flag of the first node to see the error, the echo of the others behind it, the delimiter
UNACKNOWLEDGED = 6 + 8 - 8  # flag and delimiter, in place of the frame's own ACK delimiter and EOF
SUSPEND = 8  # an error-passive sender waits so much longer than the intermission


class Confinement:
    """Keeps the error counters of a segment's nodes. healthy: all of them are zero: there is nothing to count down."""

    def __init__(self, segment: Segment[WireNode]) -> None:
        self.healthy = True
        self._segment = segment

    def failed(self, sender: WireNode) -> None:
        """A bit error seen by all nodes; its error frame has ended, and the sender will try again."""
        segment = self._segment
        senders = segment.collision or (sender,)
        segment.collision = ()
        self._abandon()
        self._count_receive_error(senders)
        for node in senders:
            node.errors += 1
            self._count_transmit_error(node)

    def failed_in_last_bit(self, sender: WireNode) -> None:
        """The receivers have taken the frame, but its sender saw an error in the last bit of EOF and will repeat it."""
        segment = self._segment
        error_frame_ns = segment.nominal_ns[ERROR_FRAME]
        segment.free_ns += error_frame_ns
        segment.busy_ns += error_frame_ns
        sender.repeating = True
        sender.errors += 1
        self._count_transmit_error(sender)

    def not_acknowledged(self, sender: WireNode) -> None:
        """Nobody else is on the bus. The sender tries again, for ever."""
        self._abandon(self._segment.nominal_ns[UNACKNOWLEDGED])
        self.count_missing_acknowledgement(sender)
        if sender.tec > PASSIVE_LIMIT:
            self._suspend(sender)

    def count_missing_acknowledgement(self, node: WireNode) -> None:
        """An error-passive sender does not count it (exception A of rule c): TEC stops at 128, bus-off never comes."""
        self.healthy = False
        node.errors += 1
        node.no_ack += 1
        if node.tec <= PASSIVE_LIMIT:
            node.tec += 8

    def attempt_alone_ns(self, node: WireNode, duration_ns: int) -> int:
        """Time from one attempt to the next of a node that nobody hears."""
        suspended = SUSPEND if node.tec > PASSIVE_LIMIT else 0
        return duration_ns + self._segment.nominal_ns[UNACKNOWLEDGED + INTERMISSION + suspended]

    def succeeded(self, sender: WireNode) -> None:
        """A frame went through: its sender's TEC and every receiver's REC go down by one."""
        sender.tec = max(sender.tec - 1, 0)
        if sender.tec > PASSIVE_LIMIT:
            self._suspend(sender)
        healthy = True
        for node in self._segment.nodes.values():
            if node is not sender and node.listening and node.rec:
                node.rec -= 1
            healthy = healthy and not node.tec and not node.rec
        self.healthy = healthy

    def enter_bus_off(self, node: WireNode) -> None:
        """The controller leaves the bus; what its driver had queued is lost, as in the kernel when the carrier goes."""
        if not node.is_bus_off:
            node.tec = BUS_OFF_LIMIT + 1
            node.is_bus_off = True
            node.bus_off += 1
            self.silence(node)

    def silence(self, node: WireNode) -> None:
        """The node leaves the bus at once, with its queue."""
        self.cut_short(node)
        node.queue.clear()
        node.repeating = False
        if node in self._segment.waiting:
            self._segment.waiting.remove(node)
        topology_changed(self._segment)

    def cut_short(self, node: WireNode) -> None:
        """If the node is sending: it falls silent within its frame, and the others answer the stuff error."""
        segment = self._segment
        if segment.sender is node:
            segment.collision = ()
            self._abandon(segment.nominal_ns[ERROR_FRAME])
            self._count_receive_error((node,))

    def _abandon(self, error_frame_ns: int = 0) -> None:
        """The frame on the wire ends without success; the bus is free after that error frame and an intermission."""
        segment = self._segment
        sender = segment.sender
        assert sender is not None
        segment.free_ns = segment.now_ns + error_frame_ns + segment.nominal_ns[INTERMISSION]
        segment.busy_ns += segment.free_ns - segment.start_ns
        segment.sender = segment.fate = None
        if segment.observer is not None:
            segment.observer(segment.start_ns, segment.now_ns, sender.name, sender.queue[0][FRAME], False)

    def _count_receive_error(self, senders: tuple[WireNode, ...]) -> None:
        self.healthy = False
        for node in self._segment.nodes.values():
            if node not in senders and node.listening:
                node.errors += 1
                node.rec = min(node.rec + 1, PASSIVE_LIMIT + 1)

    def _count_transmit_error(self, node: WireNode) -> None:
        self.healthy = False
        node.tec += 8
        if node.tec > BUS_OFF_LIMIT:
            self.enter_bus_off(node)
        elif node.tec > PASSIVE_LIMIT:
            self._suspend(node)

    def _suspend(self, node: WireNode) -> None:
        """An error-passive sender lets the others go first."""
        node.not_before(self._segment.free_ns + self._segment.nominal_ns[SUSPEND])
