"""Many ideal axes at a time: the formulas of axis.py on arrays, and one by one where something happens."""

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.axis import (
    ACCURACY,
    MAX_SUBSTEPS,
    Axis,
    State,
    advance_piece,
    effort,
    net_force,
    runge_kutta,
    take,
)
from sim_plant.physics.axis_floats import SingleAxis
from sim_plant.physics.exact_trigonometry import sin_turns
from sim_plant.physics.friction import breakaway
from sim_plant.physics.membrane import transition

Array = NDArray[np.float64]

FEW = 16  # axes that are faster one by one than as an array


def single(axis: Axis) -> Axis:
    """One axis, told which of the optional terms it has itself."""
    return axis._replace(
        sine=sin_turns,
        has_stribeck=axis.friction.stribeck != 0.0,
        has_ripple=axis.ripple_amplitude != 0.0,
        has_cell=axis.membrane.stiffness != 0.0 or axis.membrane.drag != 0.0,
    )


def advance_ideal(axis: Axis, state: State, drive: Array, h: float) -> State:
    """As one piece of `SingleAxis.advance`, for an array: axes that need equally many substeps go together."""
    work = effort(axis, state.velocity, drive, h)
    count = np.ones(work.shape)
    while np.any(short := (count * ACCURACY < work) & (count < MAX_SUBSTEPS)):
        count[short] *= 2
    levels = np.unique(count)
    if levels.size == 1:
        return _repeat(axis, state, drive, h / float(levels[0]), int(levels[0]))
    result = State(*(array.copy() for array in state))
    for level in levels.tolist():
        index = np.flatnonzero(count == level)
        if index.size <= FEW:
            _advance_few(axis, result, drive, h, index.tolist())
            continue
        part = State(*(array[index] for array in state))
        moved = _repeat(take(axis, index), part, drive[index], h / level, int(level))
        for array, values in zip(result, moved, strict=True):
            array[index] = values
    return result


def _advance_few(axis: Axis, state: State, drive: Array, h: float, indices: list[int]) -> None:
    """Advance these of the axes, in place."""
    for index in indices:
        alone = SingleAxis(single(take(axis, index)), *(float(array[index]) for array in state))
        alone.advance(1, h, float(drive[index]))
        state.position[index], state.velocity[index], state.pierced[index] = alone.state


def _repeat(axis: Axis, state: State, drive: Array, h: float, count: int) -> State:
    for _ in range(count):
        state = _piece_many(axis, state, drive, h)
    return state


def _piece_many(axis: Axis, state: State, drive: Array, h: float) -> State:
    """`advance_piece` for an array: smooth axes together, the few with an event one by one."""
    sign = np.sign(state.velocity)
    resting = sign == 0.0
    if resting.any():
        net = net_force(axis, *state, drive)
        sign = np.where(resting & (np.abs(net) > breakaway(axis.friction)), np.sign(net), sign)
    moving = sign != 0.0
    position, velocity = runge_kutta(axis, state, drive, sign, h)
    event = moving & (velocity * sign <= 0.0)
    if axis.has_cell:
        event |= moving & (transition(axis.membrane, position, state.pierced) >= 0.0)
    result = State(
        np.where(moving, position, state.position), np.where(moving, velocity, state.velocity), state.pierced.copy()
    )
    for index in np.flatnonzero(event).tolist():
        alone = State(*(float(array[index]) for array in state))
        outcome = advance_piece(single(take(axis, index)), alone, float(drive[index]), h)
        for array, value in zip(result, outcome, strict=True):
            array[index] = value
    return result
