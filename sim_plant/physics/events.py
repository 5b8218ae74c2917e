"""Advances axes of `Dynamics` over one piece of constant command: single ones, and many at a time.

A piece is divided into equal steps, as many as `Dynamics.effort` asks for. What interrupts a step is located to
rounding, axis by axis, and integration restarts there: where friction is set-valued a stop or a breakaway, and the
puncture of a membrane. An axis with presliding is smooth and is never interrupted by its friction.
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.structure import Motion, Structure

Array = NDArray[np.float64]

COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536)
FEW = 8  # axes that are faster one by one than as an array
MAX_EVENTS = 8  # of one step
MAX_ITERATIONS = 60


def take(structure: Structure, index: int) -> Structure:
    """The axis at `index`, of floats."""
    return Structure(*(float(a[index]) if a.ndim == 1 else tuple(a[:, index].tolist()) for a in structure))


def take_many(structure: Structure, index: NDArray[np.int64]) -> Structure:
    """The axes at these indices."""
    return Structure(*(a[..., index] for a in structure))


def advance_single(axis: Dynamics, at: Motion, time: float, forces: tuple[float, float], h: float) -> Motion:
    """One axis of floats after h seconds."""
    count = COUNTS[min(bisect_left(COUNTS, axis.effort(at, forces, h)), len(COUNTS) - 1)]
    short = h / count
    smooth = axis.has_bristle and not axis.has_cell
    for index in range(count):
        if smooth:
            at = axis.step(at, time + index * short, forces, 1.0, short)
        else:
            at = advance_step(axis, at, time + index * short, forces, short)
    return at


def advance_step(axis: Dynamics, at: Motion, time: float, forces: tuple[float, float], h: float) -> Motion:
    """One step of one axis of floats, through everything that happens on the way."""
    left = h
    for _ in range(MAX_EVENTS):
        sign = sign_of(axis, at, time, forces)

        def after(tau: float, at: Motion = at, time: float = time, sign: float = sign) -> Motion:
            return axis.step(at, time, forces, sign, tau)

        end = after(left)
        tau = left
        if not axis.has_bristle:
            due = stop_of(axis, sign, time, forces)
            if due(end, left) > 0.0:
                if sign != 0.0 and at.velocity == 0.0:  # it would turn back at once: friction holds it
                    return axis.step(at, time, forces, 0.0, left)
                tau, end = first_instant(due, after, at, left)
                if sign != 0.0:
                    end = end._replace(velocity=0.0)
                    if not axis.has_mode:
                        end = end._replace(load_velocity=0.0)
        if axis.has_cell and axis.transition(end) > 0.0:
            tau, end = first_instant(lambda motion, _: axis.transition(motion), after, at, tau)
            end = end._replace(pierced=1.0 - end.pierced)
        at, time, left = end, time + tau, left - tau
        if left <= 0.0:
            break
    return at


def sign_of(axis: Dynamics, at: Motion, time: float, forces: tuple[float, float]) -> float:
    """Of the branch the next step is on; 0.0: friction holds the motor."""
    if axis.has_bristle:
        return 1.0  # of no meaning there
    if at.velocity != 0.0:
        return 1.0 if at.velocity > 0.0 else -1.0
    net, hold = axis.load_on_motor(at, time, forces)
    return 1.0 if net > hold else -1.0 if net < -hold else 0.0


def stop_of(axis: Dynamics, sign: float, time: float, forces: tuple[float, float]) -> Callable[[Motion, float], float]:
    """Positive once the branch has ended: its speed has changed its sign, or the net force exceeds the friction."""
    if sign != 0.0:
        return lambda motion, _: -sign * motion.velocity

    def excess(motion: Motion, tau: float) -> float:
        net, hold = axis.load_on_motor(motion, time + tau, forces)
        surplus: float = abs(net) - hold
        return surplus

    return excess


def first_instant(
    due: Callable[[Motion, float], float], after: Callable[[float], Motion], start: Motion, latest: float
) -> tuple[float, Motion]:
    """The instant in (0, latest] at which `due` turns positive, to rounding, and the state there; positive at latest.

    Regula falsi in Illinois' variant, and bisection where that is slow; the state is on the positive side.
    """
    low, high = 0.0, latest
    below, found = due(start, 0.0), after(latest)
    above = due(found, latest)
    below = min(below, 0.0)
    for index in range(MAX_ITERATIONS):
        if high - low <= 1e-15 * latest:
            break
        tau = high - (high - low) * (above / (above - below)) if index % 3 < 2 else 0.5 * (low + high)
        if not low < tau < high:
            tau = 0.5 * (low + high)
        motion = after(tau)
        value = due(motion, tau)
        if value > 0.0:
            high, above, found = tau, value, motion
            below *= 0.5
        else:
            low, below = tau, value
            above *= 0.5
    return high, found


def advance_many(axes: Dynamics, at: Motion, time: float, forces: tuple[Array, Array], h: float) -> Motion:
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
                alone = Dynamics(take(axes.structure, i), axes.kind)
                pushed = float(forces[0][i]), float(forces[1][i])
                _put(result, i, advance_single(alone, _pick(at, i), time, pushed, h))
            continue
        part = Dynamics(take_many(axes.structure, index), axes.kind)
        state = Motion(*(array[index] for array in at))
        moved = _steps(part, state, time, (forces[0][index], forces[1][index]), h, COUNTS[level])
        for array, values in zip(result, moved, strict=True):
            array[index] = values
    return result


def _pick(at: Motion, index: int) -> Motion:
    return Motion(*(float(array[index]) for array in at))


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
        alone = Dynamics(take(axes.structure, i), axes.kind)
        _put(end, i, advance_step(alone, _pick(at, i), time, (float(forces[0][i]), float(forces[1][i])), h))
    return end
