"""How the scripted faults of a simulated CAN segment act: on single frames, and on whole nodes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from drivers.frame import Frame
from drivers.wire.faults import FOREVER_NS, FaultKind, WireFault
from drivers.wire.node import READY, WireNode

if TYPE_CHECKING:
    from drivers.wire.wire import Wire


class LateDeliveries:
    """Hands spoiled frames to their receivers: never, altered, late, or out of order. held: waiting to be overtaken."""

    def __init__(self, wire: "Wire") -> None:
        self.held: list[tuple[WireNode, Frame]] = []
        self._wire = wire

    def deliver(self, targets: Sequence[WireNode], frame: Frame, fault: WireFault) -> None:
        """Hand a frame to the fault's receiver as the fault has it; to all others as it is."""
        hit = [node for node in targets if fault.receiver in (None, node.name)]
        for node in targets:
            if node not in hit:
                node.take(frame)
        if fault.kind is FaultKind.DROP:
            self._wire.dropped += 1
        elif fault.kind is FaultKind.DELAY:
            self._wire.at(frame.timestamp_ns + fault.delay_ns, self._take_now, [(node, frame) for node in hit])
        elif fault.kind is FaultKind.REORDER:
            self.held += [(node, frame) for node in hit]
            self._wire.at(frame.timestamp_ns + fault.delay_ns, self.release)
        else:
            taken = self._altered(frame, fault.bit) if fault.kind is FaultKind.ALTER else frame
            for node in hit:
                node.take(taken)

    def release(self) -> None:
        """Hand over what was held back."""
        held, self.held = self.held, []
        self._take_now(held)

    def _take_now(self, deliveries: Sequence[tuple[WireNode, Frame]]) -> None:
        for node, frame in deliveries:
            node.take(frame._replace(timestamp_ns=self._wire.now_ns))

    def _altered(self, frame: Frame, bit: int) -> Frame:
        bits = 8 * len(frame.data)
        if not bits:
            return frame
        position = bit % bits if bit >= 0 else self._wire.random.below(bits)
        value = int.from_bytes(frame.data, "little") ^ 1 << position
        return frame._replace(data=value.to_bytes(len(frame.data), "little"))


class NodeFaults:
    """Takes nodes off the bus and puts them back, and lets nodes babble."""

    def __init__(self, wire: "Wire") -> None:
        self._wire = wire

    def begin(self, fault: WireFault) -> None:
        """The fault's window opens. Raises ValueError for a node that is not attached."""
        if fault.kind is FaultKind.BABBLE:
            self._babble(fault)
            return
        for node in self._victims(fault):
            if fault.kind is FaultKind.BUS_OFF:
                self._wire.confinement.enter_bus_off(node)
            elif fault.kind is FaultKind.DOWN:
                node.interface_up = False
                node.down_faults += 1
                self._wire.confinement.silence(node)
            else:
                self._cut_off(node)
        if fault.until_ns < FOREVER_NS and fault.kind is not FaultKind.BUS_OFF:
            self._wire.at(fault.until_ns, self._end, fault)

    def attempt_next(self, node: WireNode) -> None:
        """A node that is cut off has something to send; it will not be acknowledged."""
        node.attempt_ns = max(node.queue[0][READY], self._wire.now_ns)
        self._wire.at(node.attempt_ns, self._attempt_alone, node)

    def _end(self, fault: WireFault) -> None:
        """The window closes."""
        wire = self._wire
        for node in self._victims(fault):
            if fault.kind is FaultKind.DOWN:
                node.down_faults -= 1
                if not node.down_faults:
                    self._bring_up(node)
            else:
                node.cut_off -= 1
                if not node.cut_off and node.queue:
                    node.not_before(max(node.ready_ns, wire.now_ns))
                    wire.waiting.append(node)
        wire.topology_changed()

    def _bring_up(self, node: WireNode) -> None:
        """A controller that is started anew is error-active."""
        node.interface_up = True
        node.is_bus_off = False
        node.tec = node.rec = 0
        node.ready_ns = self._wire.now_ns

    def _victims(self, fault: WireFault) -> list[WireNode]:
        nodes = self._wire.nodes
        if fault.node is None:
            return list(nodes.values())
        if fault.node not in nodes:
            raise ValueError(f"wire fault {fault.kind}: no node {fault.node!r}; there are {', '.join(nodes)}")
        return [nodes[fault.node]]

    def _cut_off(self, node: WireNode) -> None:
        wire = self._wire
        node.cut_off += 1
        if node.cut_off > 1:
            return
        wire.confinement.cut_short(node)
        wire.topology_changed()
        if node in wire.waiting:
            wire.waiting.remove(node)
        if node.queue:
            self.attempt_next(node)

    def _attempt_alone(self, node: WireNode) -> None:
        """One attempt of a node that is cut off, on its own piece of cable; it tries until somebody acknowledges."""
        wire = self._wire
        if not node.cut_off or not node.queue or node.attempt_ns != wire.now_ns:
            return  # back on the bus, purged, or planned anew
        _, _, frame, duration_ns = node.queue[0]
        wire.confinement.count_missing_acknowledgement(node)
        node.not_before(wire.now_ns + wire.confinement.attempt_alone_ns(node, duration_ns))
        if wire.observer is not None:
            wire.observer(wire.now_ns, wire.now_ns + duration_ns, node.name, frame, False)
        self.attempt_next(node)

    def _babble(self, fault: WireFault) -> None:
        """A node of its own sends without a pause, or periodically."""
        wire = self._wire
        name = fault.node or "babbler"
        node = wire.nodes.get(name) or wire.attach(name, None, queue_length=1)
        frame = Frame(fault.can_id or 0, b"\x55" * fault.length)

        def again(now_ns: int) -> None:
            if now_ns >= fault.until_ns:
                node.on_sent = None
                return
            node.send(frame, now_ns)
            if fault.period_ns:
                wire.at(now_ns + fault.period_ns, again, now_ns + fault.period_ns)

        node.on_sent = None if fault.period_ns else again
        again(wire.now_ns)
