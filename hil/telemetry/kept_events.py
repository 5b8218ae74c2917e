"""Events kept for who joins late: those that a busy machine has in every second push out no others."""

import heapq
from collections import deque
from collections.abc import Iterable
from operator import itemgetter

from hil.events.storm import TOLD_OF
from hil.telemetry import events_pb2 as pb


class KeptEvents:
    """most: kept of either sort. told: how many came. dropped: all from that number on are kept."""

    def __init__(self, most: int) -> None:
        self._rings: tuple[deque[tuple[int, pb.Event]], ...] = (deque(maxlen=most), deque(maxlen=most))
        self.told = 0
        self.dropped = 0

    def add(self, events: Iterable[pb.Event]) -> None:
        """In the order in which they were told."""
        for event in events:
            ring = self._rings[int(event.kind) in TOLD_OF]
            if len(ring) == ring.maxlen:
                self.dropped = max(self.dropped, ring[0][0] + 1)
            ring.append((self.told, event))
            self.told += 1

    def since(self, told: int = 0) -> list[pb.Event]:
        """Those after the first `told` that are still kept, in their order."""
        if told >= self.told:
            return []
        return [event for number, event in heapq.merge(*self._rings, key=itemgetter(0)) if number >= told]
