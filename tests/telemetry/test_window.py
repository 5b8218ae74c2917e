"""The last second's figures: an error only of what was followed."""

import math

import numpy as np
from numpy.typing import NDArray

from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.window import Window


def ticks(state: State, error: float) -> NDArray[np.void]:
    records = np.zeros(10, RECORD)
    records["state"], records["following_error"] = state, error
    records["task_ns"] = 0
    return records


def largest(*batches: NDArray[np.void]) -> list[float]:
    window, status = Window(20, 2), pb.Status()
    for batch in batches:
        window.add(batch)
    window.fill(status)
    return list(status.max_error)


def test_the_largest_error_is_of_ticks_that_follow_something() -> None:
    assert largest(ticks(State.ACTIVE, -2e-6), ticks(State.FAULT, 3e-3)) == [2e-6, 2e-6]


def test_where_nothing_was_followed_there_is_no_error() -> None:
    found = largest(ticks(State.FAULT, 3e-3), ticks(State.FAULT, 0.0))
    assert len(found) == 2
    assert all(map(math.isnan, found))
