"""Mass, friction, presliding and constant force of an axis, from force = mass x acceleration + friction.

Friction follows the path: a bristle of relaxation length `presliding` (LuGre's, at speeds that its damping does not
change; Canudas de Wit et al., IEEE TAC 40, 1995). For a given length the balance is linear in all else, so the length
alone is searched (variable projection; Golub, Pereyra, SIAM J. Numer. Anal. 10, 1973).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from hil.identify.estimate import WIDEST, Array, Estimate, Refused, damping, jackknife

CORNER_HZ = 28.0  # of the Gaussian filter that all signals pass
PLAY_COUNTS = 1.5  # of the encoder, ahead of the bristle: noise must not relax it
LENGTHS = np.geomspace(0.02e-6, 1e-3, 40)  # m (rad), tried at first
UNEXPLAINED = 0.15  # of the force's RMS, at most
LEAST_COUNTS = 20.0  # of travel
SYSTEMATIC = 0.03  # of the value: what a bristle of one length leaves out, which no block shows
LENGTH_SYSTEMATIC = 0.07  # the same of the bristle's length: the play alone moves it by some per cent
# What ordinary motion leaves open: by how much of Coulomb friction a place is off the travel, and how far the bristle's
# length is off, of it, in quick motion.
PLACE, QUICK = 0.1, 0.45
BLOCKS = 8
EDGE_S = 0.03  # left out at both ends, where the filter has half its data


class Record(NamedTuple):
    """One stretch of a run. force: N, held from each sample to the next, as applied; position: m, at that sample; (n,).
    period: s. resolution: m per encoder count. lag: s, of the force behind its command. skip: samples at the beginning
    that only bring the bristle into a known state.
    """

    force: Array
    position: Array
    period: float
    resolution: float
    lag: float = 0.0
    skip: int = 0


class Balance(NamedTuple):
    """What a balance gave, by quantity; and why it cannot tell the others."""

    found: dict[str, Estimate]
    refused: dict[str, str]
    unexplained: float


def lagged(force: Array, lag: float, period: float) -> Array:
    """Mean force of each period behind a first-order lag, from the commands (n,)."""
    if not lag:
        return force
    keep = float(np.exp(-period / lag))
    reached = lfilter([0.0, 1.0 - keep], [1.0, -keep], force - force[0]) + force[0]  # at each period's beginning
    mean: Array = force + (reached - force) * lag / period * (1.0 - keep)
    return mean


def about_samples(mean: Array) -> Array:
    """Mean force about each sample, from that of the periods before and after it."""
    before = np.concatenate([mean[:1], mean[:-1]])
    about: Array = 0.5 * (mean + before)
    return about


def played(position: Array, play: float) -> Array:
    """The path behind a play of that half width."""
    out = np.empty_like(position)
    now = float(position[0])
    for i, x in enumerate(position.tolist()):
        now = x - play if x > now + play else x + play if x < now - play else now
        out[i] = now
    return out


def bristle(path: Array, length: float) -> Array:
    """Friction over Coulomb friction along a path, from rest: -1 to 1, (n,).

    It goes to the direction's sign exponentially with the way since the last reversal, so only the reversals are
    walked through one by one.
    """
    moved = np.diff(path, prepend=path[0])
    going = np.flatnonzero(moved)
    if not going.size:
        return np.zeros_like(path)
    sign = np.sign(moved[going])
    first = going[np.flatnonzero(np.diff(sign, prepend=0.0))]  # where each stretch of one direction begins
    way = np.cumsum(np.abs(moved))
    begins = np.concatenate([[0.0], way[first[1:] - 1]])
    keeps = np.exp(-np.diff(begins) / length).tolist()
    signs = np.sign(moved[first])
    states, now = [0.0], 0.0
    for keep, direction in zip(keeps, signs.tolist(), strict=False):
        now = direction + (now - direction) * keep
        states.append(now)
    stretch = np.searchsorted(first, np.arange(len(path)), side="right") - 1
    inside = stretch >= 0
    at = np.where(inside, stretch, 0)
    out = signs[at] + (np.array(states)[at] - signs[at]) * np.exp(-(way - begins[at]) / length)
    whole: Array = np.where(inside, out, 0.0)
    return whole


class Balanced:
    """Of one record, filtered alike: what the balance is made of."""

    def __init__(self, record: Record, mass: float | None, viscous: float | None) -> None:
        self.record, self.mass, self.viscous = record, mass, viscous
        self._width = np.sqrt(np.log(2.0)) / (2.0 * np.pi * CORNER_HZ * record.period)
        smooth = self.filtered(record.position)
        self.velocity = np.gradient(smooth, record.period)
        self.acceleration = np.gradient(self.velocity, record.period)
        # A force belongs to the middle of its period.
        self.force = self.filtered(about_samples(lagged(record.force, record.lag, record.period)))
        self.path = played(record.position, PLAY_COUNTS * record.resolution)
        edge = round(EDGE_S / record.period)
        self.inside = slice(max(edge, record.skip), len(record.position) - edge)

    def filtered(self, values: Array) -> Array:
        """Behind the filter that all signals pass."""
        out: Array = gaussian_filter1d(values, self._width, mode="nearest")
        return out

    def columns(self, length: float) -> tuple[Array, Array]:
        """(k, n) regressors and (n,) the force they add up to: Coulomb, constant, the bristle's damping, and viscous
        friction and mass where they are not given.
        """
        state = bristle(self.path, length)
        friction = self.filtered(state)
        rows = [friction, np.ones_like(friction), np.gradient(friction, self.record.period)]
        target = self.force
        for given, row in ((self.viscous, self.velocity), (self.mass, self.acceleration)):
            if given is None:
                rows.append(row)
            else:
                target = target - given * row
        return np.array([row[self.inside] for row in rows]), target[self.inside]


BASE = ("coulomb", "constant", "bristle_damping")
UNITS = {"coulomb": "N", "constant": "N", "viscous": "N s/m", "bristle_damping": "N s", "mass": "kg"}


def _solve(a: Array, b: Array) -> tuple[Array, float]:
    """Least squares with columns of one size; a column without content is 0. Also the squared residual."""
    size = np.sqrt((a * a).mean(axis=1))
    size[size == 0.0] = 1.0
    x, *_ = np.linalg.lstsq((a / size[:, None]).T, b, rcond=1e-10)
    rest = b - x @ (a / size[:, None])
    return x / size, float(rest @ rest)


def _best(parts: Sequence[Balanced], guess: float | None = None) -> tuple[float, Array, float]:
    """Length, the linear quantities, and the residual's share of the force."""

    def met(log_length: float) -> tuple[Array, float, Array]:
        rows = [part.columns(float(np.exp(log_length))) for part in parts]
        a, b = np.concatenate([r[0] for r in rows], axis=1), np.concatenate([r[1] for r in rows])
        return (*_solve(a, b), b)

    if guess is None:
        tried = [met(np.log(length))[1] for length in LENGTHS]
        guess = float(LENGTHS[int(np.argmin(tried))])
    span = np.log(LENGTHS[1] / LENGTHS[0])
    found = minimize_scalar(
        lambda x: met(x)[1],
        bounds=(np.log(guess) - 1.5 * span, np.log(guess) + 1.5 * span),
        method="bounded",
        options={"xatol": 1e-4},
    )
    x, rest, b = met(found.x)
    return float(np.exp(found.x)), x, float(np.sqrt(rest / ((b - b.mean()) ** 2).sum()))


def balance(
    records: Sequence[Record], mass: float | None = None, viscous: float | None = None, *, ordinary: bool = False
) -> Balance:
    """Mass and viscous friction (where not given), Coulomb friction, presliding and constant force, with 95 % intervals
    from a block jackknife: every record is a block, few are cut into BLOCKS. ordinary: motion that no experiment
    planned, at one place, again and again; what that does not show widens the intervals.

    Raises Refused where the axis hardly moved or the model leaves too much of the force unexplained.
    """
    moved = max(float(np.ptp(r.position)) / r.resolution for r in records)
    if moved < LEAST_COUNTS:
        raise Refused(f"not enough motion: {moved:.0f} encoder counts (at least {LEAST_COUNTS:.0f})")
    if not any(np.ptp(r.force) for r in records):
        raise Refused("the force never changed: the drives had none, or it was not recorded")
    parts = [Balanced(record, mass, viscous) for record in records]
    length, x, unexplained = _best(parts)
    if unexplained > UNEXPLAINED:
        raise Refused(
            f"the friction model leaves {100 * unexplained:.0f} % of the force unexplained "
            f"(at most {100 * UNEXPLAINED:.0f} %)"
        )
    blocks = _blocks(parts)
    without = []
    for left_out in range(len(blocks)):
        kept = [part for i, part in enumerate(blocks) if i != left_out]
        each, y, _ = _best(kept, length)
        without.append(np.array([np.log(each), *y]))
    half = jackknife(without)
    if ordinary:
        half = np.hypot(half, _unseen(parts, length, x))
    names = [*BASE, *(name for name, given in (("viscous", viscous), ("mass", mass)) if given is None)]
    return Balance(*_told(names, np.array([np.log(length), *x]), half, records[0].resolution), unexplained)


def _unseen(parts: Sequence[Balanced], length: float, x: Array) -> Array:
    """What repeated motion at one place leaves open, of log length and each quantity: the force that is left may all be
    of one quantity, and friction and force are those of the place.
    """
    rows = [part.columns(length) for part in parts]
    a, b = np.concatenate([r[0] for r in rows], axis=1), np.concatenate([r[1] for r in rows])
    size = np.sqrt((a * a).mean(axis=1))
    size[size == 0.0] = 1.0
    spread = np.sqrt(np.diag(np.linalg.pinv((a / size[:, None]) @ (a / size[:, None]).T / b.size))) / size
    half = spread * float(np.sqrt(((b - x @ a) ** 2).mean()))
    place = np.zeros(half.size)
    place[: len(BASE) - 1] = 1.0
    if parts[0].viscous is None:
        place[len(BASE)] = 1.0 / size[len(BASE)]
    return np.concatenate([[QUICK], np.hypot(half, PLACE * x[0] * place)])


def _blocks(parts: Sequence[Balanced]) -> list[Balanced]:
    """One record cut into blocks, the filtered signals kept; several are blocks themselves."""
    if len(parts) >= BLOCKS:
        return list(parts)
    out: list[Balanced] = []
    each = -(-BLOCKS // len(parts))
    for part in parts:
        inside = part.inside
        marks = np.linspace(inside.start, inside.stop, each + 1).astype(int)
        for first, last in pairwise(marks.tolist()):
            piece = object.__new__(Balanced)
            piece.__dict__.update(part.__dict__)
            piece.inside = slice(first, last)
            out.append(piece)
    return out


def _told(names: Sequence[str], x: Array, half: Array, count: float) -> tuple[dict[str, Estimate], dict[str, str]]:
    """The estimates that the data bear, and why not the others. x, half: log of the length, then by `names`."""
    found, refused = {}, {}
    length, wide = float(np.exp(x[0])), min(float(np.hypot(half[0], LENGTH_SYSTEMATIC)), 3.0)
    if not LENGTHS[1] < length < LENGTHS[-2]:
        refused["presliding"] = f"at the bound of the search: {length:.2g} m"
    elif length < 2.0 * PLAY_COUNTS * count:
        refused["presliding"] = f"{length:.2g} m is below what the encoder resolves ({2 * PLAY_COUNTS * count:.2g} m)"
    elif wide > WIDEST:
        refused["presliding"] = f"half width {100 * wide:.0f} % of the value (at most {100 * WIDEST:.0f} %)"
    else:
        found["presliding"] = Estimate(length, length * wide, "m")
    for name, value, width in zip(names, x[1:].tolist(), half[1:].tolist(), strict=True):
        width = float(np.hypot(width, SYSTEMATIC * abs(value) if name in ("mass", "coulomb") else 0.0))
        positive, share = name in ("mass", "coulomb"), name != "constant" and name != "bristle_damping"
        if (positive and value <= 0.0) or (share and width >= WIDEST * abs(value)):
            refused[name] = (
                f"{value:.3g} +- {width:.2g} {UNITS[name]}: not enough motion (at most {100 * WIDEST:.0f} %)"
            )
            continue
        one = Estimate(value, width, UNITS[name])
        try:
            found[name] = damping(one) if name == "viscous" else one
        except Refused as negative:
            refused[name] = negative.reason
    return found, refused
