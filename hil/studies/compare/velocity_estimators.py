"""Velocity estimators on the same quantised positions, against the stage's true velocity (`hil compare --velocity`).

One lockstep run gives the data; every estimator then sees the same samples and forces. Kalman filters are filterpy's,
run to their steady state; Simon, Optimal State Estimation (2006), chapter 5. The last one is the structured filter of
hil/control/laws/structured_kalman.py with the rig's gains for it, watching.

An independent study (docs/paper.md) has 112 um/s for model, input and disturbance state. On paper.toml with Delta = 0.3
ours has 124 / 133: 103 / 102 between reversals, the rest (a third of the squared error) within ten ticks of one, where
Delta flips by 0.6 N at once and a random walk has to find it again. Stamps are not the cause (121 / 134 on a wire whose
commands arrive to the nanosecond), nor is the noise assumed (121 / 133 at the best). Without Delta it is 104 / 104.
What helps is to know that friction flips where the reference does: the structured filter.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.control.estimator.gains import filter_parameters
from hil.control.laws import make_law
from hil.control.laws.base import Array, Model
from hil.control.laws.coupled import gather
from hil.control.laws.structured_kalman import StructuredKalman
from hil.control.nominal_model import rig_model
from hil.rig.schema import LawConfig, RigConfig
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import steady_from

DERIVATIVE_CORNER_HZ = 400.0  # of 20 to 400 Hz the best on the paper's circle: lag costs more there than noise
JERKY = 300.0  # m/s^2/sqrt(Hz), white acceleration of the constant-velocity filter on q: it must follow the task
ERROR_ACCELERATION = 3.0  # likewise on the error, which hardly accelerates
MODEL_ACCELERATION = 0.3  # m/s^2/sqrt(Hz), of the model without a disturbance state
JERK = 300.0  # m/s^3/sqrt(Hz), white jerk of the constant-acceleration filter


class Data:
    """Of one run, steady window only, arrays (ticks, n_axes): position as measured, setpoint and its velocity, true
    velocity, net force (applied force less nominal friction) and length (s) of the interval before each sample;
    velocity as the structured filter has it.

    The length is by the samples' stamps: stuff bits alone move a command by a microsecond, and at 3 m/s that is 3 um.
    """

    def __init__(self, rig: RigConfig, base_dir: Path, seconds: float) -> None:
        run = LockstepRun(rig, base_dir)
        model = rig_model(rig)
        watcher = _structured_filter(rig)
        rows: list[Array] = []
        for _ in range(round(seconds * rig.rate_hz)):
            run.tick()
            inputs = gather(run.cycle.inputs)
            if run.index - 1 <= run.activated_at or run.activated_at < 0:
                watcher.reset(inputs.position.copy(), model.gravity)
            if run.activated_at >= 0:
                watcher.force(inputs)
            rows.append(
                np.stack(
                    [inputs.position, inputs.sample.position, inputs.sample.velocity, run.true_velocity,
                     inputs.force_before, inputs.sample_interval, inputs.sample.velocity + watcher.error_rate]
                )
            )  # fmt: skip
        first = steady_from(run, len(rows))
        columns = np.moveaxis(np.array(rows[first:]), 1, 0)
        self.position, self.setpoint, self.reference, self.truth, force, self.interval, self.structured = columns
        self.period = rig.period_ns * 1e-9
        self.net = force - _nominal_friction(model, self.reference) - model.gravity
        self.model = model
        self.parameters = filter_parameters(rig)


def _structured_filter(rig: RigConfig) -> StructuredKalman:
    config = LawConfig(name="structured-kalman", tuned=rig.law.tuned)
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    law = make_law(config, rig_model(rig), rig.period_ns * 1e-9, limit)
    assert isinstance(law, StructuredKalman)
    return law


def _nominal_friction(model: Model, velocity: Array) -> Array:
    before = np.vstack([velocity[:1], velocity[:-1]])
    total = np.abs(before) + np.abs(velocity)
    sign = (before + velocity) / np.maximum(total, 1e-300)
    mean = 0.5 * (before + velocity)
    friction: Array = model.coulomb * sign + model.viscous * mean + model.quadratic * mean * np.abs(mean)
    return friction


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


ESTIMATORS: dict[str, Callable[[Data, int], Array]] = {
    "finite difference": finite_difference,
    "filtered derivative": filtered_derivative,
    "Kalman, constant velocity": constant_velocity,
    "Kalman, constant velocity of the error": constant_velocity_error,
    "Kalman, constant acceleration of the error": constant_acceleration,
    "Kalman, model and input": model_input,
    "Kalman, model, input and disturbance": model_input_disturbance,
    "Kalman, structured": structured,
}


def compare_velocity(rig: RigConfig, base_dir: Path, seconds: float) -> list[dict[str, Any]]:
    """Rows {estimator, axes.<name>.rms_error} over the second half of the steady window, m/s."""
    data = Data(rig, base_dir, seconds)
    half = len(data.truth) // 2
    rows = []
    for name, estimator in ESTIMATORS.items():
        axes = {}
        for axis, axis_name in enumerate(rig.axis_names):
            error = (estimator(data, axis) - data.truth[:, axis])[half:]
            axes[axis_name] = {"rms_error": float(np.sqrt(np.mean(error**2)))}
        rows.append({"estimator": name, "axes": axes})
    return rows


def velocity_table(rig: RigConfig, rows: list[dict[str, Any]]) -> Any:
    """RMS errors in um/s (urad/s)."""
    from rich.table import Table

    table = Table("estimator", title=f"{rig.name}, {rig.law.name}: error of the velocity at the sample, RMS")
    for name, axis in rig.axes.items():
        table.add_column(f"{name}, {'µm/s' if axis.kind == 'linear' else 'µrad/s'}", justify="right")
    for row in rows:
        table.add_row(row["estimator"], *(f"{row['axes'][name]['rms_error'] * 1e6:.4g}" for name in rig.axes))
    return table
