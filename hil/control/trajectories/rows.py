"""Timed rows of positions as a path: every axis goes through its rows at their times, and does between them as chosen.

Rules, axis by axis:
- Two equal neighbours are a rest: the axis stands still between them, and begins and ends that with no velocity and no
  acceleration.
- `smooth`: a cubic spline with continuous acceleration between two rests. It may go beyond two neighbouring rows by a
  little; `excursions` says where and how far.
- `blended`: through the rows without stopping, never beyond two neighbouring ones, slower where the way bends.
- `linear`: from row to row at rest in each, minimum jerk in the time between them.
- A path that repeats runs through its end, where it is not at rest there.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from hil.control.trajectories.segments import NS, Row, Segment, Segments, cubic_row, meeting_row, rest

SMOOTH, BLENDED, LINEAR = "smooth", "blended", "linear"
BETWEEN: Final = (SMOOTH, BLENDED, LINEAR)

_Ends = list[tuple[float, float, float]]  # position, velocity and acceleration at every row


def along_rows(
    rows: Sequence[Sequence[float]], between: str = SMOOTH, *, repeat: bool = False, dwell_ns: int = 0
) -> Segments:
    """Through rows of time (s, increasing) and positions (m, one a column), at rest at both ends unless it repeats
    without a rest of `dwell_ns` behind it; then that rest. Rows that repeat have to end where they begin.
    """
    times = [round((row[0] - rows[0][0]) * 1e9) for row in rows]
    lengths = [after - before for before, after in pairwise(times)]
    around = repeat and not dwell_ns
    columns = [_column([row[column] for row in rows], lengths, between, around) for column in range(1, len(rows[0]))]
    parts = [_part(length, [column[index] for column in columns]) for index, length in enumerate(lengths)]
    last = list(rows[-1][1:])
    if dwell_ns:
        parts.append(rest(dwell_ns, last))
    return Segments(parts if repeat else [*parts, rest(0, last)], repeat=repeat, phase_names=("path",))


def _part(length: int, rows: list[Row]) -> Segment:
    return Segment(length, rows, [not any(row[1:6]) for row in rows], 0)


def _column(q: list[float], lengths: list[int], between: str, around: bool) -> list[Row]:
    """A row of coefficients for every interval of one axis."""
    if between == LINEAR:
        ends: _Ends = [(value, 0.0, 0.0) for value in q]
        return _quintics(ends, lengths)
    if between == BLENDED:
        return _quintics(_blended(q, lengths, around), lengths)
    return _smooth(q, lengths, around)


def _quintics(ends: _Ends, lengths: list[int]) -> list[Row]:
    return [
        meeting_row(length * NS, *begin, *end) for length, (begin, end) in zip(lengths, pairwise(ends), strict=True)
    ]


def _blended(q: list[float], lengths: list[int], around: bool) -> _Ends:
    """No velocity where the axis turns or rests, else what both neighbours' mean speeds allow; no acceleration."""
    slopes = [(b - a) / (length * NS) for length, (a, b) in zip(lengths, pairwise(q), strict=True)]
    speeds = [0.0, *[_passing(before, after) for before, after in pairwise(slopes)], 0.0]
    if around:
        speeds[0] = speeds[-1] = _passing(slopes[-1], slopes[0])
    return [(value, speed, 0.0) for value, speed in zip(q, speeds, strict=True)]


def _passing(before: float, after: float) -> float:
    """The harmonic mean of two mean speeds: at most twice the lesser, up to which a quintic without acceleration at its
    ends never turns back.
    """
    return 2.0 * before * after / (before + after) if before * after > 0.0 else 0.0


def _smooth(q: list[float], lengths: list[int], around: bool) -> list[Row]:
    """Splines between the rests; of what repeats the last of them may run on into the first."""
    n = len(lengths)
    rests = [q[i] == q[i + 1] for i in range(n)]
    if around and not any(rests):
        return _closed_spline(q, lengths)
    first = rests.index(True) if around else 0
    order = [(first + i) % n for i in range(n)]
    made: list[Row | None] = [None] * n
    run: list[int] = []
    for index in [*order, -1]:
        if index >= 0 and not rests[index]:
            run.append(index)
            continue
        if run:
            for place, row in zip(run, _open_spline([q[i] for i in run] + [q[run[-1] + 1]], [lengths[i] for i in run]),
                                  strict=True):  # fmt: skip
                made[place] = row
            run = []
        if index >= 0:
            made[index] = cubic_row(lengths[index] * NS, q[index], 0.0, q[index], 0.0)
    return [row for row in made if row is not None]


def _open_spline(q: list[float], lengths: list[int]) -> list[Row]:
    """At rest at both ends, to which the first and the last piece, quintics, lead without a jump of acceleration."""
    speeds = _speeds(q, lengths)
    n = len(lengths)
    ends = [(q[i], speeds[i], _acceleration(q, speeds, lengths, i) if 0 < i < n else 0.0) for i in range(n + 1)]
    rows = []
    for i, length in enumerate(lengths):
        if 0 < i < n - 1:
            rows.append(cubic_row(length * NS, q[i], speeds[i], q[i + 1], speeds[i + 1]))
        else:
            rows.append(meeting_row(length * NS, *ends[i], *ends[i + 1]))
    return rows


def _acceleration(q: list[float], speeds: list[float], lengths: list[int], place: int) -> float:
    h = lengths[place] * NS
    return (6.0 * (q[place + 1] - q[place]) / h - 4.0 * speeds[place] - 2.0 * speeds[place + 1]) / h


def _speeds(q: Sequence[float], lengths: Sequence[int]) -> list[float]:
    """Speeds at the points that make the acceleration continuous, 0 at both ends: a tridiagonal system, solved from the
    first row to the last and back (Thomas), so that every machine computes the same bits.
    """
    inverse = [1e9 / length for length in lengths]
    slopes = [(q[i + 1] - q[i]) * inverse[i] for i in range(len(inverse))]
    rights = [_known(slopes, inverse, i - 1, i) for i in range(1, len(inverse))]
    return [0.0, *_solved(inverse, rights), 0.0]


def _known(slopes: list[float], inverse: list[float], before: int, after: int) -> float:
    return 3.0 * (slopes[before] * inverse[before] + slopes[after] * inverse[after])


def _solved(inverse: list[float], rights: list[float]) -> list[float]:
    """x of: inverse[i] x[i-1] + 2 (inverse[i] + inverse[i+1]) x[i] + inverse[i+1] x[i+1] = rights[i], 0 beyond."""
    upper, right = [0.0], [0.0]
    for i, known in enumerate(rights, 1):
        pivot = 2.0 * (inverse[i - 1] + inverse[i]) - inverse[i - 1] * upper[i - 1]
        upper.append(inverse[i] / pivot)
        right.append((known - inverse[i - 1] * right[i - 1]) / pivot)
    found = [0.0] * (len(rights) + 2)
    for i in range(len(rights), 0, -1):
        found[i] = right[i] - upper[i] * found[i + 1]
    return found[1:-1]


def _closed_spline(q: list[float], lengths: list[int]) -> list[Row]:
    """As smooth where the end meets the beginning as everywhere: the same system with its first speed as a parameter
    (Sherman and Morrison), which the equation of the meeting point then gives.
    """
    inverse = [1e9 / length for length in lengths]
    slopes = [(q[i + 1] - q[i]) * inverse[i] for i in range(len(inverse))]
    n = len(inverse)
    rights = [_known(slopes, inverse, i - 1, i) for i in range(1, n)]
    still = _solved(inverse, rights)
    moving = [0.0] * (n - 1)  # how the others follow a first speed of 1
    if n > 1:
        moving[0] -= inverse[0]
        moving[-1] -= inverse[-1]
        moving = _solved(inverse, moving)
        known = _known(slopes, inverse, n - 1, 0) - inverse[0] * still[0] - inverse[-1] * still[-1]
        pivot = 2.0 * (inverse[0] + inverse[-1]) + inverse[0] * moving[0] + inverse[-1] * moving[-1]
        first = known / pivot
        speeds = [first, *[a + first * b for a, b in zip(still, moving, strict=True)], first]
    else:
        speeds = [0.0, 0.0]
    return [cubic_row(lengths[i] * NS, q[i], speeds[i], q[i + 1], speeds[i + 1]) for i in range(n)]


class Excursion(NamedTuple):
    """How far an axis goes beyond two neighbouring rows. row: of the first of them, from 1. beyond: m. share: of the
    longest step of the axis from a row to the next.
    """

    column: int
    row: int
    beyond: float
    share: float


def excursions(rows: Sequence[Sequence[float]], body: Segments, least: Sequence[float]) -> list[Excursion]:
    """All that are longer than `least`, m by column."""
    found = []
    for column in range(1, len(rows[0])):
        q = [row[column] for row in rows]
        steps = [abs(b - a) for a, b in pairwise(q)]
        longest = max(steps)
        for index, part in enumerate(body.segments[: len(steps)]):
            beyond = _beyond(part, column - 1, q[index], q[index + 1])
            if beyond > least[column - 1]:
                found.append(Excursion(column - 1, index + 1, beyond, beyond / longest if longest else 1.0))
    return found


def _beyond(part: Segment, column: int, begin: float, end: float) -> float:
    """Where the axis turns, if it does."""
    row = part.rows[column]
    low, high = min(begin, end), max(begin, end)
    most, h = 0.0, part.duration_ns * NS
    for t in _turns((row[1], *row[6:10])):
        if 0.0 < t < h:
            place = row[0] + t * (row[1] + t * (row[2] + t * (row[3] + t * (row[4] + t * row[5]))))
            most = max(most, place - high, low - place)
    return most


def _turns(v: tuple[float, float, float, float, float]) -> list[float]:
    """Real zeros of a polynomial of at most the fourth degree, lowest power first."""
    if v[3] == 0.0 and v[4] == 0.0:
        square = v[1] * v[1] - 4.0 * v[2] * v[0]
        if square < 0.0 or (v[1] == 0.0 and v[2] == 0.0):
            return []
        q = -0.5 * (v[1] + math.copysign(math.sqrt(square), v[1]))
        return [q / v[2] if v[2] else 0.0, v[0] / q if q else 0.0]
    roots = np.roots(v[::-1])
    return [float(root.real) for root in roots if abs(root.imag) <= 1e-6 * abs(root)]
