"""How the scripted faults of a simulated CAN segment act: on single frames, and on whole nodes."""

from collections.abc import Sequence

from drivers.frame import Frame
from drivers.wire.confinement import Confinement
from drivers.wire.faults import FOREVER_NS, FaultKind, WireFault
from drivers.wire.node import READY, WireNode, attach, topology_changed
from drivers.wire.segment import Segment


class LateDeliveries:
    """Hands spoiled frames to their receivers: never, altered, late, or out of order. held: waiting to be overtaken."""

    def __init__(self, segment: Segment[WireNode]) -> None:
        self.held: list[tuple[WireNode, Frame]] = []
        self._segment = segment

    def deliver(self, targets: Sequence[WireNode], frame: Frame, fault: WireFault) -> None:
        """Hand a frame to the fault's receiver as the fault has it; to all others as it is."""
        hit = [node for node in targets if fault.receiver in (None, node.name)]
        for node in targets:
            if node not in hit:
                node.take(frame)
        if fault.kind is FaultKind.DROP:
            self._segment.dropped += 1
        elif fault.kind is FaultKind.DELAY:
            self._segment.at(frame.timestamp_ns + fault.delay_ns, self._take_now, [(node, frame) for node in hit])
        elif fault.kind is FaultKind.REORDER:
            self.held += [(node, frame) for node in hit]
            self._segment.at(frame.timestamp_ns + fault.delay_ns, self.release)
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
            node.take(frame._replace(timestamp_ns=self._segment.now_ns))

    def _altered(self, frame: Frame, bit: int) -> Frame:
        bits = 8 * len(frame.data)
        if not bits:
            return frame
        position = bit % bits if bit >= 0 else self._segment.random.below(bits)
        value = int.from_bytes(frame.data, "little") ^ 1 << position
        return frame._replace(data=value.to_bytes(len(frame.data), "little"))


class NodeFaults:
    """Takes nodes off the bus and puts them back, and lets nodes babble."""

    def __init__(self, segment: Segment[WireNode], confinement: Confinement) -> None:
        self._segment = segment
        self._confinement = confinement

    def begin(self, fault: WireFault) -> None:
        """The fault's window opens. Raises ValueError for a node that is not attached."""
        if fault.kind is FaultKind.BABBLE:
            self._babble(fault)
            return
        for node in self._victims(fault):
            if fault.kind is FaultKind.BUS_OFF:
                self._confinement.enter_bus_off(node)
            elif fault.kind is FaultKind.DOWN:
                node.interface_up = False
                node.down_faults += 1
                self._confinement.silence(node)
            else:
                self._cut_off(node)
        if fault.until_ns < FOREVER_NS and fault.kind is not FaultKind.BUS_OFF:
            self._segment.at(fault.until_ns, self._end, fault)

    def attempt_next(self, node: WireNode) -> None:
        """A node that is cut off has something to send; it will not be acknowledged."""
        node.attempt_ns = max(node.queue[0][READY], self._segment.now_ns)
        self._segment.at(node.attempt_ns, self._attempt_alone, node)

    def _end(self, fault: WireFault) -> None:
        """The window closes."""
        segment = self._segment
        for node in self._victims(fault):
            if fault.kind is FaultKind.DOWN:
                node.down_faults -= 1
                if not node.down_faults:
                    self._bring_up(node)
            else:
                node.cut_off -= 1
                if not node.cut_off:
                    node.alone = None
                    if node.queue:
                        node.not_before(max(node.ready_ns, segment.now_ns))
                        segment.waiting.append(node)
        topology_changed(segment)

    def _bring_up(self, node: WireNode) -> None:
        """A controller that is started anew is error-active."""
        node.interface_up = True
        node.is_bus_off = False
        node.tec = node.rec = 0
        node.ready_ns = self._segment.now_ns

    def _victims(self, fault: WireFault) -> list[WireNode]:
        nodes = self._segment.nodes
        if fault.node is None:
            return list(nodes.values())
        if fault.node not in nodes:
            raise ValueError(f"wire fault {fault.kind}: no node {fault.node!r}; there are {', '.join(nodes)}")
        return [nodes[fault.node]]

    def _cut_off(self, node: WireNode) -> None:
        segment = self._segment
        node.cut_off += 1
        if node.cut_off > 1:
            return
        node.alone = self.attempt_next
        self._confinement.cut_short(node)
        topology_changed(segment)
        if node in segment.waiting:
            segment.waiting.remove(node)
        if node.queue:
            self.attempt_next(node)

    def _attempt_alone(self, node: WireNode) -> None:
        """One attempt of a node that is cut off, on its own piece of cable; it tries until somebody acknowledges."""
        segment = self._segment
        if not node.cut_off or not node.queue or node.attempt_ns != segment.now_ns:
            return  # back on the bus, purged, or planned anew
        _, _, frame, duration_ns = node.queue[0]
        self._confinement.count_missing_acknowledgement(node)
        node.not_before(segment.now_ns + self._confinement.attempt_alone_ns(node, duration_ns))
        if segment.observer is not None:
            segment.observer(segment.now_ns, segment.now_ns + duration_ns, node.name, frame, False)
        self.attempt_next(node)

    def _babble(self, fault: WireFault) -> None:
        """A node of its own sends without a pause, or periodically."""
        segment = self._segment
        name = fault.node or "babbler"
        node = segment.nodes.get(name) or attach(segment, name, None, queue_length=1)
        frame = Frame(fault.can_id or 0, b"\x55" * fault.length)

        def again(now_ns: int) -> None:
            if now_ns >= fault.until_ns:
                node.on_sent = None
                return
            node.send(frame, now_ns)
            if fault.period_ns:
                segment.at(now_ns + fault.period_ns, again, now_ns + fault.period_ns)

        node.on_sent = None if fault.period_ns else again
        again(segment.now_ns)
