"""What every part of the simulated segment shares: its clock and agenda, its bit times, and the frame on it.

A `Segment` only holds state and plans actions; it decides nothing. Nodes (node.py), fault confinement (confinement.py)
and injected faults (injection.py) take one and know nothing of each other's owner; `Wire` (wire.py) is the segment that
makes time pass. So the imports run one way: wire, injection, confinement, node, segment.
"""

from collections.abc import Callable
from heapq import heappush
from typing import Any, Generic, TypeVar

from drivers.frame import Frame
from drivers.frame_length import ACK_TO_EOF, frame_bits
from drivers.wire.faults import Random, WireFault

LONGEST = 800  # bits; more than any frame has at either rate

Observer = Callable[[int, int, str, Frame, bool], None]
Node = TypeVar("Node")


class Segment(Generic[Node]):
    """The state of a CAN segment. Times are virtual ns.

    now_ns: time reached. busy_ns: time the bus was not idle so far. dropped: frames lost silently so far.
    nominal_ns, data_ns: duration of so many bits at either rate. nodes: by name. waiting: those on the bus with
    something to send. random: of the segment's seed. observer: called at the end of every attempt to send.
    The frame on the wire: sender (None: there is none), start_ns, end_ns, what the script does to it (fate), and the
    nodes that send its identifier at the same time (collision). free_ns: the bus is free from then on.
    """

    def __init__(self, bitrate: int, data_bitrate: int, seed: int, start_ns: int, observer: Observer | None) -> None:
        """bitrate, data_bitrate: bit/s. Raises ValueError where one of them is not positive."""
        if bitrate < 1 or data_bitrate < 1:
            raise ValueError(f"bitrate = {bitrate}, data_bitrate = {data_bitrate}: both must be positive")
        self.nominal_ns = [-(-bits * 1_000_000_000 // bitrate) for bits in range(LONGEST)]
        self.data_ns = [-(-bits * 1_000_000_000 // data_bitrate) for bits in range(LONGEST)]
        self.frame_bits = frame_bits
        self.now_ns = start_ns
        self.busy_ns = 0
        self.dropped = 0
        self.observer = observer
        self.random = Random(seed)
        self.nodes: dict[str, Node] = {}
        self.waiting: list[Node] = []
        self.sender: Node | None = None
        self.start_ns = start_ns
        self.end_ns = start_ns
        self.free_ns = start_ns
        self.fate: WireFault | None = None
        self.collision: tuple[Node, ...] = ()
        self.agenda: list[tuple[int, int, Callable[..., object], tuple[Any, ...]]] = []
        self._planned = 0

    def at(self, time_ns: int, action: Callable[..., object], *arguments: Any) -> None:
        """Plan an action; those of one instant run in the order in which they were planned."""
        self._planned += 1
        heappush(self.agenda, (max(time_ns, self.now_ns), self._planned, action, arguments))


def elapsed_ns(frame: Frame, bit: int, nominal_ns: list[int], data_ns: list[int]) -> int:
    """Time from SOF to the end of bit `bit` (0: SOF) of a frame; bits behind its last one count as its last."""
    nominal, fast = frame_bits(frame)
    done = min(bit + 1, nominal + fast)
    in_data_phase = min(max(done - (nominal - ACK_TO_EOF), 0), fast)  # none where there is no such phase
    return nominal_ns[done - in_data_phase] + data_ns[in_data_phase]
