"""Model feedforward shared by the laws: M q_dd + N(q_d) q_d of eq. (15), averaged over the interval it acts in."""

from hil.control.laws.base import LawInputs, Model
from hil.control.number import Number

DEFAULT_BANDWIDTH = 0.25  # rad per period: natural frequency of a PD loop that is well damped under one period of delay
DEFAULT_DAMPING = 0.7


def default_stiffness(model: Model, period: float) -> Number:
    """Kp (N/m) that gives a delayed PD loop a safe bandwidth at this rate."""
    omega = DEFAULT_BANDWIDTH / period
    return model.mass * (omega * omega)


def default_damping(model: Model, period: float) -> Number:
    """Kd (N s/m) that goes with default_stiffness."""
    return model.mass * (2.0 * DEFAULT_DAMPING * DEFAULT_BANDWIDTH / period)


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
