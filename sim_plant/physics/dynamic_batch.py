"""Many axes of `Dynamics` at a time: steps of dynamics.py on arrays, and one by one where something happens."""

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.events import COUNTS, advance_single, advance_step, dynamics_of
from sim_plant.physics.membrane import Membrane
from sim_plant.physics.structure import Motion, Structure

Array = NDArray[np.float64]

FEW = 8  # axes that are faster one by one than as an array


def take(structure: Structure, index: int) -> Structure:
    """The axis at `index`, of floats."""
    return Structure(*(float(a[index]) if a.ndim == 1 else tuple(a[:, index].tolist()) for a in structure))


def take_many(structure: Structure, index: NDArray[np.int64] | slice) -> Structure:
    """The axes at these indices."""
    return Structure(*(a[..., index] for a in structure))


def part_of(axes: Dynamics, index: NDArray[np.int64] | slice) -> Dynamics:
    """Those of the axes, for stepping alone: what `effort` needs stays as it is."""
    part = copy(axes)
    s = part.structure = take_many(axes.structure, index)
    part.membrane = Membrane(s.surface, s.direction, s.membrane, s.puncture_depth, s.drag)
    for name in _STEPPED:
        setattr(part, name, getattr(axes, name)[index])
    for name in ("lines", "floor", "_varying", "hung"):
        setattr(part, name, [(a[index], b[index], c[index]) for a, b, c in getattr(axes, name)])
    part._lag_h = -1.0
    return part


_STEPPED = (
    "motor_mass", "inverse_mass", "inverse_load", "stiffness", "peak", "inverse_limit", "inverse_lag", "_slowness",
)  # fmt: skip
_COUNTS = np.array(COUNTS)


def advance_dynamic(axes: Dynamics, at: Motion, time: float, forces: tuple[Array, Array], h: float) -> Motion:
    """Many axes after h seconds, each in as many equal steps as it needs.

    The n-th steps of all go together, however long each is. Axes are sorted by how many they need, so that those still
    under way are the first ones of every array.
    """
    chosen = _COUNTS[np.minimum(np.searchsorted(_COUNTS, axes.effort(at, forces, h)), _COUNTS.size - 1)]
    most = int(chosen.max())
    if most == int(chosen.min()):
        return _steps(axes, at, time, forces, h / most, range(most))
    order = np.argsort(-chosen, kind="stable")
    counts, short = chosen[order], h / chosen[order]
    part, moving = part_of(axes, order), Motion(*(array[order] for array in at))
    pushed = forces[0][order], forces[1][order]
    result = Motion(*(np.empty_like(array) for array in at))
    done = 0
    for count in np.unique(counts).tolist():
        left = int(np.searchsorted(-counts, -count, side="right"))  # axes that need at least so many steps
        if left <= FEW:
            break
        if left < counts.size:
            counts, short, order = counts[:left], short[:left], order[:left]
            part, pushed = part_of(part, slice(left)), (pushed[0][:left], pushed[1][:left])
            moving = Motion(*(array[:left] for array in moving))
        moving = _steps(part, moving, time, pushed, short, range(done, count))
        done = count
        ended = counts == count
        for array, values in zip(result, moving, strict=True):
            array[order[ended]] = values[ended]
    for place, index in enumerate(order.tolist()):
        if counts[place] > done:
            alone, state = _alone(axes, at, index)
            force = float(forces[0][index]), float(forces[1][index])
            _put(result, index, advance_single(alone, state, time, force, h))
    return result


def _alone(axes: Dynamics, at: Motion, index: int) -> tuple[Dynamics, Motion]:
    """The axis at `index` and its state, of floats."""
    return dynamics_of(take(axes.structure, index), axes.kind), Motion(*(float(array[index]) for array in at))


def _put(at: Motion, index: int, motion: Motion) -> None:
    for array, value in zip(at, motion, strict=True):
        array[index] = value


def _steps(
    axes: Dynamics, at: Motion, time: float, forces: tuple[Array, Array], short: Array | float, numbers: range
) -> Motion:
    """The steps of these numbers, each `short` s long, of a piece that began at `time`."""
    for number in numbers:
        at = _step_many(axes, at, time + number * short, forces, short)
    return at


def _of(value: Array | float, index: int) -> float:
    return float(value[index]) if isinstance(value, np.ndarray) else value


def _step_many(
    axes: Dynamics, at: Motion, time: Array | float, forces: tuple[Array, Array], h: Array | float
) -> Motion:
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
        pushed = float(forces[0][i]), float(forces[1][i])
        _put(end, i, advance_step(alone, state, _of(time, i), pushed, _of(h, i)))
    return end
