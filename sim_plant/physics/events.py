"""Advances one axis of `Dynamics` (floats) over one piece of constant command.

A piece is divided into equal steps, as many as `Dynamics.effort` asks for. What interrupts a step is located to
rounding, axis by axis, and integration restarts there: where friction is set-valued a stop or a breakaway, and the
puncture of a membrane. An axis with presliding is smooth and is never interrupted by its friction.
"""

from bisect import bisect_left
from collections.abc import Callable
from typing import Final

from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.structure import Motion, Structure

COUNTS = [1, 2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536]
MAX_EVENTS: Final = 8  # of one step
MAX_ITERATIONS: Final = 60


def dynamics_of(structure: Structure, kind: int) -> Dynamics:
    """The axis of floats that has this structure (floats)."""
    return Dynamics(structure, kind)


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
