"""PD plus feedforward, with the model's error estimated by one structured covariance filter per axis and fed forward.

State per axis: [e, ė, d0, theta1, theta2, theta3], error and disturbance

    d = d0 + theta1 sgn(q̇d) + theta2 q̇d + theta3 q̈d      (N)

Every regressor is the reference's mean over the interval in which a force acted, by the samples' own time stamps. The
Coulomb term therefore switches on the reference's reversal, not on the measured speed, and needs no time to be found
again; theta3 carries the error of the mass. Kalman filter: e.g. Simon, Optimal State Estimation (2006), section 5.1.

The covariance depends on the reference and on which samples came, never on what they say: plants that share both share
one covariance. The arithmetic is in hil/laws/structured_filter.py.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hil.laws.base import Array, Law, LawInputs, Model
from hil.laws.feedforward import DEFAULT_BANDWIDTH, DEFAULT_DAMPING
from hil.laws.structured_filter import (
    Covariance,
    Disturbance,
    Number,
    force_of,
    interval,
    move,
    predict,
    sign_array,
    sign_float,
    update,
)

PRIOR_SPEED = 1e-3  # m/s, standard deviation at the start, at rest


class Plant(NamedTuple):
    """Belief about one axis (floats) or all (arrays), and the gains."""

    period: Number
    mass: Number
    inverse_mass: Number
    coulomb: Number
    viscous: Number
    quadratic: Number
    gravity: Number
    kp: Number
    kd: Number
    noise: tuple[Number, ...]
    measurement: Number
    bounds: Disturbance


class Memory(NamedTuple):
    """What is kept from tick to tick: estimates, covariance, and the reference at the last sample."""

    error: Number
    rate: Number
    disturbance: Disturbance
    covariance: Covariance
    position: Number
    velocity: Number


class Sight(NamedTuple):
    """One tick's LawInputs as the arithmetic takes them."""

    position: Number
    fresh: Number
    sample_position: Number
    sample_velocity: Number
    sample_interval: Number
    ahead: Number
    start_position: Number
    start_velocity: Number
    end_velocity: Number
    mean_velocity: Number
    mean_acceleration: Number
    force_last: Number
    force_before: Number


def _sight(inputs: LawInputs) -> Sight:
    return Sight(
        inputs.position, inputs.fresh, inputs.sample.position, inputs.sample.velocity, inputs.sample_interval,
        inputs.ahead, inputs.start.position, inputs.start.velocity, inputs.end.velocity, inputs.mean_velocity,
        inputs.mean_acceleration, inputs.force_last, inputs.force_before,
    )  # fmt: skip


def _clamp_float(value: float, bound: float) -> float:
    return bound if value > bound else -bound if value < -bound else value


def _clamp_array(value: Array, bound: Array) -> Array:
    return np.minimum(np.maximum(value, -bound), bound)


def _friction(plant: Plant, mean_sign: Number, mean_velocity: Number) -> Number:
    """Nominal friction and gravity hold, N."""
    dry = plant.coulomb * mean_sign + plant.gravity
    return dry + (plant.viscous + plant.quadratic * abs(mean_velocity)) * mean_velocity


class Kind(NamedTuple):
    """The few operations that floats and arrays spell differently."""

    clamp: Callable[[Number, Number], Number]
    sign: Callable[..., tuple[Number, Number, Number]]


FLOATS, ARRAYS = Kind(_clamp_float, sign_float), Kind(_clamp_array, sign_array)


def _step(plant: Plant, memory: Memory, sight: Sight, kind: Kind) -> tuple[Memory, Number]:
    """Filter the sample in, look ahead to `start`, feed forward what is known and feed back what is left."""
    position, fresh, q1, v1, elapsed, ahead, q2, v2, v3, mean_v, mean_a, force_last, force_before = sight
    clamp, sign = kind
    error, rate, d, covariance, q0, v0 = memory
    inverse_mass = plant.inverse_mass

    mass = plant.mass
    past = interval(sign, mass, plant.coulomb + d.coulomb, elapsed, q0, v0, q1, v1)
    _, _, _, _, s, v, a, stuck, _ = past
    net = force_before - _friction(plant, s, v) - force_of(d, s, v, a) - stuck
    error, rate = move(error, rate, net, inverse_mass, past)
    covariance = predict(covariance, plant.noise, inverse_mass, past)
    covariance, (k0, k1, k2, k3, k4, k5) = update(covariance, plant.measurement, fresh)
    innovation = (position - q1) - error
    error = error + k0 * innovation
    rate = rate + k1 * innovation
    bounds = plant.bounds
    d = Disturbance(
        clamp(d.bias + k2 * innovation, bounds.bias),
        clamp(d.coulomb + k3 * innovation, bounds.coulomb),
        clamp(d.viscous + k4 * innovation, bounds.viscous),
        clamp(d.mass + k5 * innovation, bounds.mass),
    )

    coulomb = plant.coulomb + d.coulomb
    coming = interval(sign, mass, coulomb, ahead, q1, v1, q2, v2)
    _, _, _, _, s, v, a, stuck, _ = coming
    net = force_last - _friction(plant, s, v) - force_of(d, s, v, a) - stuck
    error_ahead, rate_ahead = move(error, rate, net, inverse_mass, coming)
    # An axis that waited for its reversal has the speed still to gain that the reference has already: `stuck`.
    mean_s, _, _ = sign(v2, v3, plant.period, mass, coulomb)
    known = mass * mean_a + stuck + _friction(plant, mean_s, mean_v) + force_of(d, mean_s, mean_v, mean_a)
    force = known - plant.kp * error_ahead - plant.kd * rate_ahead
    # The setpoints' arrays are reused by the caller: keep copies.
    return Memory(error, rate, d, covariance, q1 + 0.0, v1 + 0.0), force


class StructuredKalman(Law):
    """tau = feedforward(15) + d(estimated) - Kp e - Kd ė on the filter's own estimates, at the instant the force acts.

    kp: N/m; kd: N s/m; None: mass times omega^2 and 2 damping omega, omega = bandwidth (rad per period) / period, so
    that the same gains fit every rate. Noise densities of the random walks, per sqrt(s): acceleration_noise
    m/s; bias_noise N; coulomb_noise N; viscous_noise N s/m; mass_noise kg. reversal_noise: standard deviation of the
    speed where the reference reverses, as a fraction of the speed gained in that period. measurement_noise: m, standard
    deviation of a sample; not below 29 nm at 0.1 um counts. Estimates are bounded by the force limit.
    """

    name = "structured-kalman"
    GAINS: ClassVar[dict[str, Any]] = {
        "kp": None,
        "kd": None,
        "bandwidth": DEFAULT_BANDWIDTH,
        "damping": DEFAULT_DAMPING,
        "acceleration_noise": 1e-2,
        "reversal_noise": 0.5,
        "bias_noise": 1e-2,
        "coulomb_noise": 1e-2,
        "viscous_noise": 1e-2,
        "mass_noise": 1e-4,
        "measurement_noise": 29e-9,
    }

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: Array,
        *,
        kp: Array | None = None,
        kd: Array | None = None,
        bandwidth: float | Array = DEFAULT_BANDWIDTH,
        damping: float | Array = DEFAULT_DAMPING,
        acceleration_noise: float | Array = 1e-2,
        reversal_noise: float | Array = 0.5,
        bias_noise: float | Array = 1e-2,
        coulomb_noise: float | Array = 1e-2,
        viscous_noise: float | Array = 1e-2,
        mass_noise: float | Array = 1e-4,
        measurement_noise: float | Array = 29e-9,
    ) -> None:
        omega = np.multiply(bandwidth, 1.0 / period)
        kp = model.mass * (omega * omega) if kp is None else kp
        kd = model.mass * (2.0 * damping * omega) if kd is None else kd
        noises = (acceleration_noise, reversal_noise, bias_noise, coulomb_noise, viscous_noise, mass_noise)
        shape = np.broadcast_shapes(model.mass.shape, *(np.shape(gain) for gain in (kp, kd, *noises)))

        def full(value: float | Array) -> Array:
            return np.zeros(shape) + value

        # What the model may be wrong by before anything is known: a third of the force limit, half the mass.
        third, half = force_limit / 3.0, 0.5 * model.mass
        prior = (measurement_noise, PRIOR_SPEED, third, third, third, half)
        self._prior = [full(np.multiply(value, value)) for value in prior]
        limit = full(force_limit)
        self._plant = Plant(
            period=full(period),
            mass=full(model.mass),
            inverse_mass=full(1.0 / model.mass),
            coulomb=full(model.coulomb),
            viscous=full(model.viscous),
            quadratic=full(model.quadratic),
            gravity=full(model.gravity),
            kp=full(kp),
            kd=full(kd),
            noise=tuple(full(np.multiply(value, value)) for value in noises),
            measurement=full(np.multiply(measurement_noise, measurement_noise)),
            bounds=Disturbance(limit, limit, limit, full(0.9 * model.mass)),
        )
        self.reset(np.zeros(shape), model.gravity)

    def reset(self, position: Array, force: Array) -> None:
        """At rest, without error; what `force` has beyond the gravity hold is taken as bias."""
        plant, zero = self._plant, np.zeros(position.shape)
        bias = _clamp_array(zero + (force - plant.gravity), plant.bounds.bias)
        shared = np.zeros(plant.mass.shape)
        diagonal = dict(zip(("p00", "p11", "p22", "p33", "p44", "p55"), self._prior, strict=True))
        covariance = Covariance(*(diagonal.get(name, shared) for name in Covariance._fields))
        memory = Memory(zero, zero, Disturbance(bias, zero, zero, zero), covariance, zero, zero)
        self._force = np.zeros(position.shape)
        self._memory = memory
        self._begun = False
        self._acting = np.zeros(position.shape) + force  # in the interval before the newest sample
        self._axes: list[tuple[Plant, Memory]] = []
        if position.ndim == 1 and shared.ndim == 1:
            self._axes = [(_pick(plant, axis), _pick(memory, axis)) for axis in range(position.size)]

    def _begin(self, sight: Sight) -> None:
        """There is no earlier sample: the reference is taken to have rested where it is now."""
        q, v = sight.sample_position, sight.sample_velocity
        self._memory = self._memory._replace(position=q, velocity=v)
        self._axes = [
            (plant, memory._replace(position=float(q[axis]), velocity=float(v[axis])))
            for axis, (plant, memory) in enumerate(self._axes)
        ]
        self._begun = True

    def _acted(self, sight: Sight, fresh: Array) -> Sight:
        """The forces that acted: where no axis answered, the command was lost, and drives hold the force before it."""
        before, last = self._acting, sight.force_last
        if not self._begun:
            last = before  # the axes rest: drives or brakes hold them until the first command arrives
        elif not (fresh != 0.0).any(axis=-1).all():
            last = np.where((fresh != 0.0).any(axis=-1, keepdims=True), last, before)
        self._acting = last + 0.0
        return sight._replace(force_last=last, force_before=before)

    def force(self, inputs: LawInputs) -> Array:
        """The law of the class's docstring."""
        sight = self._acted(_sight(inputs), inputs.fresh)
        if not self._begun:
            self._begin(sight)
        if not self._axes:
            self._memory, self._force = _step(self._plant, self._memory, sight, ARRAYS)
            return self._force
        columns = zip(*(array.tolist() for array in sight), strict=True)
        for axis, values in enumerate(columns):
            plant, memory = self._axes[axis]
            memory, self._force[axis] = _step(plant, memory, Sight(*values), FLOATS)
            self._axes[axis] = plant, memory
        return self._force


def _pick(values: Any, axis: int) -> Any:
    """One axis of nested tuples of arrays, as floats."""
    if isinstance(values, tuple):
        picked = (_pick(value, axis) for value in values)
        return type(values)(*picked) if hasattr(values, "_fields") else tuple(picked)
    return float(values[axis])
