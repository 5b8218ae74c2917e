"""Velocity estimators on the same quantised positions, against the stage's true velocity (`hil compare --velocity`).

Lockstep runs give the data (velocity_cases.py); every estimator then sees the same samples and forces. Kalman filters
are filterpy's, run to their steady state; Simon, Optimal State Estimation (2006), chapter 5. "structured" is the filter
of hil/control/laws/structured_kalman.py with the rig's gains for it, watching. The last two rows are what the cycle
itself had: its filter, which laws see, and the velocity shown in telemetry (hil/control/estimator).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.control.laws.base import Array
from hil.rig.schema import RigConfig
from hil.studies.compare.velocity_cases import Data, cases_of

DERIVATIVE_CORNER_HZ = 400.0  # of 20 to 400 Hz the best on the paper's circle: lag costs more there than noise
JERKY = 300.0  # m/s^2/sqrt(Hz), white acceleration of the constant-velocity filter on q: it must follow the task
ERROR_ACCELERATION = 3.0  # likewise on the error, which hardly accelerates
MODEL_ACCELERATION = 0.3  # m/s^2/sqrt(Hz), of the model without a disturbance state
ALPHA, BETA = 0.6, 0.26  # of the alpha-beta filters: shares of the innovation
PLL_HZ, PLL_DAMPING = 80.0, 0.7  # of the tracking loop
JERK = 300.0  # m/s^3/sqrt(Hz), white jerk of the constant-acceleration filter


def finite_difference(data: Data, axis: int) -> Array:
    """(q(k) - q(k-1)) over the interval between them."""
    q = data.position[:, axis]
    velocity: Array = np.diff(q, prepend=q[0]) / data.interval[:, axis]
    return velocity


def filtered_derivative(data: Data, axis: int) -> Array:
    """The same through a first-order low-pass of DERIVATIVE_CORNER_HZ."""
    from scipy.signal import lfilter

    raw = finite_difference(data, axis)
    raw[0] = raw[1]
    pole = np.exp(-2.0 * np.pi * DERIVATIVE_CORNER_HZ * data.period)
    filtered: Array = lfilter([1.0 - pole], [1.0, -pole], raw, zi=[pole * raw[1]])[0]
    return filtered


Matrices = tuple[Array, Array]  # transition and input over an interval


def _steady_filter(
    over: Callable[[float], Matrices], q: Array, sigma: float, period: float, measured: Array, inputs: Array, *,
    interval: Array, start: Array,
) -> Array:  # fmt: skip
    """filterpy's filter designed to its steady state at the nominal period, then applied over the true intervals; the
    velocity (state 1) after every sample.
    """
    from filterpy.kalman import KalmanFilter

    f, _ = over(period)
    size = len(f)
    kf = KalmanFilter(dim_x=size, dim_z=1)
    kf.F, kf.Q, kf.R = f, q, np.array([[sigma * sigma]])
    kf.H = np.eye(1, size)
    kf.P = np.eye(size) * 1e6
    for _ in range(2000):
        kf.predict()
        kf.update(np.zeros((1, 1)))
    gain = kf.K[:, 0]
    x, out = start.copy(), np.empty(len(measured))
    for k, (z, u, t) in enumerate(zip(measured.tolist(), inputs.tolist(), interval.tolist(), strict=True)):
        if k:
            f, b = over(t)
            x = f @ x + b * u
        x = x + gain * (z - x[0])
        out[k] = x[1]
    return out


def _coast(t: float) -> Matrices:
    return np.array([[1.0, t], [0.0, 1.0]]), np.zeros(2)


def _white_acceleration(t: float, density: float) -> Array:
    return density**2 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])


def constant_velocity(data: Data, axis: int) -> Array:
    """Kalman filter on q with white acceleration."""
    q = _white_acceleration(data.period, JERKY)
    z = data.position[:, axis]
    start = np.array([z[0], data.reference[0, axis]])
    sigma = data.parameters[axis]["sigma"]
    return _steady_filter(_coast, q, sigma, data.period, z, 0.0 * z, interval=data.interval[:, axis], start=start)


def constant_velocity_error(data: Data, axis: int) -> Array:
    """The same on the error e = q - qd; the reference's own velocity is known."""
    q = _white_acceleration(data.period, ERROR_ACCELERATION)
    z = data.position[:, axis] - data.setpoint[:, axis]
    sigma, interval = data.parameters[axis]["sigma"], data.interval[:, axis]
    rate = _steady_filter(_coast, q, sigma, data.period, z, 0.0 * z, interval=interval, start=np.array([z[0], 0.0]))
    velocity: Array = rate + data.reference[:, axis]
    return velocity


def constant_acceleration(data: Data, axis: int) -> Array:
    """Kalman filter on the error with white jerk."""

    def over(t: float) -> Matrices:
        return np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]]), np.zeros(3)

    t = data.period
    q = JERK**2 * np.array([[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]])
    z = data.position[:, axis] - data.setpoint[:, axis]
    sigma, interval = data.parameters[axis]["sigma"], data.interval[:, axis]
    rate = _steady_filter(over, q, sigma, t, z, 0.0 * z, interval=interval, start=np.array([z[0], 0.0, 0.0]))
    velocity: Array = rate + data.reference[:, axis]
    return velocity


def model_input(data: Data, axis: int) -> Array:
    """Model and input, no disturbance: biased by whatever the model lacks."""
    from hil.control.estimator.filterpy_design import transition

    mass = float(data.model.mass[axis])

    def over(t: float) -> Matrices:
        f, b = transition(mass, t)
        return f[:2, :2], b[:2, 0]

    q = _white_acceleration(data.period, MODEL_ACCELERATION)
    z = data.position[:, axis]
    sigma, interval = data.parameters[axis]["sigma"], data.interval[:, axis]
    start = np.array([z[0], data.reference[0, axis]])
    return _steady_filter(over, q, sigma, data.period, z, data.net[:, axis], interval=interval, start=start)


def model_input_disturbance(data: Data, axis: int) -> Array:
    """Model, input and a random-walk disturbance: the rig's own filter."""
    from hil.control.estimator.filterpy_design import make_filter, transition

    kf = make_filter(**data.parameters[axis])
    mass = data.parameters[axis]["mass"]

    def over(t: float) -> Matrices:
        f, b = transition(mass, t)
        return f, b[:, 0]

    z = data.position[:, axis]
    start = np.array([z[0], data.reference[0, axis], 0.0])
    sigma, interval = data.parameters[axis]["sigma"], data.interval[:, axis]
    return _steady_filter(over, kf.Q, sigma, data.period, z, data.net[:, axis], interval=interval, start=start)


def structured(data: Data, axis: int) -> Array:
    """Disturbance of bias, Coulomb friction, viscous friction and mass on the reference's own signs."""
    velocity: Array = data.structured[:, axis]
    return velocity


def _alpha_beta(measured: Array, interval: Array, gains: tuple[float, float], rate: float) -> Array:
    """Velocity by the alpha-beta filter (Kalata, IEEE TAES 20(2), 1984), from the first sample and `rate` m/s on."""
    alpha, beta = gains
    position, out = float(measured[0]), np.empty(len(measured))
    for k, (z, t) in enumerate(zip(measured.tolist(), interval.tolist(), strict=True)):
        ahead = position + rate * t if k else position
        position = ahead + alpha * (z - ahead)
        rate = rate + beta * (z - ahead) / t
        out[k] = rate
    return out


def alpha_beta(data: Data, axis: int) -> Array:
    """On the position."""
    start = float(data.reference[0, axis])
    return _alpha_beta(data.position[:, axis], data.interval[:, axis], (ALPHA, BETA), start)


def alpha_beta_error(data: Data, axis: int) -> Array:
    """On the error; the reference's own velocity is known."""
    error = data.position[:, axis] - data.setpoint[:, axis]
    velocity: Array = _alpha_beta(error, data.interval[:, axis], (ALPHA, BETA), 0.0) + data.reference[:, axis]
    return velocity


def tracking_loop(data: Data, axis: int) -> Array:
    """A phase-locked loop, as resolver converters have it: two integrators that follow the position."""
    step = 2.0 * np.pi * PLL_HZ * data.period
    gains = 2.0 * PLL_DAMPING * step, step * step
    return _alpha_beta(data.position[:, axis], data.interval[:, axis], gains, float(data.reference[0, axis]))


def for_laws(data: Data, axis: int) -> Array:
    """The cycle's own filter."""
    velocity: Array = data.for_laws[:, axis]
    return velocity


def shown(data: Data, axis: int) -> Array:
    """What telemetry shows."""
    velocity: Array = data.shown[:, axis]
    return velocity


ESTIMATORS: dict[str, Callable[[Data, int], Array]] = {
    "finite difference": finite_difference,
    "filtered derivative": filtered_derivative,
    "alpha-beta": alpha_beta,
    "alpha-beta of the error": alpha_beta_error,
    "phase-locked loop": tracking_loop,
    "Kalman, constant velocity": constant_velocity,
    "Kalman, constant velocity of the error": constant_velocity_error,
    "Kalman, constant acceleration of the error": constant_acceleration,
    "Kalman, model and input": model_input,
    "Kalman, model, input and disturbance": model_input_disturbance,
    "Kalman, structured": structured,
    "the rig's own, for laws": for_laws,
    "the rig's own, shown": shown,
}


def compare_velocity(rig: RigConfig, base_dir: Path, seconds: float) -> list[dict[str, Any]]:
    """Rows {case, state, estimator, axes.<name>.rms_error} over the second half of the steady window, m/s; state: in
    which the run ended.
    """
    rows = []
    for case, changed in cases_of(rig).items():
        data = Data(changed, base_dir, seconds)
        half = len(data.truth) // 2
        for name, estimator in ESTIMATORS.items():
            axes = {}
            for axis, axis_name in enumerate(rig.axis_names):
                error = (estimator(data, axis) - data.truth[:, axis])[half:]
                axes[axis_name] = {"rms_error": float(np.sqrt(np.mean(error**2)))}
            rows.append({"case": case, "state": data.state, "estimator": name, "axes": axes})
    return rows


def velocity_tables(rig: RigConfig, rows: list[dict[str, Any]]) -> list[Any]:
    """One table an axis: RMS errors in um/s (urad/s), a column a case."""
    from rich.table import Table

    states = {row["case"]: row["state"] for row in rows}
    tables = []
    for name, axis in rig.axes.items():
        unit = "µm/s" if axis.kind == "linear" else "µrad/s"
        table = Table("estimator", title=f"{rig.name} {name}, {rig.law.name}: RMS error of the velocity, {unit}")
        for case, state in states.items():
            table.add_column(case if state == "ACTIVE" else f"{case} ({state})", justify="right")
        for estimator in ESTIMATORS:
            errors = [row["axes"][name]["rms_error"] for row in rows if row["estimator"] == estimator]
            table.add_row(estimator, *(f"{error * 1e6:.3g}" for error in errors))
        tables.append(table)
    return tables
