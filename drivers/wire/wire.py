"""A CAN segment in virtual time: exact frame lengths, arbitration, finite queues, and every way a bus can misbehave.

Theory of operation. Time is integer nanoseconds and passes only in `Wire.advance`, which does what comes first. That is
an action that is planned for an instant (`Segment.at`), the end of the frame on the wire, or, when the bus is free, the
next arbitration. Nothing is random except through the seed, so a run is the same on every machine.

Rules. A frame that has begun is never interrupted by another one. The end of its last EOF bit is its time stamp. Three
bits later the bus is free, and of the frames then waiting the one with the lowest arbitration field begins. What is
planned for an instant precedes what the bus does at that instant. An error, scripted or by collision, ends the frame
early and counts in its nodes (confinement.py); everything else the script can do is in injection.py.

Not modelled: bit timing below one bit (propagation, resynchronisation). Two nodes that would begin within the same bit
contend only if both were ready at the instant the first began; the schedulability analysis counts that bit as the
paper does.
"""

from collections.abc import Callable, Container, Sequence
from heapq import heappop

from drivers.config import BusConfig, WireConfig
from drivers.frame import Frame
from drivers.frame_length import INTERMISSION, frame_bits, longest_bits
from drivers.wire.confinement import ERROR_FRAME, Confinement
from drivers.wire.faults import FRAME_FAULTS, FaultKind, FrameFaults, WireFault
from drivers.wire.injection import LateDeliveries, NodeFaults
from drivers.wire.node import DURATION, FRAME, READY, WireNode, attach
from drivers.wire.segment import Observer, Segment, elapsed_ns

NEVER_NS = 1 << 62
COLLISION_BIT = 20  # two senders with one identifier differ behind the arbitration field


class Wire(Segment[WireNode]):
    """The segment as its users see it: attach nodes, let them send, advance.

    bitrate, data_bitrate: bit/s. drop_probability: of each frame, to be acknowledged and lost behind the wire, at
    every receiver. faults: the script; more can be injected at any time. observer: called at the end of every attempt
    to send, with start ns, end ns, sender's name, frame, and whether it was sent without an error.
    now_ns, busy_ns, dropped: see `Segment`, whose other attributes serve the parts of this simulation, not its users.
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
        worst_stuffing: bool = False,
    ) -> None:
        super().__init__(bitrate, data_bitrate or bitrate, seed, start_ns, observer)
        if not 0.0 <= drop_probability < 1.0:
            raise ValueError(f"drop_probability = {drop_probability}, allowed 0 <= p < 1")
        if worst_stuffing:
            self.frame_bits = longest_bits
        self.confinement = Confinement(self)
        self.frame_faults = FrameFaults(self.random)
        self.late = LateDeliveries(self)
        self.node_faults = NodeFaults(self, self.confinement)
        self._drop_probability = drop_probability
        self._intermission_ns = self.nominal_ns[INTERMISSION]
        for fault in faults:
            self.inject(fault)

    @classmethod
    def from_config(cls, bus: BusConfig, wire: WireConfig) -> "Wire":
        """The segment a rig file describes ([bus] and [wire])."""
        return cls(
            bus.bitrate,
            bus.data_bitrate,
            seed=wire.seed,
            drop_probability=wire.drop_probability,
            worst_stuffing=wire.stuffing == "worst",
        )

    def attach(
        self,
        name: str,
        receive: Callable[[Frame], None] | None,
        queue_length: int = 16,
        accept: Container[int] | None = None,
        fifo: bool = True,
    ) -> WireNode:
        """Put a node on the bus. Raises ValueError for a name that is taken.

        receive: gets every frame of the others at its last bit, and may send at that time; None: acknowledges only.
        queue_length: frames, the one on the wire included. accept: identifiers (with Linux's flags) its acceptance
        filter lets through; None: all. fifo: one transmit queue, as under Linux; False: its most urgent frame first.
        """
        return attach(self, name, receive, queue_length, accept, fifo)

    def inject(self, fault: WireFault) -> None:
        """Add a fault to the script. One whose window is open already begins at once, before any further frame."""
        if fault.kind in FRAME_FAULTS:
            self.frame_faults.add(fault)
        else:
            self.at(fault.from_ns, self.node_faults.begin, fault)

    def advance(self, until_ns: int) -> None:
        """Let time pass until `until_ns`; every frame whose last bit ends by then has been delivered."""
        if until_ns < self.now_ns:
            raise ValueError(f"advance to {until_ns} ns, but the wire is at {self.now_ns} ns")
        agenda = self.agenda
        while True:
            horizon = until_ns
            if agenda and agenda[0][0] <= until_ns:
                horizon = agenda[0][0] - 1  # what is planned for an instant precedes what the bus does at that instant
            if (self.sender is not None or self._arbitrate(horizon)) and self.end_ns <= horizon:
                self._finish()
            elif horizon < until_ns:
                time_ns, _, action, arguments = heappop(agenda)
                self.now_ns = max(self.now_ns, time_ns)
                action(*arguments)
            else:
                break
        self.now_ns = until_ns

    @property
    def next_ns(self) -> int:
        """When something happens next that is known by now: what is planned, a frame's end or beginning; NEVER_NS."""
        due_ns = self.agenda[0][0] if self.agenda else NEVER_NS
        if self.sender is not None:
            return min(due_ns, self.end_ns)
        for node in self.waiting:
            due_ns = min(due_ns, max(self.free_ns, node.queue[0][READY]))
        return due_ns

    def _arbitrate(self, horizon_ns: int) -> bool:
        """Begin the next frame if it begins by `horizon_ns`."""
        waiting = self.waiting
        start_ns = self.free_ns
        if not waiting or start_ns > horizon_ns:
            return False
        if len(waiting) == 1:
            winner = waiting[0]
            start_ns = max(start_ns, winner.queue[0][READY])
        else:
            found = self._lowest(start_ns)
            if found is None:  # nobody is ready yet when the bus is free
                start_ns = min(node.queue[0][READY] for node in waiting)
                found = self._lowest(start_ns)
                assert found is not None
            winner = found
        if start_ns > horizon_ns:
            self.collision = ()
            return False
        entry = winner.queue[0]
        self.sender = winner
        self.start_ns = start_ns
        self.end_ns = start_ns + entry[DURATION]
        if self.frame_faults.armed or self.collision:
            self._decide_fate(winner, entry[FRAME])
        return True

    def _lowest(self, start_ns: int) -> WireNode | None:
        """Who of those ready wins the arbitration at `start_ns`; None: nobody is ready. Notes a collision if a second
        node sends the winner's identifier with other bits.
        """
        winner = None
        lowest = 1 << 40
        collision: tuple[WireNode, ...] = ()
        for node in self.waiting:
            ready_ns, key, frame, _ = node.queue[0]
            if key > lowest or ready_ns > start_ns:
                continue
            if winner is None or key < lowest:
                winner, lowest, collision = node, key, ()
            elif winner.queue[0][FRAME][:3] != frame[:3]:
                collision = (winner, node)
        self.collision = collision
        return winner

    def _decide_fate(self, sender: WireNode, frame: Frame) -> None:
        """Whether the script, or a second sender of the same identifier, spoils the frame that begins now."""
        if self.collision:
            self.fate = WireFault(FaultKind.CORRUPT, bit=COLLISION_BIT)
        elif not sender.repeating:
            self.fate = self.frame_faults.strike(self.start_ns, sender.name, frame.can_id)
        if self.fate is not None and self.fate.kind is FaultKind.CORRUPT:
            bit = self.fate.bit if self.fate.bit >= 0 else self.random.below(sum(frame_bits(frame)))
            until_error_ns = elapsed_ns(frame, bit, self.nominal_ns, self.data_ns)
            self.end_ns = self.start_ns + until_error_ns + self.nominal_ns[ERROR_FRAME]

    def _finish(self) -> None:
        """The frame on the wire ends, well or not."""
        sender = self.sender
        assert sender is not None
        end_ns = self.now_ns = self.end_ns
        fate = self.fate
        if fate is not None and fate.kind is FaultKind.CORRUPT:
            self.confinement.failed(sender)
            return
        can_id, data, flags, _ = sender.queue[0][FRAME]
        targets = sender.targets.get(can_id)
        if targets is None:
            targets = self._route(sender, can_id)
        if not targets and not self._acknowledged(sender):
            self.confinement.not_acknowledged(sender)
            return
        received = Frame(can_id, data, flags, end_ns)
        self.sender = self.fate = None
        self.free_ns = end_ns + self._intermission_ns
        self.busy_ns += self.free_ns - self.start_ns
        if self.observer is not None:
            self.observer(self.start_ns, end_ns, sender.name, received, True)
        if fate is not None and fate.kind is FaultKind.DUPLICATE:
            self.confinement.failed_in_last_bit(sender)
        else:
            self._sent(sender)
        if self._drop_probability and self.random.chance(self._drop_probability):
            self.dropped += 1
        elif fate is not None:
            self.late.deliver(targets, received, fate)
        else:
            for node in targets:
                node.received += 1
                node.receive(received)  # type: ignore[misc]  # a target has a receiver
            if self.late.held:
                self.late.release()

    def _sent(self, sender: WireNode) -> None:
        queue = sender.queue
        queue.popleft()
        if not queue:
            self.waiting.remove(sender)
        sender.sent += 1
        sender.repeating = False
        if not self.confinement.healthy:
            self.confinement.succeeded(sender)
        if sender.on_sent is not None:
            sender.on_sent(self.now_ns)

    def _route(self, sender: WireNode, can_id: int) -> tuple[WireNode, ...]:
        """Who takes a frame of that sender; kept until the topology changes."""
        targets = tuple(
            node
            for node in self.nodes.values()
            if node is not sender
            and node.listening
            and node.receive is not None
            and (node.accept is None or can_id in node.accept)
        )
        sender.targets[can_id] = targets
        return targets

    def _acknowledged(self, sender: WireNode) -> bool:
        return any(node is not sender and node.listening for node in self.nodes.values())
