"""The one signature of all control laws.

Timing (DESIGN.md, The tick): a sample taken at s_k is seen at tick k+1; the force computed there acts from a_{k+1} (the
expected reception of tick k+1's command, about one period after s_k) for one period. Laws see both instants.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(slots=True)
class Reference:
    """Setpoints at given instants, each array (..., n_axes): m, m/s, m/s^2 (rad for rotary axes)."""

    position: Array
    velocity: Array
    acceleration: Array


@dataclass(slots=True)
class Model:
    """Nominal belief about the plant, each array (..., n_axes): kg, N, N s/m, N s^2/m^2, N.

    Friction force: coulomb*sgn(v) + viscous*v + quadratic*v*|v|; `gravity` is the constant force the actuator must
    supply to hold the axis.
    """

    mass: Array
    coulomb: Array
    viscous: Array
    quadratic: Array
    gravity: Array


@dataclass(slots=True)
class LawInputs:
    """All a law may look at in one tick; arrays (..., n_axes), preallocated and reused: copy what you keep.

    position: newest sample (as measured, m). fresh: 1.0 where a trusted sample came this tick, else 0.0; where none
    came, `position` is the rig filter's prediction for the instant the sample should have had, and nothing must be
    learnt from it.
    sample: reference at the samples' own time stamps (or that instant).
    sample_interval: s from the previous sample instant to this one, by their stamps (one period where none came).
    ahead: s from the sample instant to the start of the interval in which the force asked for now will act.
    position_estimate, velocity_estimate, disturbance_estimate: the rig's Kalman filter, predicted to that start (m,
    m/s, N).
    start: reference at that start. end: reference at that interval's end.
    mean_velocity, mean_acceleration, mean_sign: reference averaged over that interval (mean_sign: of sgn(velocity)).
    force_last: force the gate let out in the previous tick; acts between the sample and `start` (N).
    force_before: force let out the tick before that; it acted in the interval ending at the sample (N).
    task_ns: task time at which the interval starts (ns since the trajectory's origin, first axis; below 0: no task
    runs); laws that learn over repeats need it.
    """

    position: Array
    fresh: Array
    sample: Reference
    sample_interval: Array
    ahead: Array
    position_estimate: Array
    velocity_estimate: Array
    disturbance_estimate: Array
    start: Reference
    end: Reference
    mean_velocity: Array
    mean_acceleration: Array
    mean_sign: Array
    force_last: Array
    force_before: Array
    task_ns: int = 0


class Law(ABC):
    """A control law: asks for force, decides nothing about safety (the gate does).

    Gains arrive as keyword arguments, each a float or an array (..., n_axes); the class attribute `GAINS` names them
    with their defaults. Batched and single use give bit-identical results: only element-wise IEEE operations (+ - * /
    sqrt, minimum, maximum, where, abs, sign, rint), no BLAS, no transcendental function, no reduction whose order
    depends on memory layout.
    """

    name: str
    GAINS: ClassVar[dict[str, Any]]

    @abstractmethod
    def __init__(self, model: Model, period: float, force_limit: Array, **gains: Any) -> None: ...

    @abstractmethod
    def reset(self, position: Array, force: Array) -> None:
        """Bumpless start at rest at `position` (m) with `force` (N) now applied: integrators and estimates restart."""

    @abstractmethod
    def force(self, inputs: LawInputs) -> Array:
        """Force asked for, (..., n_axes), N; the returned array is the law's own and valid until the next call."""
