"""Worst-case response times on one CAN segment, integer ns.

Two bounds, both safe, of which the lower one holds:

`priority_queue_bound`: Davis, Burns, Bril, Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted,
revisited and revised", Real-Time Systems 35 (2007): busy period, all instances in it, blocking, queueing jitter,
faults. It holds for a message that does not share a FIFO with others. A message triggered by another one's reception
inherits the other's response time as jitter (Tindell, Clark, "Holistic schedulability analysis", 1994).

`backlog_bound`: for nodes that queue several messages in one FIFO, as Linux does, and for chains of messages within a
tick. Any instance of k that is still to be sent at time a has arrived after a - R_k. So what can go before a message
follows from the response times of the others, which are raised together until nothing changes. It is sound by induction
over time: the first instance to miss its bound would have waited for instances none of which had missed its own. What
precedes a message within its chain is on the bus before it is queued and does not delay it again. This makes a control
tick analysable: feedback never meets the command it answers.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, field

UNBOUNDED = 2**62  # ns; stands for "no bound"
ROUNDS = 60  # what still rises after so many rounds feeds on itself
HORIZON = 50  # longest periods; a busy bus that is not idle within them is taken for one that never is


@dataclass(frozen=True)
class ErrorModel:
    """Faults on the bus: at most `burst` at once, and one more per `interval_ns` (0: no more). F(t) of the paper."""

    burst: int = 0
    interval_ns: int = 0

    def faults(self, window_ns: int) -> int:
        """Most faults in a window of that length."""
        return self.burst + (-(-window_ns // self.interval_ns) if self.interval_ns else 0)


@dataclass(eq=False)
class Item:
    """One message under analysis. Times in ns.

    priority: lower wins. cost: longest transmission with its intermission. jitter: of its queueing, after its release.
    release: the tick's start for all chained messages. tick: the chain's period, 0 for others. before: the message that
    is on the bus before this one is queued (its trigger, or the one ahead in a burst of its sender); burst: it is that
    neighbour in one burst. limit: a chained message must be through by then. next: the same message in the tick after
    one whose last frame, a service frame, spilled over; its times count from the earlier tick.

    response: current bound from the release on. overrun: the response with which it was the first to exceed its limit.
    What a response is made of: fixed, so many instances of others (by id), blockers (sets of frames of which one may
    just have begun), and faults.
    """

    priority: int
    cost: int
    period: int
    jitter: int
    sender: str
    before: "Item | None" = None
    burst: bool = False
    tick: int = 0
    limit: int = 0
    next: "Item | None" = None
    response: int = 0
    overrun: int = 0
    fixed: int = 0
    counted: "dict[int, tuple[int, Item]]" = field(default_factory=dict)
    blockers: "tuple[tuple[Item, ...], ...]" = ()
    faults: int = 0

    def ancestors(self) -> list["Item"]:
        """Everything on the bus before this one is queued, nearest first."""
        found: list[Item] = []
        item = self.before
        while item is not None:
            found.append(item)
            item = item.before
        return found

    @property
    def latest_queueing(self) -> int:
        """Latest time after the release at which it is in its node's queue."""
        if self.before is None or self.burst:
            return self.jitter
        return min(self.before.response + self.jitter, UNBOUNDED)


def _ceil(a: int, b: int) -> int:
    return -(-a // b)


@dataclass(frozen=True)
class Bus:
    """What all messages share. bit: one nominal bit time, ns. fifo: nodes with one FIFO for all they send; the others
    have a transmit buffer for each message, of which the most urgent goes first."""

    items: Sequence[Item]
    bit: int
    errors: ErrorModel
    fifo: Container[str]

    def beside(self, item: Item) -> list[Item]:
        """All that may be queued while the item is: not what is before it in its chain, nor what comes after it."""
        pool = list(self.items)
        nexts = [other.next for other in self.items if other.next is not None]
        if item in nexts:
            pool = [other for other in self.items if not other.tick] + nexts
        ahead = item.ancestors()
        return [other for other in pool if other is not item and other not in ahead and item not in other.ancestors()]

    def queued_with(self, item: Item, other: Item) -> bool:
        """Both go through one FIFO."""
        return other is not item and other.sender == item.sender and item.sender in self.fifo

    @property
    def horizon(self) -> int:
        """Times beyond it, ns, are not told from infinity."""
        return HORIZON * max(item.period for item in self.items)

    def shared(self, item: Item) -> bool:
        """Others go through the same FIFO."""
        return any(self.queued_with(item, other) for other in self.items)

    def error_cost(self, candidates: Sequence[Item]) -> int:
        """Bus time one fault can cost: 31 bits of error frame and the longest frame sent anew."""
        return 31 * self.bit + max(item.cost for item in candidates)


def priority_queue_bound(bus: Bus, item: Item) -> int:
    """The paper's revised analysis, equations 6 to 13 with the error function of its section 6."""
    if bus.shared(item):
        return UNBOUNDED
    urgent = [other for other in bus.items if other.priority < item.priority or _is_twin(item, other)]
    jitters = [other.response - other.cost if bus.shared(other) else other.latest_queueing for other in urgent]
    if any(jitter >= UNBOUNDED // 2 for jitter in jitters) or item.latest_queueing >= UNBOUNDED // 2:
        return UNBOUNDED
    errors, error_cost = bus.errors, bus.error_cost([*urgent, item])
    load = sum(other.cost / other.period for other in [*urgent, item])
    if errors.interval_ns:
        load += error_cost / errors.interval_ns
    if load >= 1.0:
        return UNBOUNDED
    blocking = max((other.cost for other in bus.items if other.priority > item.priority), default=0)
    own_jitter = item.latest_queueing

    def interference(window: int) -> int:
        return sum(
            _ceil(window + jitter, other.period) * other.cost for other, jitter in zip(urgent, jitters, strict=True)
        )

    busy = item.cost
    while True:
        longer = (
            blocking
            + errors.faults(busy) * error_cost
            + _ceil(busy + own_jitter, item.period) * item.cost
            + interference(busy)
        )
        if longer == busy:
            break
        busy = longer
        if busy > bus.horizon:
            return UNBOUNDED
    worst = 0
    wait = blocking
    for instance in range(_ceil(busy + own_jitter, item.period)):
        while True:
            longer = (
                blocking
                + errors.faults(wait + item.cost) * error_cost
                + instance * item.cost
                + interference(wait + bus.bit)
            )
            if longer == wait:
                break
            wait = longer
        worst = max(worst, own_jitter + wait - instance * item.period + item.cost)
    return worst


def backlog_bound(bus: Bus, item: Item) -> int:
    """See the module's text. Holds only while nothing of one tick (or of one period) is left over in the next."""
    if item.tick and any(other.response > other.limit for other in bus.items if other.tick):
        return UNBOUNDED
    if not item.tick and item.response > item.period:
        return UNBOUNDED
    beside = bus.beside(item)
    mates = [other for other in beside if bus.queued_with(item, other)]
    if item.burst and not _arrives_late(item):
        mates = []  # nothing of the sender's gets between two messages that it queues together
    lowest = max(other.priority for other in [item, *mates])
    others = [other for other in beside if not bus.queued_with(item, other)]
    rivals = [other for other in others if other.priority < lowest or _is_twin(item, other)]
    blockers = tuple(other for other in others if other.priority > lowest)
    if item.before is not None and not _arrives_late(item):
        blockers = ()  # it takes part in the arbitration that follows the message before it: nothing slips in
    return _settle(bus, item, [*mates, *rivals], blockers)


def _is_twin(item: Item, other: Item) -> bool:
    """Another message of the same node in the same identifier: which of them goes first is up to the node."""
    return other is not item and (other.priority, other.sender) == (item.priority, item.sender)


def _arrives_late(item: Item) -> bool:
    """May be queued only some time after the message before it is through."""
    if item.before is None:
        return True
    return item.jitter > (item.before.jitter if item.burst else 0)


def _settle(bus: Bus, item: Item, others: Sequence[Item], blockers: tuple[Item, ...]) -> int:
    """Raise the time at which the message begins until it covers all that goes before it.

    A chained message's window opens with the tick: instances, blockers and faults that delayed what is before it in the
    chain are not counted a second time.
    """
    once = [other for other in others if other.tick and item.tick]  # of the same tick: each goes before it once
    recurring = [other for other in others if not (other.tick and item.tick)]
    if any(other.response >= UNBOUNDED for other in others):
        return UNBOUNDED
    if sum(other.cost / other.period for other in recurring) >= 1.0:
        return UNBOUNDED
    before = item.before
    fixed = sum(other.cost for other in once)
    fixed += item.jitter if _arrives_late(item) else 0
    known: dict[int, tuple[int, Item]] = {}
    known_faults = 0
    stages: tuple[tuple[Item, ...], ...] = ()
    if before is not None and item.tick:
        fixed += before.fixed + before.cost
        known, known_faults, stages = before.counted, before.faults, before.blockers
    elif before is not None:  # triggered once in a while, at the latest then
        fixed += before.response
    if blockers:
        stages = (*stages, blockers)
    error_cost = bus.error_cost(bus.items)
    begins = fixed
    while begins <= bus.horizon:  # a bound beyond that interests nobody
        window = begins if item.tick else begins - item.latest_queueing
        counted = dict(known)
        for other in recurring:
            instances = _ceil(window + other.response + bus.bit, other.period)
            counted[id(other)] = (max(instances, known.get(id(other), (0, other))[0]), other)
        faults = max(bus.errors.faults(window + item.cost), known_faults)
        later = fixed + faults * error_cost + sum(instances * other.cost for instances, other in counted.values())
        for stage in stages:
            later += max((other.cost for other in stage if id(other) not in counted), default=0)
        if later == begins:
            item.fixed, item.counted, item.blockers, item.faults = fixed, counted, stages, faults
            return begins + item.cost
        begins = later
    return UNBOUNDED


def solve(bus: Bus) -> None:
    """Raise all responses together, from the transmission times on, until no bound changes."""
    for item in bus.items:
        item.response = item.jitter + item.cost
    changed = True
    rounds = 0
    while changed:
        changed = False
        rounds += 1
        for item in bus.items:
            bound = backlog_bound(bus, item)
            if item.next is not None:
                item.next.response = backlog_bound(bus, item.next)
                bound = max(bound, item.next.response - item.tick)
            bound = min(priority_queue_bound(bus, item), bound, UNBOUNDED)
            if bound > item.response:
                if item.tick and item.limit < bound < UNBOUNDED and not any(other.overrun for other in bus.items):
                    item.overrun = bound
                item.response = bound if rounds <= ROUNDS else UNBOUNDED
                changed = True
