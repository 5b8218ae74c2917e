"""A CAN segment in virtual time: exact frame lengths, arbitration, finite queues, and every way a bus can misbehave.

Time is integer nanoseconds and passes only in `Wire.advance`. Nothing is random except through the seed, so a run is
the same on every machine. A frame that has begun is never interrupted by another one; its last EOF bit is its time
stamp; three bits later the bus is free, and of the frames then waiting the one with the lowest identifier begins.

Not modelled: bit timing below one bit (propagation, resynchronisation). Two nodes that would begin within the same bit
contend only if both were ready at the instant the first began; the schedulability analysis counts that bit as the
paper does.
"""

from collections.abc import Callable, Container, Sequence
from heapq import heappop, heappush
from typing import Any

from drivers.config import BusConfig, WireConfig
from drivers.frame import Frame, new_tuple
from drivers.frame_length import INTERMISSION, frame_bits, longest_bits
from drivers.wire.confinement import ERROR_FRAME, Confinement
from drivers.wire.faults import FRAME_FAULTS, FaultKind, FrameFaults, Random, WireFault
from drivers.wire.injection import LateDeliveries, NodeFaults
from drivers.wire.node import DURATION, FRAME, READY, WireNode, elapsed_ns

LONGEST = 800  # bits; more than any frame has at either rate
COLLISION_BIT = 20  # two senders with one identifier differ behind the arbitration field

Observer = Callable[[int, int, str, Frame, bool], None]


class Wire:
    """The segment. Attach nodes, let them send, advance.

    bitrate, data_bitrate: bit/s. drop_probability: of each frame, to be acknowledged and lost behind the wire, at
    every receiver. faults: the script; more can be injected at any time. observer: called at the end of every attempt
    to send, with start ns, end ns, sender's name, frame, and whether it was sent without an error.
    now_ns: virtual time reached. busy_ns: time the bus was not idle so far. dropped: frames lost silently so far.
    The other public attributes serve the parts of this simulation (drivers/wire_*.py), not its users.
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
        data_bitrate = data_bitrate or bitrate
        if bitrate < 1 or data_bitrate < 1:
            raise ValueError(f"bitrate = {bitrate}, data_bitrate = {data_bitrate}: both must be positive")
        if not 0.0 <= drop_probability < 1.0:
            raise ValueError(f"drop_probability = {drop_probability}, allowed 0 <= p < 1")
        self.frame_bits = longest_bits if worst_stuffing else frame_bits
        self.nominal_ns = [-(-bits * 1_000_000_000 // bitrate) for bits in range(LONGEST)]
        self.data_ns = [-(-bits * 1_000_000_000 // data_bitrate) for bits in range(LONGEST)]
        self.now_ns = start_ns
        self.busy_ns = 0
        self.dropped = 0
        self.observer = observer
        self.nodes: dict[str, WireNode] = {}
        self.waiting: list[WireNode] = []  # those on the bus with something to send
        self.random = Random(seed)
        # the frame on the wire: whose, since when, until when, what the script does to it, who else sends the same id
        self.sender: WireNode | None = None
        self.start_ns = start_ns
        self.end_ns = start_ns
        self.free_ns = start_ns  # the bus is free from here on
        self.fate: WireFault | None = None
        self.collision: tuple[WireNode, ...] = ()
        self.confinement = Confinement(self)
        self.frame_faults = FrameFaults(self.random)
        self.late = LateDeliveries(self)
        self.node_faults = NodeFaults(self)
        self._drop_probability = drop_probability
        self._intermission_ns = self.nominal_ns[INTERMISSION]
        self._agenda: list[tuple[int, int, Callable[..., object], tuple[Any, ...]]] = []
        self._planned = 0
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
        if name in self.nodes:
            raise ValueError(f"node {name!r} is attached already")
        node = self.nodes[name] = WireNode(self, name, receive, queue_length, accept, fifo)
        self.topology_changed()
        return node

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
        agenda = self._agenda
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

    def at(self, time_ns: int, action: Callable[..., object], *arguments: Any) -> None:
        """Plan an action; those of one instant run in the order in which they were planned."""
        self._planned += 1
        heappush(self._agenda, (max(time_ns, self.now_ns), self._planned, action, arguments))

    def topology_changed(self) -> None:
        """A node joined or left: who takes whose frames is worked out anew."""
        for node in self.nodes.values():
            node.targets.clear()

    def abandon(self, error_frame_ns: int = 0) -> None:
        """The frame on the wire ends without success; the bus is free after that error frame and an intermission."""
        sender = self.sender
        assert sender is not None
        self.free_ns = self.now_ns + error_frame_ns + self._intermission_ns
        self.busy_ns += self.free_ns - self.start_ns
        self.sender = self.fate = None
        if self.observer is not None:
            self.observer(self.start_ns, self.now_ns, sender.name, sender.queue[0][FRAME], False)

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
        received = new_tuple(Frame, (can_id, data, flags, end_ns))
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
