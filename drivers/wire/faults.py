"""Scripted misbehaviour of the simulated CAN segment: what, when, on which identifier, how often."""

from dataclasses import dataclass
from enum import StrEnum

MASK64 = 2**64 - 1
FOREVER_NS = 2**62


class FaultKind(StrEnum):
    """What goes wrong.

    Frame faults act on frames that match `can_id` and `node` (the sender) and begin within the window:

    DROP: acknowledged on the wire and lost behind it (a full mailbox, a lost interrupt).
    DUPLICATE: the last bit of EOF is disturbed: its receivers have taken the frame, its sender repeats it.
    REORDER: handed over only after the next frame, at the latest `delay_ns` later (a gateway, a receive queue).
    DELAY: handed over `delay_ns` late.
    All but DUPLICATE and CORRUPT can be confined to one `receiver`.
    CORRUPT: a bit error that every node sees: error frame, counters, retransmission. `bit`: from SOF on; -1: seeded.
    ALTER: bit `bit` of the payload is inverted with a CRC that fits (damage beyond the controllers); -1: seeded.

    Node faults act on `node` for the whole window:

    NO_ACK: cut off from all other nodes (None: every node is): its frames are never acknowledged, it receives nothing.
    BUS_OFF: driven into bus-off at `from_ns`; it stays there until it is restarted explicitly.
    DOWN: its interface is down: it refuses to send, receives nothing and has lost what was queued.

    BABBLE: a node of its own sends `can_id` without a pause, or each `period_ns`, filling `length` bytes.
    """

    DROP = "drop"
    DUPLICATE = "duplicate"
    REORDER = "reorder"
    DELAY = "delay"
    CORRUPT = "corrupt"
    ALTER = "alter"
    NO_ACK = "no_ack"
    BUS_OFF = "bus_off"
    DOWN = "down"
    BABBLE = "babble"


FRAME_FAULTS = (
    FaultKind.DROP,
    FaultKind.DUPLICATE,
    FaultKind.REORDER,
    FaultKind.DELAY,
    FaultKind.CORRUPT,
    FaultKind.ALTER,
)


@dataclass(frozen=True)
class WireFault:
    """One scripted fault. Times are virtual ns; the window is from_ns <= t < until_ns.

    can_id: with Linux's flags; None: any frame. node: the sender (frame faults) or the victim (node faults); None:
    any. count: frame faults end after so many hits; 0: no limit. probability: of each hit, 0 < p <= 1, drawn from the
    wire's seed. Raises ValueError naming key, value and allowed range.
    """

    kind: FaultKind
    from_ns: int = 0
    until_ns: int = FOREVER_NS
    can_id: int | None = None
    node: str | None = None
    receiver: str | None = None
    count: int = 0
    probability: float = 1.0
    delay_ns: int = 1_000_000
    bit: int = -1
    period_ns: int = 0
    length: int = 8

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", FaultKind(self.kind))
        checks = {
            "from_ns": (self.from_ns, 0, FOREVER_NS),
            "until_ns": (self.until_ns, self.from_ns + 1, FOREVER_NS),
            "count": (self.count, 0, 2**31),
            "delay_ns": (self.delay_ns, 0, FOREVER_NS),
            "bit": (self.bit, -1, 1000),
            "period_ns": (self.period_ns, 0, FOREVER_NS),
            "length": (self.length, 0, 8),
        }
        for key, (value, low, high) in checks.items():
            if not low <= value <= high:
                raise ValueError(f"wire fault {self.kind}: {key} = {value}, allowed {low} to {high}")
        if not 0.0 < self.probability <= 1.0:
            raise ValueError(f"wire fault {self.kind}: probability = {self.probability}, allowed 0 < p <= 1")
        if self.kind is FaultKind.BUS_OFF and self.node is None:
            raise ValueError("wire fault bus_off: node = None, a node's name is needed")


class Random:
    """SplitMix64 (Steele, Lea, Flood 2014): the same stream on every machine and with every library version."""

    def __init__(self, seed: int) -> None:
        self._state = seed & MASK64

    def bits(self) -> int:
        """The next 64 random bits."""
        self._state = (self._state + 0x9E3779B97F4A7C15) & MASK64
        z = self._state
        z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & MASK64
        z = ((z ^ z >> 27) * 0x94D049BB133111EB) & MASK64
        return z ^ z >> 31

    def below(self, limit: int) -> int:
        """An integer in 0 <= x < limit."""
        return self.bits() * limit >> 64

    def chance(self, probability: float) -> bool:
        """True with that probability."""
        return self.bits() < probability * 2.0**64


class FrameFaults:
    """The frame faults of a script: which of them hits the frame that begins now. armed: (fault, [hits])."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self.armed: list[tuple[WireFault, list[int]]] = []

    def add(self, fault: WireFault) -> None:
        """Arm a fault."""
        self.armed.append((fault, [0]))

    def clear(self) -> None:
        """Disarm all."""
        self.armed.clear()

    def strike(self, now_ns: int, node: str, can_id: int) -> WireFault | None:
        """The first armed fault that hits this frame, or None. Faults whose time or count is over are removed."""
        self.armed = [
            (fault, hits)
            for fault, hits in self.armed
            if now_ns < fault.until_ns and (not fault.count or hits[0] < fault.count)
        ]
        for fault, hits in self.armed:
            matches = fault.from_ns <= now_ns and fault.can_id in (None, can_id) and fault.node in (None, node)
            if matches and (fault.probability >= 1.0 or self._random.chance(fault.probability)):
                hits[0] += 1
                return fault
        return None
