"""Random traffic for the schedulability analysis, and the same traffic on the simulated wire, as adverse as it gets."""

import heapq
import random
from collections.abc import Callable, Sequence

from drivers.bus_load.schedulability import frame_ns
from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame
from drivers.protocols.base import Message
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.wire import Wire

MS = 1_000_000
# Long runs of equal bits: payloads that are stuffed a lot.
STUFFED = (b"\x00", b"\xff", b"\x0f\x87", b"\x78\x3c\x1e\x0f\x87\xc3\xe1\xf0")


def random_messages(draw: random.Random, bitrate: int) -> list[Message]:
    """Sporadic traffic of a few nodes and, in two sets of three, a control tick with feedback."""
    bit_ns = 1_000_000_000 // bitrate
    fd = draw.random() < 0.4
    identifiers = draw.sample(range(0x7FF), 16)
    extended = draw.random() < 0.2
    can_ids = [i << 18 | EXTENDED if extended and draw.random() < 0.5 else i for i in identifiers]
    frame = draw.choice((150, 250, 600)) * bit_ns  # about one frame's time; periods are multiples of it
    messages: list[Message] = []

    def length() -> int:
        return draw.choice(FD_LENGTHS[:13]) if fd else draw.randint(0, 8)

    if draw.random() < 0.67:
        period = draw.choice((6, 8, 12)) * frame
        burst = [
            Message(f"command{i}", can_ids.pop(), length(), fd, period, period, 0, "host")
            for i in range(draw.choice((1, 1, 2, 3)))
        ]
        jitter = draw.choice((0, 0, draw.randrange(frame)))
        burst = [message._replace(jitter_ns=jitter) for message in burst]
        messages += burst
        for axis in range(draw.randint(1, 4)):
            delay = draw.choice((0, 0, draw.randrange(frame)))
            sender = f"drive{axis if draw.random() < 0.8 else 0}"
            messages.append(
                Message(f"feedback{axis}", can_ids.pop(), length(), fd, period, period, delay, sender, burst[-1].name)
            )
        if draw.random() < 0.5:
            slow = period * draw.randint(2, 9)
            messages.append(Message("service", can_ids.pop(), length(), fd, slow, slow, 0, "host"))
            if draw.random() < 0.5:
                messages.append(Message("answer", can_ids.pop(), length(), fd, slow, 9 * slow, 0, "drive0", "service"))
    for index in range(draw.randint(1 if messages else 2, 5)):
        period = draw.randint(4, 40) * frame + draw.randrange(frame)
        jitter = draw.choice((0, draw.randrange(period // 2)))
        sender = draw.choice((f"node{index}", "drive0", "shared"))
        messages.append(Message(f"sporadic{index}", can_ids.pop(), length(), fd, period, period, jitter, sender))
    return loaded(messages, bitrate, draw.choice((0.4, 0.7, 0.9, 0.97, draw.uniform(0.3, 1.0))))


def loaded(messages: Sequence[Message], bitrate: int, load: float) -> list[Message]:
    """The same traffic with its periods stretched or shrunk so that it takes that fraction of the bus at worst."""
    present = sum(frame_ns(message, bitrate, 4 * bitrate) / message.period_ns for message in messages)
    base = min([message.period_ns for message in messages if message.sender == "host"], default=1)
    tick = round(base * present / load)

    def scaled(message: Message) -> Message:
        in_step = message.sender == "host" or message.after is not None
        period = tick * (message.period_ns // base) if in_step else round(message.period_ns * present / load)
        jitter = min(message.jitter_ns, period // 2)
        return message._replace(period_ns=period, deadline_ns=period, jitter_ns=jitter)

    return [scaled(message) for message in messages]


class Simulation:
    """Sends the messages on a wire and keeps each one's longest response, in ns from its tick's start or its event."""

    def __init__(
        self, messages: Sequence[Message], draw: random.Random, bitrate: int, fifo: Sequence[str], faults: int
    ) -> None:
        self.longest = dict.fromkeys((message.name for message in messages), 0)
        self._messages = messages
        self._draw = draw
        hit = WireFault(FaultKind.CORRUPT, from_ns=draw.randrange(20 * MS), count=faults)
        self._wire = Wire(bitrate, bitrate * 4, seed=draw.randrange(1 << 32), faults=[hit] if faults else [])
        # The critical instant: all that has been delayed as long as it can be is queued at once, and all else on time.
        self._critical = draw.random() < 0.6
        self._begun: set[str] = set()
        self._latest = max(message.jitter_ns for message in messages)
        self._by_id = {message.can_id: message for message in messages}
        self._nodes = {
            sender: self._wire.attach(sender, None, 500, fifo=sender in fifo)
            for sender in dict.fromkeys(message.sender for message in messages)
        }
        self._wire.attach("observer", self._received)
        self._released: dict[str, list[int]] = {name: [] for name in self.longest}
        triggers = {message.after for message in messages}
        ticks = [m for m in messages if m.after is None and m.name in triggers]
        self._tick = min((m.period_ns for m in ticks), default=0)
        self._events: list[tuple[int, int, Callable[[int], None]]] = []
        self._count = 0
        self._ticks = 0

    def run(self, until_ns: int) -> None:
        """Everything at once at first, then as often as each period allows."""
        host = [m for m in self._messages if m.sender == "host" and m.after is None and self._tick]
        if host:
            self._plan(self._latest if self._critical else 0, lambda now: self._begin_tick(now, host))
        for message in self._messages:
            if message.after is None and message not in host:
                phase = self._draw.choice((0, 0, self._draw.randrange(message.period_ns)))
                if self._critical:
                    phase = self._latest - message.jitter_ns
                self._plan(phase, lambda now, m=message: self._happen(now, m))  # type: ignore[misc]
        while self._events and self._events[0][0] < until_ns:
            time_ns, _, action = heapq.heappop(self._events)
            self._wire.advance(time_ns)
            action(time_ns)
        self._wire.advance(until_ns)

    def _plan(self, time_ns: int, action: Callable[[int], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (time_ns, self._count, action))

    def _begin_tick(self, now: int, host: Sequence[Message]) -> None:
        self._plan(now + self._tick, lambda later: self._begin_tick(later, host))
        burst = [m for m in host if m.period_ns == self._tick]
        due = [m for m in host if m.period_ns > self._tick and self._ticks % (m.period_ns // self._tick) == 0]
        self._ticks += 1
        delay = self._jitter(burst[0])
        self._plan(now + delay, lambda later: [self._send(later, m, now) for m in (*burst, *due[:1])])  # type: ignore[func-returns-value]

    def _happen(self, now: int, message: Message) -> None:
        late = 0 if self._critical else self._draw.choice((0, 0, 0, self._draw.randrange(message.period_ns)))
        self._plan(now + message.period_ns + late, lambda later: self._happen(later, message))
        self._plan(now + self._jitter(message), lambda later: self._send(later, message, now))

    def _jitter(self, message: Message) -> int:
        if self._critical:
            first = message.name not in self._begun
            self._begun.add(message.name)
            return message.jitter_ns if first else 0
        return self._draw.choice((0, message.jitter_ns, self._draw.randint(0, message.jitter_ns)))

    def _send(self, now: int, message: Message, released: int) -> None:
        self._released[message.name].append(released)
        assert self._nodes[message.sender].send(self._frame(message), now)

    def _frame(self, message: Message) -> Frame:
        data = self._draw.randbytes(message.length)
        if self._critical or self._draw.random() < 0.7:
            data = (self._draw.choice(STUFFED) * 64)[: message.length]
        return Frame(message.can_id, data, FD | BRS if message.fd else 0)

    def _received(self, frame: Frame) -> None:
        message = self._by_id[frame.can_id]
        released = self._released[message.name].pop(0)
        now = frame.timestamp_ns
        self.longest[message.name] = max(self.longest[message.name], now - released)
        for follower in self._messages:
            if follower.after == message.name:
                delay = self._jitter(follower)
                if delay:
                    self._wire.at(now + delay, self._send, now + delay, follower, released)
                else:
                    self._send(now, follower, released)
