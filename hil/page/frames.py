"""The page's binary messages: little-endian float64 alone, so that a browser reads them where they lie.

    every message   HEADER numbers: kind, signals, first and last instant (s of the run), ticks, lost, state, fault,
                    motion, age of the newest tick (s), fate of the control process, age of the sidecar's word (s)
    PULSE           nothing more: no tick has come
    ENVELOPE        the newest value of every signal, the least of each, the largest of each
    TICKS           the numbers of the signals, the instant of every tick, then each signal's values

What does not exist is NaN: a setpoint that nobody follows, the age of what never was.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

HEADER: Final = 12


class Message(IntEnum):
    """Kinds of messages."""

    PULSE = 0
    ENVELOPE = 1
    TICKS = 2


class Fate(IntEnum):
    """What is known of the control process."""

    NONE = 0
    ALIVE = 1
    ENDED = 2  # it said so
    KILLED = 3


class Pulse(NamedTuple):
    """What every message says. state, fault, motion: numbers of the newest tick; -1: none. tick_age, word_age: s."""

    state: int
    fault: int
    motion: int
    tick_age: float
    fate: Fate
    word_age: float


class Block(NamedTuple):
    """Ticks of one turn. instants: (ticks,), s of the run. values: (signals, ticks). lost: ticks that were not read."""

    instants: NDArray[np.float64]
    values: NDArray[np.float64]
    lost: int


def _message(kind: Message, pulse: Pulse, block: Block | None, parts: Sequence[NDArray[np.float64]]) -> bytes:
    instants = block.instants if block else np.empty(0)
    first, last = (float(instants[0]), float(instants[-1])) if len(instants) else (np.nan, np.nan)
    signals, lost = (len(block.values), block.lost) if block else (0, 0)
    head = [kind, signals, first, last, len(instants), lost, *pulse]
    return np.concatenate([np.array(head, float), *parts]).astype("<f8", copy=False).tobytes()


def pulse_message(pulse: Pulse) -> bytes:
    """Nothing but what is alive."""
    return _message(Message.PULSE, pulse, None, ())


def envelope(pulse: Pulse, block: Block) -> bytes:
    """Newest, least and largest value of every signal. block: at least one tick."""
    values = block.values
    return _message(
        Message.ENVELOPE,
        pulse,
        block,
        (values[:, -1], np.fmin.reduce(values, axis=1), np.fmax.reduce(values, axis=1)),
    )


def ticks(pulse: Pulse, block: Block, chosen: Sequence[int]) -> bytes:
    """Every tick of the chosen signals. chosen: places in block.values, each below its length."""
    picked = Block(block.instants, block.values[list(chosen)], block.lost)
    return _message(Message.TICKS, pulse, picked, (np.array(chosen, float), block.instants, picked.values.ravel()))
