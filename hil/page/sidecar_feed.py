"""A rig's sidecar as the page hears it: the newest status and the events, from a thread, as Zenoh may wait."""

import threading
import time
from typing import Any, Final

from hil.live.mapped_file import Closing
from hil.page.words import cell_words, event_words, status_words
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import NoSidecarError, RigClient, find_endpoint
from hil.telemetry.kept_events import KeptEvents

POLL_S: Final = 0.05
SILENT_S: Final = 2.0  # after which it is looked for elsewhere
KEPT: Final = 500  # events
MOST_CELLS: Final = 4000


class SidecarFeed(Closing):
    """rig: its name. key: [telemetry] key. What came is kept under a lock; nobody who asks waits for the network."""

    def __init__(self, rig: str, key: str = "hil") -> None:
        self._rig, self._key = rig, key
        self._lock = threading.Lock()
        self._status: dict[str, Any] = {}
        self._message: pb.Status | None = None
        self._heard_s: float | None = None
        self._events = KeptEvents(KEPT)
        self._cells: dict[tuple[int, int], tuple[int, pb.Cell]] = {}
        self._news = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name=f"sidecar of {rig}", daemon=True)
        self._thread.start()

    @property
    def age_s(self) -> float:
        """Of its last word; NaN before the first."""
        return float("nan") if self._heard_s is None else time.monotonic() - self._heard_s

    @property
    def status(self) -> dict[str, Any]:
        """The newest status in words; empty before the first."""
        with self._lock:
            return self._status

    @property
    def message(self) -> pb.Status | None:
        """The newest status as it came; None before the first."""
        with self._lock:
            return self._message

    @property
    def told(self) -> int:
        """How many events have come so far."""
        with self._lock:
            return self._events.told

    def events(self, told: int = 0) -> tuple[int, list[dict[str, Any]]]:
        """How many events have come so far, and those after the first `told` that are still kept, in words."""
        count, messages = self.event_messages(told)
        return count, [event_words(event, self._rig) for event in messages]

    def event_messages(self, told: int = 0) -> tuple[int, list[pb_events.Event]]:
        """The same as they came."""
        with self._lock:
            return self._events.told, self._events.since(told)

    @property
    def news(self) -> int:
        """How often a cell has come to something new so far."""
        with self._lock:
            return self._news

    def cells(self, run: int, since: int = 0) -> tuple[int, list[dict[str, Any]]]:
        """How often a cell has come to something new so far, and the newest word on each to which that happened after
        the first `since` times. run: number of the ring.
        """
        with self._lock:
            fresh = [cell for news, cell in self._cells.values() if news > since and cell.run == run]
            return self._news, [cell_words(cell) for cell in fresh]

    def _keep_cells(self, cells: list[pb.Cell]) -> None:
        for cell in cells:
            known = self._cells.get((cell.run, cell.number))
            if known is None or known[1].index < cell.index:
                self._news += 1
                self._cells[cell.run, cell.number] = self._news, cell
        while len(self._cells) > MOST_CELLS:
            del self._cells[next(iter(self._cells))]

    def _listen(self) -> None:
        while not self._over.is_set():
            try:
                with RigClient(find_endpoint(self._rig), self._key, self._rig) as client:
                    self._follow(client)
            except NoSidecarError:
                return  # a name that no sidecar can have

    def _follow(self, client: RigClient) -> None:
        """Until the sidecar has been silent for long, or the page ends."""
        since = time.monotonic()
        while not self._over.wait(POLL_S):
            status, events, cells = client.status(), client.events(), client.cells()
            now = time.monotonic()
            with self._lock:
                if status is not None:
                    self._status, self._message, self._heard_s, since = status_words(status), status, now, now
                self._events.add(events)
                self._keep_cells(cells)
            if now - since > SILENT_S:
                return

    def close(self) -> None:
        """End the thread; idempotent."""
        self._over.set()
        self._thread.join(SILENT_S)
