"""What several laws share: default gains of a PD loop, the tracking error where the force starts to act, anti-windup,
and the model feedforward M q_dd + N(q_d) q_d of eq. (15), averaged over the interval it acts in.
"""

from hil.control.gain import Gain, Knob
from hil.control.laws.base import LawInputs, Model
from hil.control.number import Number, select

DEFAULT_BANDWIDTH = 0.25  # rad per period: natural frequency of a PD loop that is well damped under one period of delay
DEFAULT_DAMPING = 0.7

# Gains of a PD loop, as most laws declare them.
STIFFNESS = Gain(None, "N/m", "stiffness; default: from mass and rate", tune=Knob(0.01, 0.2, "m/T2"))
DAMPING = Gain(None, "N s/m", "damping; default: from mass and rate", tune=Knob(0.1, 0.9, "m/T"))


def default_stiffness(model: Model, period: float) -> Number:
    """Kp (N/m) that gives a delayed PD loop a safe bandwidth at this rate."""
    omega = DEFAULT_BANDWIDTH / period
    return model.mass * (omega * omega)


def default_damping(model: Model, period: float) -> Number:
    """Kd (N s/m) that goes with default_stiffness."""
    return model.mass * (2.0 * DEFAULT_DAMPING * DEFAULT_BANDWIDTH / period)


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


class Feedforward:
    """Inertia, friction and gravity along the reference (N).

    Coulomb friction switches on the reference's mean sign, never on the measured speed. Averages, not instants: a force
    held over an interval in which the reference reverses must equal the mean of the force needed.
    """

    def __init__(self, model: Model) -> None:
        self._model = model

    def __call__(self, inputs: LawInputs) -> Number:
        """Mean force over the interval."""
        model, v = self._model, inputs.mean_velocity
        moving = model.mass * inputs.mean_acceleration + model.coulomb * inputs.mean_sign + model.viscous * v
        return moving + model.quadratic * (v * abs(v)) + model.gravity
