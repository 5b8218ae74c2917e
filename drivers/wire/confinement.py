"""Error frames, error counters and bus-off on the simulated CAN segment (ISO 11898-1:2015, 10.11 and 12.1.4)."""

from typing import TYPE_CHECKING

from drivers.frame_length import INTERMISSION
from drivers.wire.node import BUS_OFF_LIMIT, PASSIVE_LIMIT, WireNode

if TYPE_CHECKING:
    from drivers.wire.wire import Wire

# bits at the nominal rate
ERROR_FRAME = 12 + 8  # the flag of the first node to see the error, the echo of the others behind it, the delimiter
UNACKNOWLEDGED = 6 + 8 - 8  # flag and delimiter, in place of the frame's own ACK delimiter and EOF
SUSPEND = 8  # an error-passive sender waits so much longer than the intermission
RECOVERY = 128 * 11


class Confinement:
    """Keeps the error counters of a wire's nodes. healthy: all of them are zero, so nothing has to be counted down."""

    def __init__(self, wire: "Wire") -> None:
        self.healthy = True
        self._wire = wire

    def failed(self, sender: WireNode) -> None:
        """A bit error seen by all nodes; its error frame has ended, and the sender will try again."""
        wire = self._wire
        senders = wire.collision or (sender,)
        wire.collision = ()
        wire.abandon()
        self._count_receive_error(senders)
        for node in senders:
            node.errors += 1
            self._count_transmit_error(node)

    def failed_in_last_bit(self, sender: WireNode) -> None:
        """The receivers have taken the frame, but its sender saw an error in the last bit of EOF and will repeat it."""
        wire = self._wire
        error_frame_ns = wire.nominal_ns[ERROR_FRAME]
        wire.free_ns += error_frame_ns
        wire.busy_ns += error_frame_ns
        sender.repeating = True
        sender.errors += 1
        self._count_transmit_error(sender)

    def not_acknowledged(self, sender: WireNode) -> None:
        """Nobody else is on the bus. The sender tries again, for ever."""
        self._wire.abandon(self._wire.nominal_ns[UNACKNOWLEDGED])
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
        return duration_ns + self._wire.nominal_ns[UNACKNOWLEDGED + INTERMISSION + suspended]

    def succeeded(self, sender: WireNode) -> None:
        """A frame went through: its sender's TEC and every receiver's REC go down by one."""
        sender.tec = max(sender.tec - 1, 0)
        if sender.tec > PASSIVE_LIMIT:
            self._suspend(sender)
        healthy = True
        for node in self._wire.nodes.values():
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
        if node in self._wire.waiting:
            self._wire.waiting.remove(node)
        self._wire.topology_changed()

    def cut_short(self, node: WireNode) -> None:
        """If the node is sending: it falls silent within its frame, and the others answer the stuff error."""
        wire = self._wire
        if wire.sender is node:
            wire.collision = ()
            wire.abandon(wire.nominal_ns[ERROR_FRAME])
            self._count_receive_error((node,))

    def restart(self, node: WireNode, at_ns: int) -> None:
        """Begin the recovery from bus-off: 128 times 11 recessive bits."""
        if node.is_bus_off:
            self._wire.at(at_ns, self._recover, node, RECOVERY * self._wire.nominal_ns[1])

    def _recover(self, node: WireNode, idle_wanted_ns: int) -> None:
        """Wait until the bus was idle for so long. (The recessive ends of frames count, too, in a real controller: on a
        busy bus it may be back earlier.)"""
        wire = self._wire
        if idle_wanted_ns > 0:
            # The frame on the wire enters busy_ns only at its end, so what is left of it is waited for here.
            busy_before_ns = wire.busy_ns
            wait_until_ns = max(wire.now_ns, wire.free_ns) + idle_wanted_ns
            wire.at(wait_until_ns, self._check_idle, node, busy_before_ns)
        elif node.is_bus_off:
            node.is_bus_off = False
            node.tec = node.rec = 0
            node.restarted += 1
            node.ready_ns = wire.now_ns
            wire.topology_changed()

    def _check_idle(self, node: WireNode, busy_before_ns: int) -> None:
        self._recover(node, self._wire.busy_ns - busy_before_ns)

    def _count_receive_error(self, senders: tuple[WireNode, ...]) -> None:
        self.healthy = False
        for node in self._wire.nodes.values():
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
        node.not_before(self._wire.free_ns + self._wire.nominal_ns[SUSPEND])
