"""A CAN segment in virtual time: exact frame lengths, arbitration, finite queues, and every way a bus can misbehave.

Time is integer nanoseconds and passes only in `Wire.advance`. Nothing is random except through the seed, so a run is the
same on every machine. A frame that has begun is never interrupted by another one; its last EOF bit is its time stamp;
three bits later the bus is free and of the frames then waiting the one with the lowest identifier begins.

Not modelled: bit timing below one bit (propagation, resynchronisation). Two nodes that would begin within the same bit
contend only if both were ready at the instant the first began; the schedulability analysis counts that bit as the paper does.
"""

from collections.abc import Callable, Container, Sequence
from heapq import heappop, heappush
from typing import Any

from drivers.config import BusConfig, WireConfig
from drivers.frame import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.wire_faults import FOREVER_NS, FRAME_FAULTS, FaultKind, FrameFaults, Random, WireFault
from drivers.wire_node import BUS_OFF_LIMIT, PASSIVE_LIMIT, WireNode, elapsed_ns

ERROR_FLAGS = 12  # bits: the flag of the node that saw the error first, and the echo of the others
PASSIVE_FLAG = 6
ERROR_DELIMITER = 8
SUSPEND = 8  # an error-passive sender waits so much longer than the intermission
RECOVERY_BITS = 128 * 11
LONGEST_NOMINAL = 800  # bits; more than any frame has at either rate
UNACKNOWLEDGED = PASSIVE_FLAG + ERROR_DELIMITER - 8  # bits by which that error frame outlasts ACK delimiter and EOF

Observer = Callable[
    [int, int, str, Frame, bool], None
]  # start ns, end ns, sender, frame, was it sent without an error?


def arbitration_key(can_id: int) -> int:
    """The arbitration field as an integer: of two frames that begin together the one with the lower key wins.

    11-bit identifiers: id, RTR, IDE = 0. 29-bit ones: base id, SRR = 1, IDE = 1, extension, RTR. So a base frame beats an
    extended frame with the same first 11 bits, and data beats remote.
    """
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        return (identifier >> 18) << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return (can_id & STANDARD_MASK) << 21 | remote << 20


class Wire:
    """The segment. Attach nodes, let them send, advance.

    bitrate, data_bitrate: bit/s. drop_probability: of each frame, to be acknowledged and lost behind the wire, at every
    receiver. faults: the script; more can be injected at any time. observer: called at the end of every attempt to send.
    now_ns: virtual time reached. busy_ns: time the bus was not idle, so far. dropped: frames lost silently.
    waiting, nominal_ns, data_ns: for `WireNode`.
    """

    def __init__(
        self,
        bitrate: int,
        data_bitrate: int = 0,
        *,
        seed: int = 1,
        drop_probability: float = 0.0,
        faults: Sequence[WireFault] = (),
        start_ns: int = 0,
        observer: Observer | None = None,
    ) -> None:
        data_bitrate = data_bitrate or bitrate
        if bitrate < 1 or data_bitrate < 1:
            raise ValueError(f"bitrate = {bitrate}, data_bitrate = {data_bitrate}: both must be positive")
        if not 0.0 <= drop_probability < 1.0:
            raise ValueError(f"drop_probability = {drop_probability}, allowed 0 <= p < 1")
        self.nominal_ns = [-(-bits * 1_000_000_000 // bitrate) for bits in range(LONGEST_NOMINAL)]
        self.data_ns = [-(-bits * 1_000_000_000 // data_bitrate) for bits in range(LONGEST_NOMINAL)]
        self.now_ns = start_ns
        self.busy_ns = 0
        self.dropped = 0
        self.observer = observer
        self.nodes: dict[str, WireNode] = {}
        self.waiting: list[WireNode] = []
        self._random = Random(seed)
        self._drop_probability = drop_probability
        self._intermission_ns = self.nominal_ns[INTERMISSION]
        self._keys: dict[int, int] = {}
        # the frame on the wire: who, since when, until when, and what a script does to it
        self._sender: WireNode | None = None
        self._start_ns = start_ns
        self._end_ns = start_ns
        self._fate: WireFault | None = None
        self._collision: tuple[WireNode, ...] = ()
        self._free_ns = start_ns  # the bus is free from here on
        self._healthy = True  # all error counters are zero
        self._frame_faults = FrameFaults(self._random)
        self._held: list[tuple[WireNode, Frame]] = []  # REORDER: overtaken by the next frame
        self._agenda: list[tuple[int, int, Callable[..., None], tuple[Any, ...]]] = []
        self._agenda_count = 0
        for fault in faults:
            self.inject(fault)

    @classmethod
    def from_config(cls, bus: BusConfig, wire: WireConfig, *, start_ns: int = 0) -> "Wire":
        """The segment a rig file describes ([bus] and [wire])."""
        return cls(
            bus.bitrate, bus.data_bitrate, seed=wire.seed, drop_probability=wire.drop_probability, start_ns=start_ns
        )

    def attach(
        self,
        name: str,
        receive: Callable[[Frame], None] | None,
        queue_length: int = 16,
        accept: Container[int] | None = None,
    ) -> WireNode:
        """Put a node on the bus. receive: gets every frame of the others at its last bit, and may send at that time; None:
        acknowledges only. accept: identifiers its acceptance filter lets through; None: all.
        """
        if name in self.nodes:
            raise ValueError(f"node {name!r} is attached already")
        node = self.nodes[name] = WireNode(self, name, receive, queue_length, accept)
        self._topology_changed()
        return node

    def advance(self, until_ns: int) -> None:
        """Let time pass until `until_ns`; every frame whose last bit ends by then has been delivered."""
        if until_ns < self.now_ns:
            raise ValueError(f"advance to {until_ns} ns, but the wire is at {self.now_ns} ns")
        agenda = self._agenda
        while True:
            horizon = until_ns
            if agenda and agenda[0][0] <= until_ns:
                horizon = (
                    agenda[0][0] - 1
                )  # what is planned for an instant comes before the frame that begins or ends then
            if self._sender is None:
                begun = self._arbitrate(horizon)
            else:
                begun = True
            if begun and self._end_ns <= horizon:
                self._finish()
            elif horizon < until_ns:
                self._next_on_agenda()
            else:
                break
        self.now_ns = until_ns

    def inject(self, fault: WireFault) -> None:
        """Add a fault to the script. A node's fault whose window is open begins now."""
        if fault.kind in FRAME_FAULTS:
            self._frame_faults.add(fault)
        else:
            self._at(fault.from_ns, self._begin_node_fault, fault)

    def clear_frame_faults(self) -> None:
        """Disarm all frame faults."""
        self._frame_faults.clear()

    # -- what nodes ask for ------------------------------------------------------------------------------------------

    def purge(self, node: WireNode) -> int:
        """See WireNode.purge."""
        queue = node._queue
        keep = 1 if queue and node is self._sender else 0
        dropped = len(queue) - keep
        while len(queue) > keep:
            queue.pop()
        if not keep:
            node._repeating = False
        if not queue and node in self.waiting:
            self.waiting.remove(node)
        return dropped

    def restart(self, node: WireNode, at_ns: int) -> None:
        """See WireNode.restart."""
        if node.is_bus_off:
            self._at(at_ns, self._recover, node, -1, RECOVERY_BITS)

    def schedule_alone(self, node: WireNode) -> None:
        """A node that is cut off has something to send: nobody will acknowledge it."""
        node._attempt_ns = max(node._queue[0][0], self.now_ns)
        self._at(node._attempt_ns, self._attempt_alone, node)

    # -- the bus -----------------------------------------------------------------------------------------------------

    def _arbitrate(self, horizon_ns: int) -> bool:
        """Begin the next frame if it begins by `horizon_ns`."""
        waiting = self.waiting
        if not waiting:
            return False
        winner = waiting[0]
        start_ns = winner._queue[0][0]
        if len(waiting) > 1:
            for node in waiting:
                if node._queue[0][0] < start_ns:
                    start_ns = node._queue[0][0]
        if start_ns < self._free_ns:
            start_ns = self._free_ns
        if start_ns > horizon_ns:
            return False
        if len(waiting) > 1:
            winner = self._lowest(start_ns)
        entry = winner._queue[0]
        self._sender = winner
        self._start_ns = start_ns
        self._end_ns = start_ns + entry[2]
        self._fate = None
        if self._frame_faults or self._collision:
            self._decide_fate(winner, entry[1])
        return True

    def _lowest(self, start_ns: int) -> WireNode:
        """Who wins the arbitration at `start_ns`."""
        keys = self._keys
        winner: WireNode | None = None
        lowest = 1 << 40
        for node in self.waiting:
            entry = node._queue[0]
            if entry[0] > start_ns:
                continue
            can_id = entry[1].can_id
            key = keys.get(can_id, -1)
            if key < 0:
                key = keys[can_id] = arbitration_key(can_id)
            if key < lowest:
                winner, lowest = node, key
            elif key == lowest and winner is not None and winner._queue[0][1][:3] != entry[1][:3]:
                self._collision = (winner, node)
        assert winner is not None  # start_ns is the time at which at least one of them is ready
        if self._collision and winner not in self._collision:
            self._collision = ()
        return winner

    def _decide_fate(self, sender: WireNode, frame: Frame) -> None:
        """Whether a script or a second sender of the same identifier spoils the frame that begins now."""
        start_ns = self._start_ns
        if self._collision:
            # Both win the arbitration and differ later: the first of them to see its recessive bit overwritten flags it.
            self._fate = WireFault(FaultKind.CORRUPT, bit=20)
        elif not sender._repeating:
            self._fate = self._frame_faults.strike(start_ns, sender.name, frame.can_id)
        if self._fate is not None and self._fate.kind is FaultKind.CORRUPT:
            bit = self._fate.bit if self._fate.bit >= 0 else self._random.below(sum(frame_bits(frame)))
            until_error = elapsed_ns(frame, bit, self.nominal_ns, self.data_ns)
            self._end_ns = start_ns + until_error + self.nominal_ns[ERROR_FLAGS + ERROR_DELIMITER]

    def _finish(self) -> None:
        """The frame on the wire ends, well or not."""
        sender = self._sender
        assert sender is not None
        end_ns = self.now_ns = self._end_ns
        frame = sender._queue[0][1]
        fate = self._fate
        if fate is not None and fate.kind is FaultKind.CORRUPT:
            self._failed(sender, frame)
            return
        can_id = frame.can_id
        targets = sender._targets.get(can_id)
        if targets is None:
            targets = self._route(sender, can_id)
        if not targets and not self._acknowledged(sender):
            self._not_acknowledged(sender, frame)
            return
        self._sender = None
        self._free_ns = end_ns + self._intermission_ns
        self.busy_ns += self._free_ns - self._start_ns
        if self.observer is not None:
            self.observer(self._start_ns, end_ns, sender.name, frame, True)
        if fate is not None and fate.kind is FaultKind.DUPLICATE:
            self._repeat(sender)
        else:
            self._sent(sender)
        received = Frame(can_id, frame.data, frame.flags, end_ns)
        if self._drop_probability and self._random.chance(self._drop_probability):
            self.dropped += 1
        elif fate is not None:
            self._deliver_spoiled(targets, received, fate)
        else:
            for node in targets:
                node.received += 1
                node._receive(received)  # type: ignore[misc]  # a target has a receiver
            if self._held:
                self._release_held()

    def _sent(self, sender: WireNode) -> None:
        """Bookkeeping of a frame sent without an error."""
        queue = sender._queue
        queue.popleft()
        if not queue:
            self.waiting.remove(sender)
        sender.sent += 1
        sender._repeating = False
        if not self._healthy:
            self._count_success(sender)
        if sender.on_sent is not None:
            sender.on_sent(self.now_ns)

    def _route(self, sender: WireNode, can_id: int) -> tuple[WireNode, ...]:
        """Who takes a frame of that sender; kept until the topology changes."""
        targets = tuple(
            node
            for node in self.nodes.values()
            if node is not sender
            and node.listening
            and node._receive is not None
            and (node.accept is None or can_id in node.accept)
        )
        sender._targets[can_id] = targets
        return targets

    def _acknowledged(self, sender: WireNode) -> bool:
        return any(node is not sender and node.listening for node in self.nodes.values())

    def _topology_changed(self) -> None:
        for node in self.nodes.values():
            node._targets.clear()

    # -- deliveries that a script changes ------------------------------------------------------------------------------

    def _deliver_spoiled(self, targets: tuple[WireNode, ...], frame: Frame, fault: WireFault) -> None:
        """Hand a frame over as the fault has it, to the fault's receiver; to all others as it is."""
        hit = [node for node in targets if fault.receiver in (None, node.name)]
        for node in targets:
            if node not in hit:
                self._hand_over(node, frame)
        if fault.kind is FaultKind.DROP:
            self.dropped += 1
        elif fault.kind is FaultKind.DELAY:
            self._at(frame.timestamp_ns + fault.delay_ns, self._hand_over_late, hit, frame)
        elif fault.kind is FaultKind.REORDER:
            self._held += [(node, frame) for node in hit]
            self._at(frame.timestamp_ns + fault.delay_ns, self._release_held)
        else:
            if fault.kind is FaultKind.ALTER:
                frame = self._altered(frame, fault.bit)
            for node in hit:
                self._hand_over(node, frame)

    def _altered(self, frame: Frame, bit: int) -> Frame:
        if not frame.data:
            return frame
        bits = 8 * len(frame.data)
        position = bit % bits if bit >= 0 else self._random.below(bits)
        value = int.from_bytes(frame.data, "little") ^ 1 << position
        return frame._replace(data=value.to_bytes(len(frame.data), "little"))

    def _hand_over(self, node: WireNode, frame: Frame) -> None:
        if node.listening and node._receive is not None:
            node.received += 1
            node._receive(frame)

    def _hand_over_late(self, nodes: list[WireNode], frame: Frame) -> None:
        for node in nodes:
            self._hand_over(node, frame._replace(timestamp_ns=self.now_ns))

    def _release_held(self) -> None:
        held, self._held = self._held, []
        for node, frame in held:
            self._hand_over(node, frame._replace(timestamp_ns=self.now_ns))

    # -- errors --------------------------------------------------------------------------------------------------------

    def _failed(self, sender: WireNode, frame: Frame) -> None:
        """An error frame has ended: the error counters, and the sender will try again."""
        self._abandon(sender, frame)
        senders = self._collision or (sender,)
        self._collision = ()
        for node in self.nodes.values():
            if node.listening:
                node.errors += 1
                if node in senders:
                    self._transmit_error(node)
                else:
                    node.rec = min(node.rec + 1, PASSIVE_LIMIT + 1)

    def _not_acknowledged(self, sender: WireNode, frame: Frame) -> None:
        """Nobody else is on the bus: an acknowledgement error in the ACK slot, and its error frame."""
        self._abandon(sender, frame, self.nominal_ns[UNACKNOWLEDGED])
        self._acknowledge_error(sender)
        if sender.tec > PASSIVE_LIMIT:
            self._suspend(sender)

    def _acknowledge_error(self, node: WireNode) -> None:
        """ISO 11898-1:2015, 12.1.4.2 c, exception A: an error-passive sender does not count a missing acknowledgement, so
        the counter stops at 128 and bus-off never comes."""
        node.errors += 1
        node.no_ack += 1
        if node.tec <= PASSIVE_LIMIT:
            node.tec += 8

    def _abandon(self, sender: WireNode, frame: Frame, error_frame_ns: int = 0) -> None:
        self._sender = None
        self._fate = None
        self._free_ns = self.now_ns + error_frame_ns + self._intermission_ns
        self.busy_ns += self._free_ns - self._start_ns
        self._healthy = False
        if self.observer is not None:
            self.observer(self._start_ns, self.now_ns, sender.name, frame, False)

    def _repeat(self, sender: WireNode) -> None:
        """DUPLICATE: for the sender alone the frame failed in its last bit."""
        self._free_ns += self.nominal_ns[ERROR_FLAGS + ERROR_DELIMITER]
        self.busy_ns += self.nominal_ns[ERROR_FLAGS + ERROR_DELIMITER]
        self._healthy = False
        sender._repeating = True
        sender.errors += 1
        self._transmit_error(sender)

    def _transmit_error(self, node: WireNode) -> None:
        node.tec += 8
        if node.tec > BUS_OFF_LIMIT:
            self._enter_bus_off(node)
        elif node.tec > PASSIVE_LIMIT:
            self._suspend(node)

    def _count_success(self, sender: WireNode) -> None:
        """A frame went through: its sender's TEC and every receiver's REC go down by one."""
        sender.tec = max(sender.tec - 1, 0)
        if sender.tec > PASSIVE_LIMIT:
            self._suspend(sender)
        healthy = True
        for node in self.nodes.values():
            if node is not sender and node.listening and node.rec:
                node.rec -= 1
            healthy = healthy and not node.tec and not node.rec
        self._healthy = healthy

    def _suspend(self, node: WireNode) -> None:
        """An error-passive sender lets the others go first."""
        self._not_before(node, self._free_ns + self.nominal_ns[SUSPEND])

    def _not_before(self, node: WireNode, ready_ns: int) -> None:
        node._ready_ns = ready_ns
        if node._queue and node._queue[0][0] < ready_ns:
            _, frame, duration_ns = node._queue[0]
            node._queue[0] = (ready_ns, frame, duration_ns)

    def _enter_bus_off(self, node: WireNode) -> None:
        """The controller leaves the bus; its driver's queue is lost, as the kernel's is when the carrier goes."""
        node.is_bus_off = True
        node.bus_off += 1
        self._silence(node)

    def _silence(self, node: WireNode) -> None:
        if self._sender is node:
            self._cut_short(node)
        node._queue.clear()
        node._repeating = False
        if node in self.waiting:
            self.waiting.remove(node)
        self._topology_changed()

    def _cut_short(self, sender: WireNode) -> None:
        """The sender falls silent within its frame: the others see a stuff error and answer with an error frame."""
        frame = sender._queue[0][1]
        self._abandon(sender, frame, self.nominal_ns[ERROR_FLAGS + ERROR_DELIMITER])
        self._collision = ()
        for node in self.nodes.values():
            if node is not sender and node.listening:
                node.errors += 1
                node.rec = min(node.rec + 1, PASSIVE_LIMIT + 1)

    def _recover(self, node: WireNode, busy_ns: int, bits: int) -> None:
        """Count idle time as recessive bits; at zero the node takes part again. (Frames of others hold some, too, so a real
        controller may be back a little earlier on a busy bus.)"""
        waited = bits
        if busy_ns >= 0:
            waited = -(-(self.busy_ns - busy_ns) // self.nominal_ns[1])  # so many of them were not idle
        if waited > 0:
            wait_ns = waited * self.nominal_ns[1]
            self._at(self.now_ns + wait_ns, self._recover, node, self.busy_ns, 0)
            return
        if node.is_bus_off:
            node.is_bus_off = False
            node.tec = node.rec = 0
            node.restarted += 1
            node._ready_ns = self.now_ns
            self._topology_changed()

    # -- node faults -----------------------------------------------------------------------------------------------------

    def _begin_node_fault(self, fault: WireFault) -> None:
        if fault.kind is FaultKind.BABBLE:
            self._babble(fault)
            return
        for node in self._victims(fault):
            if fault.kind is FaultKind.BUS_OFF:
                if not node.is_bus_off:
                    node.tec = BUS_OFF_LIMIT + 1
                    self._enter_bus_off(node)
            elif fault.kind is FaultKind.DOWN:
                node.interface_up = False
                self._silence(node)
            else:
                self._cut_off(node)
        if fault.until_ns < FOREVER_NS and fault.kind is not FaultKind.BUS_OFF:
            self._at(fault.until_ns, self._end_node_fault, fault)

    def _end_node_fault(self, fault: WireFault) -> None:
        for node in self._victims(fault):
            if fault.kind is FaultKind.DOWN:
                node.interface_up = True  # a controller that is started anew is error-active
                node.is_bus_off = False
                node.tec = node.rec = 0
                node._ready_ns = self.now_ns
            else:
                node.cut_off = False
                if node._queue:
                    self._not_before(node, max(node._ready_ns, self.now_ns))
                    self.waiting.append(node)
            self._topology_changed()

    def _victims(self, fault: WireFault) -> list[WireNode]:
        if fault.node is None:
            return list(self.nodes.values())
        if fault.node not in self.nodes:
            raise ValueError(f"wire fault {fault.kind}: no node {fault.node!r}; there are {', '.join(self.nodes)}")
        return [self.nodes[fault.node]]

    def _cut_off(self, node: WireNode) -> None:
        if self._sender is node:
            self._cut_short(node)
        node.cut_off = True
        self._topology_changed()
        if node in self.waiting:
            self.waiting.remove(node)
        if node._queue:
            self.schedule_alone(node)

    def _attempt_alone(self, node: WireNode) -> None:
        """One attempt of a node that is cut off, on its own piece of the cable; it tries until somebody acknowledges."""
        if not node.cut_off or not node._queue or node._attempt_ns != self.now_ns:
            return
        _, frame, duration_ns = node._queue[0]
        self._healthy = False
        self._acknowledge_error(node)
        suspended = SUSPEND if node.tec > PASSIVE_LIMIT else 0
        self._not_before(node, self.now_ns + duration_ns + self.nominal_ns[UNACKNOWLEDGED + INTERMISSION + suspended])
        if self.observer is not None:
            self.observer(self.now_ns, self.now_ns + duration_ns, node.name, frame, False)
        self.schedule_alone(node)

    def _babble(self, fault: WireFault) -> None:
        """A node of its own that sends without a pause, or periodically."""
        name = fault.node or "babbler"
        node = self.nodes.get(name) or self.attach(name, None, queue_length=1)
        frame = Frame(fault.can_id or 0, b"\x55" * fault.length)

        def again(now_ns: int) -> None:
            if now_ns < fault.until_ns:
                node.send(frame, now_ns)
                if fault.period_ns:
                    self._at(now_ns + fault.period_ns, again, now_ns + fault.period_ns)
            else:
                node.on_sent = None

        node.on_sent = None if fault.period_ns else again
        again(self.now_ns)

    # -- the agenda ------------------------------------------------------------------------------------------------------

    def _at(self, time_ns: int, action: Callable[..., None], *arguments: Any) -> None:
        """Plan an action; those of one instant run in the order in which they were planned."""
        self._agenda_count += 1
        heappush(self._agenda, (max(time_ns, self.now_ns), self._agenda_count, action, arguments))

    def _next_on_agenda(self) -> None:
        time_ns, _, action, arguments = heappop(self._agenda)
        self.now_ns = max(self.now_ns, time_ns)
        action(*arguments)
