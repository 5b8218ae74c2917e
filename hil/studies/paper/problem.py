"""The paper's plant, task, gains and laws in continuous time; the laws themselves are those of hil/control/laws."""

from typing import Any, NamedTuple

import numpy as np

from hil.control.laws import make_law
from hil.control.laws.base import Array, Law, Model
from hil.control.nominal_model import blank_inputs
from hil.rig.schema import LawConfig
from sim_plant.physics.exact_trigonometry import sincos_turns

# Section 4: identified parameters of Dong Sun et al., gains of (35), and the numbers of section 4.2.
MASS = np.array([0.022180, 0.011386])
COULOMB = np.array([1.146, 0.172])
VISCOUS = np.array([-0.04749, 0.04023])
QUADRATIC = np.array([0.00265, -0.001473])
KP = [3000.0, 3500.0]
KD = [20.0, 25.0]
ROBUST = {"alpha": 60.0, "epsilon": 0.001, "beta": 100.0, "rho": 0.3}
DELTA = 0.3  # N, both axes
PI = 3.141592653589793


def paper_model() -> Model:
    """The laws' nominal model; it is the plant itself, except for Delta."""
    return Model(mass=MASS, coulomb=COULOMB, viscous=VISCOUS, quadratic=QUADRATIC, gravity=np.zeros(2))


def paper_law(name: str, gains: dict[str, Any] | None = None) -> Law:
    """A law of hil/control/laws with the paper's gains; force limits are far above anything asked for."""
    config = LawConfig(name=name, gains={"kp": KP, "kd": KD, **(gains or {})})
    return make_law(config, paper_model(), 1e-9, np.full(2, np.inf))


class Setpoint(NamedTuple):
    """q_d (m) and its first two derivatives, each (2,)."""

    position: Array
    velocity: Array
    acceleration: Array


def circle(t: float) -> Setpoint:
    """q_d = [cos(pi t), sin(pi t)] m."""
    sine, cosine = sincos_turns(0.5 * t)
    return Setpoint(
        np.array([cosine, sine]), np.array([-PI * sine, PI * cosine]), np.array([-PI * PI * cosine, -PI * PI * sine])
    )


class ContinuousLaw:
    """A law as the paper writes it: the exact state goes in, at one instant, and the force acts at that instant.

    Several states can be tried at once: position and velocity are (..., 2).
    """

    def __init__(self, law: Law, shape: tuple[int, ...]) -> None:
        self.law = law
        self._inputs = blank_inputs(shape)
        self._inputs.fresh[:] = 1.0
        law.reset(np.zeros(shape), np.zeros(shape))

    @property
    def floors(self) -> int:
        """How often a denominator of the law was held at its floor so far, over all states tried."""
        return self.law.denominator_floors

    def force(self, t: float, position: Array, velocity: Array) -> Array:
        """tau (N), (..., 2); the law's own array, valid until the next call."""
        inputs, target = self._inputs, circle(t)
        inputs.position_estimate = inputs.position = position
        inputs.velocity_estimate = velocity
        for reference in (inputs.sample, inputs.start, inputs.end):
            reference.position, reference.velocity, reference.acceleration = target
        inputs.mean_velocity, inputs.mean_acceleration = target.velocity, target.acceleration
        inputs.mean_sign = np.sign(target.velocity)
        force: Array = self.law.force(inputs)
        return force
