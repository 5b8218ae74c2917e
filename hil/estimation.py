"""The rig's Kalman filter: position, velocity and disturbance force of every axis, from one sample per period.

Model per axis: mass * acceleration = input - disturbance, where the input is the force let out less the nominal
friction at the setpoint's velocity. The gains are filterpy's (hil/estimation_design.py), constant; a test holds the two
filters equal. Arrays have shape (..., n_axes); only exact element-wise operations, so a batch gives the same bits as
its members one by one.
"""

import json
import subprocess
import sys
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.config import RigConfig

Array = NDArray[np.float64]


def per_axis(value: Any, n: int) -> Array:
    """A scalar or list from the rig file as an array (n_axes,)."""
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)))


def filter_parameters(rig: RigConfig) -> list[dict[str, float]]:
    """Per axis, what estimation_design.make_filter needs. The noise of a sample is a count's quantisation, floored."""
    n = len(rig.axes)
    disturbance = per_axis(rig.estimator.disturbance_noise, n).tolist()
    acceleration = per_axis(rig.estimator.acceleration_noise, n).tolist()
    floor = rig.estimator.measurement_floor
    return [
        {
            "mass": axis.model.mass,
            "period": rig.period_ns * 1e-9,
            "disturbance_noise": disturbance[i],
            "acceleration_noise": acceleration[i],
            "sigma": max(axis.encoder_resolution / 12**0.5, floor),
        }
        for i, axis in enumerate(rig.axes.values())
    ]


_NO_GAINS = "[estimator] and axes.*.model.mass: no steady Kalman filter for these: "


@lru_cache(maxsize=64)
def _design_in_child(parameters: str) -> list[Any]:
    if "filterpy" in sys.modules:
        from hil.estimation_design import design

        try:
            return design(json.loads(parameters))
        except (ArithmeticError, ValueError) as error:
            raise ValueError(_NO_GAINS + str(error)) from None
    child = subprocess.run(
        [sys.executable, "-m", "hil.estimation_design"], input=parameters, capture_output=True, text=True, check=False
    )
    if child.returncode != 0:
        raise ValueError(_NO_GAINS + "".join(child.stderr.strip().splitlines()[-1:]))
    return list(json.loads(child.stdout))


def design_gains(rig: RigConfig) -> tuple[Array, Array]:
    """filterpy's steady-state gains, (3, n_axes), and innovation variances, (n_axes,), m^2.

    Raises ValueError where the rig's masses and noises have none.
    """
    result = _design_in_child(json.dumps(filter_parameters(rig)))
    gains = np.array([gain for gain, _ in result]).T.copy()
    variance = np.array([variance for _, variance in result])
    if not (np.isfinite(gains).all() and np.isfinite(variance).all() and (variance > 0.0).all()):
        raise ValueError(_NO_GAINS + f"gains {gains.tolist()}, innovation variances {variance.tolist()}")
    return gains, variance


class MotionFilter:
    """Constant-gain Kalman filter; `position`, `velocity`, `disturbance` are its state at the latest sample's time.

    `ahead_position` and `ahead_velocity` are the same predicted to the start of the interval in which the next force
    will act.
    """

    def __init__(self, gains: Array, innovation_variance: Array, mass: Array, shape: tuple[int, ...]) -> None:
        self._gains = gains.reshape((3,) + (1,) * (len(shape) - 1) + shape[-1:])
        self.innovation_variance = innovation_variance
        self._inverse_mass = 1.0 / mass
        self._state: Array = np.zeros((3, *shape))
        self.position, self.velocity, self.disturbance = self._state
        self._correction: Array = np.zeros((3, *shape))
        self.innovation: Array = np.zeros(shape)
        self.ahead_position: Array = np.zeros(shape)
        self.ahead_velocity: Array = np.zeros(shape)
        self._acceleration: Array = np.zeros(shape)
        self._scratch: Array = np.zeros(shape)

    def reseed(self, position: Array) -> None:
        """At rest at `position`, without disturbance."""
        self.position[...] = position
        self.ahead_position[...] = position
        for array in (self.velocity, self.disturbance, self.innovation, self.ahead_velocity):
            array[...] = 0.0

    def predict(self, force: Array, interval: Array) -> None:
        """Move the state `interval` s forward under a constant input `force` (N)."""
        self._move(self.position, self.velocity, force, interval, self.position, self.velocity)

    def innovate(self, measured: Array) -> Array:
        """Innovation of the samples (m): measured less predicted position. The state does not change yet."""
        np.subtract(measured, self.position, out=self.innovation)
        return self.innovation

    def update(self, fresh: Array | None, stretch: Array | None = None) -> None:
        """Correct the state by the innovation; `fresh` 1.0/0.0 per axis leaves axes without a trusted sample alone.

        stretch: interval since the last sample over the period the gains were designed for, where it is far from 1. The
        velocity's gain is then divided by it and the disturbance's by its square, as for an alpha-beta-gamma filter:
        left as they are, they would make the filter run away.
        """
        innovation = self.innovation
        if fresh is not None:
            np.multiply(innovation, fresh, out=innovation)
        np.multiply(self._gains, innovation, out=self._correction)
        if stretch is not None:
            self._correction[1] /= stretch
            self._correction[2] /= stretch * stretch
        np.add(self._state, self._correction, out=self._state)

    def look_ahead(self, force: Array, ahead: Array) -> None:
        """Compensate the period between sample and force: predict `ahead` s under `force` (N), into ahead_*."""
        self._move(self.position, self.velocity, force, ahead, self.ahead_position, self.ahead_velocity)

    def _move(
        self, position: Array, velocity: Array, force: Array, time: Array, to_position: Array, to_velocity: Array
    ) -> None:
        change, scratch = self._acceleration, self._scratch
        np.subtract(force, self.disturbance, out=change)
        np.multiply(change, self._inverse_mass, out=change)
        np.multiply(change, time, out=change)  # change of velocity
        np.multiply(change, 0.5, out=scratch)
        np.add(scratch, velocity, out=scratch)  # mean velocity
        np.multiply(scratch, time, out=scratch)
        np.add(position, scratch, out=to_position)
        np.add(velocity, change, out=to_velocity)
