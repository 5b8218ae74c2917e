"""Moreau's time stepping for m dv = F(t, q, v) dt - c Sgn(v) dt: the sign is part of the unknown, not of the past.

Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems (2008), chapter 10, with theta = 1/2 for the
smooth forces and the friction impulse fully implicit: over a step h

    m (v1 - v0) = h F(t + h/2, q_half, v_half) - h c lambda,   lambda in Sgn(v1),   q1 = q0 + h (v0 + v1) / 2

with v_half = (v0 + v1) / 2 and q_half = q0 + h (3 v0 + v1) / 8. An axis sticks (v1 = 0) exactly when some |lambda| <= 1
holds it; nothing is regularised and nothing chatters. The equation is solved by Newton's method on F with its slopes
taken from the law itself: the law is evaluated at three states in one call.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hil.control.laws.base import Array
from hil.studies.paper.problem import MASS, QUADRATIC, VISCOUS, ContinuousLaw, circle

PROBE_SPEED = 1e-6  # m/s, and
PROBE_POSITION = 1e-9  # m: steps of the difference quotients
MAX_ITERATIONS = 30
RESIDUAL = 1e-13  # m/s


class Trace(NamedTuple):
    """A run, sampled every `stride` steps: time (n,), position, error (m) and force (N), each (n, 2).

    Over every step from `steady_from` on: peak_error, rms_error (m), peak_force (N), each (2,). Over the whole run:
    transient_force (N), (2,); and how many steps asked for more than `force_limit`, had the law's denominator at its
    floor, or did not converge.
    """

    time: Array
    position: Array
    error: Array
    force: Array
    peak_error: Array
    rms_error: Array
    peak_force: Array
    transient_force: Array
    saturations: int
    floors: int
    unsolved: int


class Plan(NamedTuple):
    """What to run: step, duration, start of the steady window (s), sampling stride (steps), force limit to count by."""

    h: float
    duration: float
    steady_from: float
    stride: int
    force_limit: float


def integrate(
    law: ContinuousLaw, coulomb: Array, plan: Plan, start: Array, progress: Callable[[float], None] | None = None
) -> Trace:
    """Run the closed loop from rest at `start` (m, (2,)); law takes shape (3, 2). coulomb: N, (2,)."""
    h, stride = plan.h, plan.stride
    steps, first_steady = round(plan.duration / h), round(plan.steady_from / h)
    kept = steps // stride
    time, position, error, force = np.empty(kept), np.empty((kept, 2)), np.empty((kept, 2)), np.empty((kept, 2))
    peak, squares, peak_force, transient = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    saturations = floors = unsolved = 0
    at = _State(start.copy(), np.zeros(2), np.zeros(2), np.zeros(2), True, False)
    for step in range(steps):
        at = _step(law, coulomb, h, (step + 0.5) * h, at)
        e = at.position - circle((step + 1) * h).position
        asked = np.abs(at.force)
        unsolved += not at.solved
        floors += at.floored
        saturations += bool(asked.max() > plan.force_limit)
        np.maximum(transient, asked, out=transient)
        if step >= first_steady:
            np.maximum(peak, np.abs(e), out=peak)
            np.maximum(peak_force, asked, out=peak_force)
            squares += e * e
        if (step + 1) % stride == 0:
            row = step // stride
            time[row], position[row], error[row], force[row] = (step + 1) * h, at.position, e, at.force
            if progress and row % 100 == 0:
                progress(step / steps)
    rms = np.sqrt(squares / (steps - first_steady))
    return Trace(time, position, error, force, peak, rms, peak_force, transient, saturations, floors, unsolved)


class _State(NamedTuple):
    position: Array
    velocity: Array
    rate: Array  # acceleration over the last step: the next one's first guess
    force: Array
    solved: bool
    floored: bool


def _step(law: ContinuousLaw, coulomb: Array, h: float, t_half: float, at: _State) -> _State:
    """The state one step later; the law acts at t_half."""
    q, v = at.position, at.velocity
    end = v + h * at.rate
    probe_q, probe_v = np.empty((3, 2)), np.empty((3, 2))
    scale = h / MASS
    solved = False
    for _ in range(MAX_ITERATIONS):
        v_half = 0.5 * (v + end)
        probe_q[:] = q + (0.125 * h) * (3.0 * v + end)
        probe_v[:] = v_half
        probe_v[1] += PROBE_SPEED
        probe_q[2] += PROBE_POSITION
        floors = law.floors
        tau = law.force(t_half, probe_q, probe_v)
        force = tau[0]
        smooth = force - v_half * (VISCOUS + QUADRATIC * np.abs(v_half))
        slope_v = (tau[1] - force) / PROBE_SPEED - VISCOUS - 2.0 * QUADRATIC * np.abs(v_half)
        slope_q = (tau[2] - force) / PROBE_POSITION
        stiffness = np.maximum(1.0 - scale * (0.5 * slope_v + (0.125 * h) * slope_q), 0.5)
        free = end - (end - v - scale * smooth) / stiffness
        following = np.sign(free) * np.maximum(np.abs(free) - scale * coulomb / stiffness, 0.0)
        change = np.abs(following - end).max()
        end = following
        if change <= RESIDUAL * (1.0 + np.abs(end).max()):
            solved = True
            break
    return _State(q + (0.5 * h) * (v + end), end, (end - v) / h, force.copy(), solved, law.floors > floors)
