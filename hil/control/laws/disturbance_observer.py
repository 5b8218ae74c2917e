"""PD plus feedforward plus the disturbance of a linear extended-state observer (Gao, Proc. ACC 2003)."""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import DAMPING, STIFFNESS, Feedforward, default_damping, default_stiffness
from hil.control.number import Number, bounded, zeros_like


class DisturbanceObserver(Law):
    """tau = feedforward - Kp e - Kd ė + d, where e, ė, d come from an observer of the error with three equal poles.

    The observer's plant is a double integrator from (force - feedforward - d) to e; its poles lie at 1 / (1 + bandwidth
    T) (Franklin, Powell, Workman, Digital Control (1998), section 8.2). d stays within the force limit.
    """

    own_estimate: ClassVar[bool] = True
    GAINS: ClassVar[dict[str, Gain]] = {
        "kp": STIFFNESS,
        "kd": DAMPING,
        "bandwidth": Gain(None, "rad/s", "of the observer; default: from the rate", tune=Knob(0.05, 1.5, "1/T")),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        kp: Number | None = given["kp"]
        kd: Number | None = given["kd"]
        bandwidth: Number | None = given["bandwidth"]
        self._kp = 0.5 * default_stiffness(model, period) if kp is None else kp
        self._kd = 0.7 * default_damping(model, period) if kd is None else kd
        omega: Number = 0.4 / period if bandwidth is None else bandwidth
        pole = 1.0 / (1.0 + omega * period)
        slow = 1.0 - pole
        self._gain_error = 1.0 - pole * pole * pole
        self._gain_rate = 1.5 * slow * slow * (1.0 + pole) / period
        self._gain_force = -model.mass * (slow * slow * slow) / (period * period)
        self._inverse_mass = 1.0 / model.mass
        self._gravity = model.gravity
        self._limit = force_limit
        self._feedforward = Feedforward(model)
        self.reset(zeros_like(model.mass), model.gravity)

    def reset(self, position: Number, force: Number) -> None:
        """No error; what `force` has beyond the gravity hold counts as disturbance."""
        zero = zeros_like(position)
        self._error, self._rate = zero, zero
        self._disturbance = bounded(zero + (force - self._gravity), self._limit)
        self._known_before = zero + self._gravity  # feedforward that belongs to force_before
        self._known_last = self._known_before

    def _move(self, net: Number, interval: Number) -> tuple[Number, Number]:
        """Error and rate after `interval` s under the net force on the error (N)."""
        change = net * self._inverse_mass * interval
        return self._error + (self._rate + 0.5 * change) * interval, self._rate + change

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        net = inputs.force_before - self._known_before - self._disturbance
        self._error, self._rate = self._move(net, inputs.sample_interval)
        innovation = (inputs.position - inputs.sample.position - self._error) * inputs.fresh
        self._error = self._error + self._gain_error * innovation
        self._rate = self._rate + self._gain_rate * innovation
        self._disturbance = bounded(self._disturbance + self._gain_force * innovation, self._limit)
        net = inputs.force_last - self._known_last - self._disturbance
        ahead, rate = self._move(net, inputs.ahead)
        known = self._feedforward(inputs)
        self._known_before, self._known_last = self._known_last, known
        return known + self._disturbance - self._kp * ahead - self._kd * rate
