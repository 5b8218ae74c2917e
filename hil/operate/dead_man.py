"""A dead man's handle: a key of the terminal that is held while a rig moves.

The operator's heartbeat is sent only then, so that a key let go, a terminal that hangs and a process that is gone stop
the rig alike, within RELEASED_S and safety.heartbeat_s.
"""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.operate.keys import held_keys

# Opened for each motion; tells whether the key is held.
Handle = Callable[[], contextlib.AbstractContextManager[Callable[[], bool]]]
KEY, NAMED = " ", "the space bar"
RELEASED_S = 0.25  # without the key, which terminals repeat ten times a second at least


class HeldKey:
    """Whether the key is held. keys: what was pressed since the last call; now_s: the clock it is held by."""

    def __init__(self, keys: Callable[[], str], now_s: Callable[[], float] = time.monotonic) -> None:
        self._keys, self._now_s = keys, now_s
        self._last_s = -RELEASED_S
        self._repeated = False

    def __call__(self) -> bool:
        """From the second press on: a terminal waits before it repeats the first, and a key touched is not held."""
        now_s, pressed = self._now_s(), self._keys().count(KEY)
        lately = now_s - self._last_s < RELEASED_S
        self._repeated = pressed > 1 or (lately and (self._repeated or pressed > 0))
        if pressed:
            self._last_s = now_s
        return self._repeated


@contextlib.contextmanager
def handle(source: Path | None = None) -> Iterator[HeldKey]:
    """The key of this terminal, or of a pipe. Raises NoTerminalError where standard input is no terminal."""
    with held_keys(source) as keys:
        yield HeldKey(keys)
