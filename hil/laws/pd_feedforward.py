"""PD plus feedforward: eq. (15) of Xu, Cai, Zou (2013)."""

from typing import Any, ClassVar

import numpy as np

from hil.laws.base import Array, Law, LawInputs, Model
from hil.laws.feedforward import Feedforward, default_damping, default_stiffness


class PdFeedforward(Law):
    """tau = -Kp e - Kd ė + M q̈d + N(q̇d) q̇d, with e = q - qd (eq. (15)).

    e and ė are taken where the force starts to act (Kalman estimate less reference, both at that instant). kp: N/m; kd:
    N s/m; None: from mass and rate. A constant disturbance D leaves the plateau e = D / Kp.
    """

    name = "pd-feedforward"
    GAINS: ClassVar[dict[str, Any]] = {"kp": None, "kd": None}

    def __init__(
        self, model: Model, period: float, force_limit: Array, *, kp: Array | None = None, kd: Array | None = None
    ) -> None:
        self._kp = default_stiffness(model, period) if kp is None else kp
        self._kd = default_damping(model, period) if kd is None else kd
        self._feedforward = Feedforward(model)
        self.reset(np.zeros_like(model.mass), np.zeros_like(model.mass))

    def reset(self, position: Array, force: Array) -> None:
        """It remembers nothing; only the batch's shape is taken."""
        self._force = np.zeros(position.shape)
        self._scratch = np.zeros(position.shape)

    def force(self, inputs: LawInputs) -> Array:
        """Eq. (15)."""
        out, scratch = self._force, self._scratch
        np.subtract(inputs.start.position, inputs.position_estimate, out)
        np.multiply(out, self._kp, out)
        np.subtract(inputs.start.velocity, inputs.velocity_estimate, scratch)
        np.multiply(scratch, self._kd, scratch)
        np.add(out, scratch, out)
        np.add(out, self._feedforward(inputs), out=out)
        return out
