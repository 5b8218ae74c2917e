"""What several laws share: the error where the force starts to act, bounds, and anti-windup."""

import numpy as np

from hil.laws.base import Array, LawInputs


def error(inputs: LawInputs) -> Array:
    """e = q - qd at the start of the force's interval (m), estimated."""
    return inputs.position_estimate - inputs.start.position


def error_rate(inputs: LawInputs) -> Array:
    """de/dt at the start of the force's interval (m/s), estimated."""
    return inputs.velocity_estimate - inputs.start.velocity


def bounded(value: Array, bound: Array | float) -> Array:
    """value limited to [-bound, bound]."""
    return np.minimum(np.maximum(value, -bound), bound)


def unless_saturated(change: Array, force: Array, limit: Array) -> Array:
    """An integrator's change, zero where it would push a saturated force further out (conditional integration)."""
    outward = (np.abs(force) >= limit) & (change * force > 0.0)
    return np.where(outward, 0.0, change)
