"""A steady rate for sources that have no clock of their own."""

import time

FRAME_NS = 33_333_333  # 30 images a second


class Pace:
    """One image every FRAME_NS; one that is late moves those after it."""

    def __init__(self) -> None:
        self._due_ns = time.monotonic_ns()

    def wait(self) -> None:
        """Until the next image is due."""
        now_ns = time.monotonic_ns()
        if self._due_ns > now_ns:
            time.sleep((self._due_ns - now_ns) * 1e-9)
        self._due_ns = max(self._due_ns, now_ns) + FRAME_NS
