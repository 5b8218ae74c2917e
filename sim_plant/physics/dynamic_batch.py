"""Many axes of `Dynamics` at a time: steps of dynamics.py on arrays, and one by one where something happens."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.events import COUNTS, advance_single, advance_step, dynamics_of
from sim_plant.physics.structure import Motion, Structure

Array = NDArray[np.float64]

FEW = 8  # axes that are faster one by one than as an array


def take(structure: Structure, index: int) -> Structure:
    """The axis at `index`, of floats."""
    return Structure(*(float(a[index]) if a.ndim == 1 else tuple(a[:, index].tolist()) for a in structure))


def take_many(structure: Structure, index: NDArray[np.int64]) -> Structure:
    """The axes at these indices."""
    return Structure(*(a[..., index] for a in structure))


def advance_dynamic(axes: Dynamics, at: Motion, time: float, forces: tuple[Array, Array], h: float) -> Motion:
    """Many axes after h seconds: those that need equally many steps go together."""
    counts = np.array(COUNTS)
    chosen = np.minimum(np.searchsorted(counts, axes.effort(at, forces, h)), counts.size - 1)
    levels = np.unique(chosen)
    if levels.size == 1:
        return _steps(axes, at, time, forces, h, COUNTS[int(levels[0])])
    result = Motion(*(array.copy() for array in at))
    for level in levels.tolist():
        index = np.flatnonzero(chosen == level)
        if index.size <= FEW:
            for i in index.tolist():
                alone, state = _alone(axes, at, i)
                pushed = float(forces[0][i]), float(forces[1][i])
                _put(result, i, advance_single(alone, state, time, pushed, h))
            continue
        part = Dynamics(take_many(axes.structure, index), axes.kind)
        together = Motion(*(array[index] for array in at))
        moved = _steps(part, together, time, (forces[0][index], forces[1][index]), h, COUNTS[level])
        for array, values in zip(result, moved, strict=True):
            array[index] = values
    return result


def _alone(axes: Dynamics, at: Motion, index: int) -> tuple[Dynamics, Motion]:
    """The axis at `index` and its state, of floats."""
    return dynamics_of(take(axes.structure, index), axes.kind), Motion(*(float(array[index]) for array in at))


def _put(at: Motion, index: int, motion: Motion) -> None:
    for array, value in zip(at, motion, strict=True):
        array[index] = value


def _steps(axes: Dynamics, at: Motion, time: float, forces: tuple[Array, Array], h: float, count: int) -> Motion:
    short = h / count
    for index in range(count):
        at = _step_many(axes, at, time + index * short, forces, short)
    return at


def _step_many(axes: Dynamics, at: Motion, time: float, forces: tuple[Array, Array], h: float) -> Motion:
    """`advance_step` for an array: smooth axes together, the few with an event one by one."""
    if axes.has_bristle and not axes.has_cell:
        return axes.step(at, time, forces, np.ones(at.position.shape), h)
    sign = np.sign(at.velocity)
    if not axes.has_bristle and (resting := sign == 0.0).any():
        net, hold = axes.load_on_motor(at, time, forces)
        sign = np.where(resting & (np.abs(net) > hold), np.sign(net), sign)
    end = axes.step(at, time, forces, sign, h)
    event = np.zeros(sign.shape, dtype=bool)
    if not axes.has_bristle:
        event |= (sign != 0.0) & (end.velocity * sign < 0.0)
        net, hold = axes.load_on_motor(end, time + h, forces)
        event |= (sign == 0.0) & (np.abs(net) > hold)
    if axes.has_cell:
        event |= axes.transition(end) > 0.0
    indices: Sequence[int] = np.flatnonzero(event).tolist()
    if indices:
        end = Motion(*(np.array(array) for array in end))
    for i in indices:
        alone, state = _alone(axes, at, i)
        _put(end, i, advance_step(alone, state, time, (float(forces[0][i]), float(forces[1][i])), h))
    return end
