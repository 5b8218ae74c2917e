"""Design of the rig's Kalman filter with filterpy: constant gains, applied by hil/control/estimator/gains.py.

filterpy brings scipy and matplotlib (2 s, 100 MB). The control process must not carry that, so `python -m
hil.control.estimator.filterpy_design` does the design in a short-lived child: JSON in, JSON out.
"""

import json
import sys
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter


def transition(mass: float, t: float) -> tuple[Any, Any]:
    """State transition (3, 3) and input (3, 1) over t s of [position m, velocity m/s, disturbance N] of one axis.

    Acceleration = (force - disturbance) / mass, constant meanwhile (zero-order hold).
    """
    f = np.array([[1.0, t, -t * t / (2.0 * mass)], [0.0, 1.0, -t / mass], [0.0, 0.0, 1.0]])
    return f, np.array([[t * t / (2.0 * mass)], [t / mass], [0.0]])


def make_filter(mass: float, period: float, disturbance_noise: float, acceleration_noise: float, sigma: float) -> Any:
    """filterpy's filter on [position m, velocity m/s, disturbance N] with input force (N), one axis.

    disturbance_noise: N/sqrt(s); acceleration_noise: m/s^2/sqrt(Hz); sigma: standard deviation of a position sample, m.
    """
    kf = KalmanFilter(dim_x=3, dim_z=1, dim_u=1)
    t = period
    kf.F, kf.B = transition(mass, period)
    kf.H = np.array([[1.0, 0.0, 0.0]])
    kf.R = np.array([[sigma**2]])
    walk = disturbance_noise**2
    g = np.array([-1.0 / mass])[0]
    # Integrals of the random walk of the force through the double integrator (van Loan, closed form).
    kf.Q = walk * np.array(
        [
            [g * g * t**5 / 20, g * g * t**4 / 8, g * t**3 / 6],
            [g * g * t**4 / 8, g * g * t**3 / 3, g * t**2 / 2],
            [g * t**3 / 6, g * t**2 / 2, t],
        ]
    ) + acceleration_noise**2 * np.array([[t**3 / 3, t**2 / 2, 0.0], [t**2 / 2, t, 0.0], [0.0, 0.0, 0.0]])
    kf.P = np.diag([sigma**2, 1.0, (10.0 * disturbance_noise) ** 2])
    return kf


def steady_gains(kf: Any, tolerance: float = 1e-12, limit: int = 100_000) -> tuple[list[float], float]:
    """Kalman gain [q, v, d] and innovation variance (m^2) after the covariance has settled. Raises ArithmeticError if
    it does not.
    """
    previous = np.zeros((3, 1))
    for _ in range(limit):
        kf.predict()
        kf.update(np.zeros((1, 1)))
        if np.all(np.abs(kf.K - previous) <= tolerance * np.abs(kf.K)):
            return [float(k) for k in kf.K[:, 0]], float(kf.S[0, 0])
        previous = kf.K.copy()
    raise ArithmeticError("the Kalman filter's covariance does not settle; check [estimator]")


def design(axes: list[dict[str, float]]) -> list[tuple[list[float], float]]:
    """Gains and innovation variance per axis; each entry holds make_filter's keyword arguments.

    Rounded to nine digits: filterpy multiplies matrices through BLAS, whose last bits depend on the processor (2e-12
    was seen), and a run must not.
    """
    settled = (steady_gains(make_filter(**axis)) for axis in axes)
    return [([float(f"{gain:.8e}") for gain in gains], float(f"{variance:.8e}")) for gains, variance in settled]


if __name__ == "__main__":
    json.dump(design(json.load(sys.stdin)), sys.stdout)
