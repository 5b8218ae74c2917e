"""Does the traffic fit? Worst-case response time of every message on a segment, bus load, and what it depends on.

The analysis itself is in drivers/bus_load/response_time.py; docs/schedulability.md shows its arithmetic for the
layouts.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

from drivers.arbitration import arbitration_key
from drivers.bus_load.response_time import UNBOUNDED, Bus, ErrorModel, Item, solve
from drivers.frame import EXTENDED
from drivers.frame_length import worst_case_bits
from drivers.protocols.base import Message

NO_ERRORS = ErrorModel()
MOST_FAULTS = 100  # further than that nobody wants to know


@dataclass(frozen=True)
class Response:
    """One message's verdict; times in ns.

    cost_ns: longest transmission with its intermission. worst_ns: latest end after the tick's start (or after the event
    that triggers a message of another period); None: no bound exists. at_least_ns: then, for the message with which a
    tick first overruns, its end in that tick; 0 for the others.
    """

    message: Message
    bits: tuple[int, int]
    cost_ns: int
    worst_ns: int | None
    at_least_ns: int = 0

    @property
    def frame(self) -> str:
        """The message's name."""
        return self.message.name

    @property
    def margin_ns(self) -> int | None:
        """Deadline minus worst case; negative: too late by so much (or more: `at_least_ns`); None: unbounded."""
        worst_ns = self.worst_ns or self.at_least_ns
        return self.message.deadline_ns - worst_ns if worst_ns else None

    @property
    def fits(self) -> bool:
        """Meets its deadline always."""
        return self.worst_ns is not None and self.worst_ns <= self.message.deadline_ns


@dataclass(frozen=True)
class Analysis:
    """What `analyse` finds. responses: in the order of the messages. bus_load: fraction of time, at worst, all traffic.

    tick_ns: bus time of one tick's cyclic messages (the starter's burst and what it triggers), all at their longest.
    """

    responses: tuple[Response, ...]
    bus_load: float
    tick_ns: int

    @property
    def schedulable(self) -> bool:
        """Every message meets its deadline always."""
        return all(response.fits for response in self.responses)

    @property
    def tightest(self) -> Response:
        """Who to name: the message with which a tick first overruns; else one without bound; else the least margin."""
        overrun = [response for response in self.responses if response.at_least_ns]
        unbounded = [response for response in self.responses if response.worst_ns is None]
        return (overrun or unbounded or sorted(self.responses, key=lambda response: response.margin_ns or 0))[0]


def frame_bits(message: Message) -> tuple[int, int]:
    """Longest transmission, (bits at the nominal rate, bits at the data rate), with the intermission."""
    bits = worst_case_bits(message.length, fd=message.fd, extended=bool(message.can_id & EXTENDED))
    return bits if message.brs else (sum(bits), 0)


def frame_ns(message: Message, bitrate: int, data_bitrate: int) -> int:
    """Longest transmission in ns, with the intermission, rounded up."""
    nominal, fast = frame_bits(message)
    return -(-nominal * 1_000_000_000 // bitrate) + -(-fast * 1_000_000_000 // data_bitrate)


def analyse(
    messages: Sequence[Message],
    bitrate: int,
    data_bitrate: int,
    errors: ErrorModel = NO_ERRORS,
    fifo: Container[str] = ("host",),
) -> Analysis:
    """Bound the response time of every message.

    messages: all traffic on the segment, triggers before what they trigger. A message without `after` that others name
    in theirs starts the tick (of several, the most frequent one). With all messages of its sender and period it is
    queued at the tick's start, in the order given. What else that sender sends (service) is queued behind them, one
    such frame in a tick. All others are sporadic: their period is the least time between two. fifo: senders with one
    FIFO for all they send, as Linux has; all others send their most urgent message first. bitrate, data_bitrate: bit/s.
    What is sent at rest alone (`Message.at_rest`) delays nothing that has to be in time, and is left out. Raises
    ValueError naming the message for names or identifiers that are not unique and for triggers that do not exist.
    """
    _check(messages)
    messages = [message for message in messages if not message.at_rest]
    by_name = {
        message.name: Item(
            priority=arbitration_key(message.can_id),
            cost=frame_ns(message, bitrate, data_bitrate),
            period=message.period_ns,
            jitter=message.jitter_ns,
            sender=message.sender,
        )
        for message in messages
    }
    items = list(by_name.values())
    tick = _chain(messages, by_name)
    bus = Bus(items, -(-1_000_000_000 // bitrate), errors, fifo)
    deferred = [item for item in items if item.tick and item not in tick]
    if len(deferred) == 1 and deferred[0].period >= 2 * deferred[0].tick:
        _let_spill(tick, deferred[0])
    solve(bus)
    if deferred and any(item.response > item.limit for item in items if item.tick):
        # Service frames may be ahead of any tick's commands in the queue.
        for item in deferred:
            item.before, item.burst, item.tick = None, False, 0
        for item in tick:
            item.next = None
        solve(bus)
    responses = tuple(
        Response(
            message,
            frame_bits(message),
            item.cost,
            item.response if item.response < UNBOUNDED else None,
            item.overrun if item.response >= UNBOUNDED else 0,
        )
        for message, item in zip(messages, items, strict=True)
    )
    return Analysis(
        responses=responses,
        bus_load=sum(item.cost / item.period for item in items),
        tick_ns=sum(item.cost for item in tick),
    )


def faults_tolerated(messages: Sequence[Message], bitrate: int, data_bitrate: int) -> int:
    """How many faults anywhere in one response time leave every deadline met; -1: not even none."""
    tolerated = -1
    while tolerated < MOST_FAULTS:
        if not analyse(messages, bitrate, data_bitrate, ErrorModel(burst=tolerated + 1)).schedulable:
            return tolerated
        tolerated += 1
    return tolerated


def _check(messages: Sequence[Message]) -> None:
    if not messages:
        raise ValueError("no messages to analyse")
    names: set[str] = set()
    identifiers: dict[int, Message] = {}
    for message in messages:
        if message.name in names:
            raise ValueError(f"message {message.name}: the name is used twice")
        names.add(message.name)
        other = identifiers.setdefault(arbitration_key(message.can_id), message)
        # One node's frames never meet on the bus, nor do a command and its answer.
        if other.sender != message.sender and other.name != message.after:
            raise ValueError(f"messages {other.name} and {message.name} have one identifier, {message.can_id:#x}")
        if message.period_ns < 1 or message.deadline_ns < 1 or message.jitter_ns < 0:
            raise ValueError(f"message {message.name}: period and deadline must be positive, jitter not negative")
    by_name = {message.name: message for message in messages}
    for message in messages:
        seen = {message.name}
        trigger = message
        while trigger.after is not None:
            if trigger.after not in by_name:
                raise ValueError(f"message {trigger.name} is sent after {trigger.after!r}, which does not exist")
            if trigger.after in seen:
                raise ValueError(f"message {trigger.name} is sent after itself")
            seen.add(trigger.after)
            trigger = by_name[trigger.after]
        if trigger.period_ns != message.period_ns:
            raise ValueError(f"message {message.name}: its period is not that of {trigger.name}, which triggers it")


def _chain(messages: Sequence[Message], items: dict[str, Item]) -> list[Item]:
    """Fill in what is on the bus before each message of a tick. Returns the cyclic ones.

    The other messages of the node that starts the tick are queued behind its burst, at most one of them in a tick.
    """
    triggers = {message.after for message in messages if message.after is not None}
    ticks = {
        (message.sender, message.period_ns)
        for message in messages
        if message.after is None and message.name in triggers
    }
    if not ticks:
        return []
    starter, period = min(ticks, key=lambda tick: tick[1])
    cyclic: list[Item] = []
    last: Item | None = None
    for message in messages:
        item = items[message.name]
        if message.after is not None:
            item.before = items[message.after]
            if item.before not in cyclic:
                continue
        elif (message.sender, message.period_ns) == (starter, period):
            item.before, item.burst = last, last is not None
            last = item
        else:
            continue
        item.tick = item.limit = period
        cyclic.append(item)
    for message in messages:
        item = items[message.name]
        if message.sender == starter and message.after is None and message.period_ns > period:
            item.before, item.burst, item.tick, item.limit = last, True, period, period
    return cyclic


def _let_spill(tick: Sequence[Item], service: Item) -> None:
    """The only service frame comes at most in every other tick: it may end in the tick after its own, whose burst is
    queued behind it."""
    service.limit = 2 * service.tick
    for item in tick:
        item.next = replace(item, next=None)
    for item in tick:
        assert item.next is not None
        if item.before is None:
            item.next.before, item.next.burst = service, True
        else:
            item.next.before = item.before.next
