"""Timed rows of positions as a stream of goals: each is sent a little before it is due, with its speed.

The program that makes the rows may still be at it: a row is sent once the next one, which its speed needs, is there.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, pairwise
from typing import Final, NamedTuple, Protocol

LEAD_S: Final = 0.05  # two intervals of a stream of 40 Hz
Row = tuple[float, Mapping[str, float]]  # time, s; positions by axis, m (rad)


class Streamed(NamedTuple):
    """What became of a stream's rows. late: they were due before they could be sent, and were left out. last: the
    positions of the last one, m (rad) by axis.
    """

    sent: int
    late: int
    last: Mapping[str, float]


class Streaming(Protocol):
    """What a stream is sent by: a Mover."""

    def now_ns(self) -> int:
        """The rig's time."""

    def sleep(self, seconds: float) -> None:
        """Let it pass."""

    def send(self, position: Mapping[str, float], velocity: Mapping[str, float], *, due: float) -> None:
        """The next point."""


def stream(mover: Streaming, rows: Iterable[Row], lead_s: float) -> Streamed:
    """Send rows, each to be reached lead_s after its time, which counts from the first one's arrival.

    Raises ValueError for a row that is not after the one before or has other axes, and as `send`.
    """
    sent = late = 0
    position: Mapping[str, float] = {}
    origin_ns = None  # of the rows' time, in the rig's
    for time, position, velocity in knots(rows):
        if origin_ns is None:
            origin_ns = mover.now_ns() - round(time * 1e9)
        due_ns = origin_ns + round((time + lead_s) * 1e9)
        early_s = (due_ns - mover.now_ns()) * 1e-9 - lead_s
        if early_s > 0.0:
            mover.sleep(early_s)
        due_s = (due_ns - mover.now_ns()) * 1e-9
        if due_s > 0.0:
            mover.send(position, velocity, due=due_s)
            sent += 1
        else:
            late += 1
    return Streamed(sent, late, position)


def knots(rows: Iterable[Row]) -> Iterator[tuple[float, Mapping[str, float], Mapping[str, float]]]:
    """Each row with its velocities, by differences between the rows beside it; 0 at both ends."""
    before: Row | None = None
    for number, (row, after) in enumerate(pairwise(chain(rows, [None])), 1):
        assert row is not None
        if after is not None and (after[0] <= row[0] or after[1].keys() != row[1].keys()):
            raise ValueError(f"row {number + 1}: not later than the row before, or of other axes")
        if before is None or after is None:
            velocity = dict.fromkeys(row[1], 0.0)
        else:
            seconds = after[0] - before[0]
            velocity = {name: (after[1][name] - before[1][name]) / seconds for name in row[1]}
        yield row[0], row[1], velocity
        before = row
