"""Many ideal axes at a time: steps of axis.py on arrays, and one by one where something happens."""

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.axis import ACCURACY, MAX_SUBSTEPS, Axis, AxisValues, State
from sim_plant.physics.single_axis import SingleAxis, axis_of

Array = NDArray[np.float64]

FEW = 16  # axes that are faster one by one than as an array


def take(values: AxisValues, index: int) -> AxisValues:
    """The axis at `index`, of floats."""
    return AxisValues(*(float(array[index]) for array in values))


def take_many(values: AxisValues, index: NDArray[np.int64]) -> AxisValues:
    """The axes at these indices."""
    return AxisValues(*(array[index] for array in values))


def advance_ideal(axis: Axis, state: State, drive: Array, h: float) -> State:
    """As one piece of `SingleAxis.advance`, for an array: axes that need equally many substeps go together."""
    work = axis.effort(state.velocity, drive, h)
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
            for i in index.tolist():
                alone = _alone(axis, state, i)
                alone.advance(1, h, float(drive[i]))
                _put(result, i, alone)
            continue
        part = State(*(array[index] for array in state))
        moved = _repeat(Axis(take_many(axis.values, index)), part, drive[index], h / level, int(level))
        for array, values in zip(result, moved, strict=True):
            array[index] = values
    return result


def _alone(axis: Axis, state: State, index: int) -> SingleAxis:
    position, velocity, pierced = (float(array[index]) for array in state)
    return SingleAxis(axis_of(take(axis.values, index)), position, velocity, pierced)


def _put(state: State, index: int, alone: SingleAxis) -> None:
    state.position[index], state.velocity[index], state.pierced[index] = alone.state


def _repeat(axis: Axis, state: State, drive: Array, h: float, count: int) -> State:
    for _ in range(count):
        state = _substep(axis, state, drive, h)
    return state


def _substep(axis: Axis, state: State, drive: Array, h: float) -> State:
    """`SingleAxis.advance_substep` for an array: smooth axes together, the few with an event one by one."""
    sign = np.sign(state.velocity)
    resting = sign == 0.0
    if resting.any():
        net = axis.net_force(state.position, state.velocity, state.pierced, drive)
        sign = np.where(resting & (np.abs(net) > axis.hold), np.sign(net), sign)
    moving = sign != 0.0
    position, velocity = axis.step(state.position, state.velocity, state.pierced, drive, sign, h)
    event = moving & (velocity * sign <= 0.0)
    if axis.has_cell:
        event |= moving & (axis.membrane.transition(position, state.pierced) >= 0.0)
    result = State(
        np.where(moving, position, state.position), np.where(moving, velocity, state.velocity), state.pierced.copy()
    )
    for index in np.flatnonzero(event).tolist():
        alone = _alone(axis, state, index)
        alone.advance_substep(float(drive[index]), h)
        _put(result, index, alone)
    return result
