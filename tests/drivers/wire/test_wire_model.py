"""The wire against a plain model of CAN arbitration: frame by frame, whoever sends what and when, in whatever steps."""

from collections.abc import Sequence
from typing import NamedTuple

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frame import EXTENDED, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.wire.wire import Wire

BIT = 1000  # ns at 1 Mbit/s
END = 40_000_000


class Sending(NamedTuple):
    """A frame that a node is told to send, at `told`, not to begin before `at`."""

    told: int
    node: int
    at: int
    frame: Frame


class Attempt(NamedTuple):
    """What an observer sees."""

    start: int
    end: int
    sender: str
    frame: Frame


def urgency(frame: Frame) -> tuple[int, int, int]:
    """The arbitration field's order: base identifier, then a standard frame before an extended one, then the rest."""
    if frame.can_id & EXTENDED:
        return frame.can_id >> 18 & 0x7FF, 1, frame.can_id & 0x3FFFF
    return frame.can_id & 0x7FF, 0, 0


class Model:
    """One event after the other: a frame ends, or somebody sends. on_wire: start, end and node of the frame there."""

    def __init__(self, fifo: Sequence[bool], room: int) -> None:
        self.fifo, self.room = fifo, room
        self.queues: list[list[tuple[int, Frame]]] = [[] for _ in fifo]
        self.on_wire: tuple[int, int, int] | None = None
        self.free = 0
        self.heard: list[Attempt] = []

    def run(self, sendings: Sequence[Sending]) -> list[bool]:
        """Which of the sendings were taken; what ended on the wire is in `heard`."""
        taken: dict[int, bool] = {}
        # A node without a FIFO looks at a frame when it is due, and says until then that it has taken it.
        due = [s.told if self.fifo[s.node] else s.at for s in sendings]
        for now, number in sorted((at, number) for number, at in enumerate(due)):
            self.until(now)
            sending = sendings[number]
            taken[number] = self.put(sending.node, sending.at, sending.frame) or sending.told < now
        self.until(END)
        return [taken[number] for number in range(len(sendings))]

    def until(self, now: int) -> None:
        while True:
            following = self.on_wire or self.next()
            if following is not None and following[0] < now:
                self.on_wire = following
            if self.on_wire is None or self.on_wire[1] >= now:
                return
            start, end, node = self.on_wire
            self.heard.append(Attempt(start, end, f"node {node}", self.queues[node].pop(0)[1]))
            self.on_wire, self.free = None, end + INTERMISSION * BIT

    def next(self) -> tuple[int, int, int] | None:
        heads = [(*queue[0], node) for node, queue in enumerate(self.queues) if queue]
        if not heads:
            return None
        start = max(self.free, min(ready for ready, _, _ in heads))
        _, node, frame = min((urgency(frame), node, frame) for ready, frame, node in heads if ready <= start)
        return start, start + sum(frame_bits(frame)) * BIT, node

    def put(self, node: int, at: int, frame: Frame) -> bool:
        queue = self.queues[node]
        if len(queue) >= self.room:
            return False
        place = len(queue)
        if not self.fifo[node]:
            first = 1 if self.on_wire and self.on_wire[2] == node else 0
            while place > first and urgency(queue[place - 1][1]) > urgency(frame):
                place -= 1
        queue.insert(place, (at, frame))
        return True


FRAMES = st.builds(
    lambda can_id, data: Frame(can_id, data),
    st.sampled_from([0x100, 0x101, 0x180, 0x200, 0x7FF, EXTENDED | 0x100 << 18, EXTENDED | 0x101 << 18 | 5]),
    st.sampled_from([b"", b"\x55" * 4, bytes(8)]),
)


@settings(max_examples=60)
@given(data=st.data())
def test_every_frame_ends_when_a_plain_model_says(data: st.DataObject) -> None:
    nodes = data.draw(st.integers(1, 4))
    fifo = data.draw(st.lists(st.booleans(), min_size=nodes, max_size=nodes))
    room = data.draw(st.integers(1, 4))
    told = data.draw(st.lists(st.integers(0, 1500), max_size=14))
    sendings: list[Sending] = []
    for number, micros in enumerate(sorted(told)):
        node = data.draw(st.integers(0, nodes - 1))
        delay = data.draw(st.sampled_from([0, 0, 1, 130, 700]))
        # No two nodes send one identifier: that would be a collision. No two things happen in one instant.
        frame = data.draw(FRAMES)
        frame = frame._replace(can_id=frame.can_id ^ node << 3)
        now = micros * 1000 + 20 * number + 1
        sendings.append(Sending(now, node, now + delay * 1000 + (7 if delay else 0), frame))
    model = Model(fifo, room)
    taken, expected = model.run(sendings), model.heard
    heard: list[tuple[Attempt, bool]] = []
    wire = Wire(
        1_000_000,
        observer=lambda start, end, name, frame, sent: heard.append(
            (Attempt(start, end, name, frame._replace(timestamp_ns=0)), sent)
        ),
    )
    received: list[Frame] = []
    listener = wire.attach("listener", received.append)
    attached = [wire.attach(f"node {node}", None, room, None, fifo[node]) for node in range(nodes)]
    did = []
    for sending in sendings:
        wire.advance(sending.told)
        did.append(attached[sending.node].send(sending.frame, sending.at))
    for step in sorted(data.draw(st.lists(st.integers(2_000_000, END), max_size=4))):
        wire.advance(step)
    wire.advance(END)
    assert heard == [(attempt, True) for attempt in expected]
    assert received == [attempt.frame._replace(timestamp_ns=attempt.end) for attempt in expected]
    assert (listener.received, wire.dropped) == (len(expected), 0)
    assert did == taken
    assert wire.busy_ns == sum(attempt.end - attempt.start + INTERMISSION * BIT for attempt in expected)
    assert sum(node.sent for node in attached) == len(expected)
