"""What several laws share: the error where the force starts to act, and anti-windup."""

from hil.control.laws.base import LawInputs
from hil.control.number import Number, select


def error(inputs: LawInputs) -> Number:
    """e = q - qd at the start of the force's interval (m), estimated."""
    return inputs.position_estimate - inputs.start.position


def error_rate(inputs: LawInputs) -> Number:
    """de/dt at the start of the force's interval (m/s), estimated."""
    return inputs.velocity_estimate - inputs.start.velocity


def unless_saturated(change: Number, force: Number, limit: Number) -> Number:
    """An integrator's change, zero where it would push a saturated force further out (conditional integration)."""
    outward = (abs(force) >= limit) & (change * force > 0.0)
    return select(outward, 0.0, change)
