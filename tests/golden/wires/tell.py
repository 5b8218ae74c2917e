"""What happens on a simulated wire: nodes that send, fail, are purged and restarted under a script drawn by name."""

from random import Random

from drivers.frame import BRS, FD, Frame
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.node import WireNode
from drivers.wire.wire import Wire
from tests.golden.golden import sha256

MS = 1_000_000
STEPS, WIRES = 60, 60
NODES = ("host", "drive0", "drive1", "other")
# One more here would change every script: give a new kind stories of its own, drawn from a list of their own.
KINDS = ("drop", "duplicate", "reorder", "delay", "corrupt", "alter", "no_ack", "bus_off", "down", "babble")


def stories() -> list[str]:
    """Their names."""
    return [f"wire {number}" for number in range(WIRES)]


def tell(story: str) -> list[str]:
    """The script, and what every node did."""
    told, happened = _play(story)
    return [*told, f"sha256 of everything: {sha256(*happened)}"]


def full(story: str) -> list[str]:
    """Every attempt to send, every frame received and every counter."""
    return _play(story)[1]


def _play(story: str) -> tuple[list[str], list[str]]:
    draw, happened = Random(story), list[str]()

    def attempt(*what: object) -> None:
        happened.append(repr(what))

    script = [_fault(draw) for _ in range(draw.randrange(1, 5))]
    data_rate, seed = draw.choice((1, 2, 5)) * 1_000_000, draw.randrange(1000)
    wire = Wire(1_000_000, data_rate, faults=script, seed=seed, observer=attempt)
    nodes = [
        wire.attach(
            name, lambda frame, name=name: attempt(name, frame), queue_length=draw.randrange(1, 6),
            fifo=draw.random() < 0.5, accept=None if draw.randrange(3) else {1, 0x100, 0x300},
        )
        for name in NODES
    ]  # fmt: skip
    for step in range(STEPS):
        for _ in range(draw.randrange(4)):
            node, flags = draw.choice(nodes), draw.choice((0, 0, FD, FD | BRS))
            can_id, length = draw.choice((1, 0x100, 0x200, 0x300, 0x7FF, 1 << 31 | 5)), draw.choice((0, 1, 4, 8))
            attempt(node.send(Frame(can_id, draw.randbytes(length), flags), wire.now_ns))
        wire.advance(wire.now_ns + draw.choice((1, 40_000, 200_000, MS, 3 * MS)))
        chosen = draw.choice(nodes)
        if draw.randrange(12) == 0:
            attempt(chosen.purge())
        if step % 9 == 8:
            chosen.restart(wire.now_ns)
        attempt([(node.name, node.counters(), node.tec, node.rec, len(node.queue)) for node in nodes], wire.busy_ns)
    told = [f"wire: 1 Mbit/s, data {data_rate // 1_000_000} Mbit/s", *map(_words, script)]
    told.append(f"ends after {wire.now_ns / MS:.3f} ms, of which the wire was busy {wire.busy_ns / MS:.3f} ms")
    return [*told, *map(_node, nodes)], happened


def _fault(draw: Random) -> WireFault:
    kind = FaultKind(draw.choice(KINDS))
    begins, node = draw.randrange(30 * MS), draw.choice(("host", "drive0", "drive1"))
    return WireFault(
        kind, begins, begins + draw.randrange(1, 9 * MS), node="babbler" if kind is FaultKind.BABBLE else node,
        can_id=draw.choice((None, 1, 0x100)), count=draw.randrange(12), probability=draw.choice((1.0, 0.5, 0.1)),
        delay_ns=draw.randrange(2 * MS), bit=draw.choice((-1, 3, 30)),
    )  # fmt: skip


def _words(fault: WireFault) -> str:
    frames = "any frame" if fault.can_id is None else f"frame {fault.can_id:X}"
    return (
        f"fault: {fault.kind.value} of {fault.node}, {frames}, from {fault.from_ns / MS:.3f} to"
        f" {fault.until_ns / MS:.3f} ms, probability {fault.probability:g}, count {fault.count},"
        f" delay {fault.delay_ns / MS:.3f} ms, bit {fault.bit}"
    )


def _node(node: WireNode) -> str:
    counts = node.counters()._asdict()
    state = counts.pop("state").name
    seen = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    return f"node {node.name}: {seen}; TEC {node.tec}, REC {node.rec}, {len(node.queue)} waiting; {state}"
