"""PD plus feedforward, with the model's error estimated by one structured covariance filter per axis and fed forward.

State per axis: [e, ė, d0, theta1, theta2, theta3], error and disturbance

    d = d0 + theta1 sgn(q̇d) + theta2 q̇d + theta3 q̈d      (N)

Every regressor is the reference's mean over the interval in which a force acted, by the samples' own time stamps. The
Coulomb term therefore switches on the reference's reversal, not on the measured speed, and needs no time to be found
again; theta3 carries the error of the mass. Kalman filter: e.g. Simon, Optimal State Estimation (2006), section 5.1.

The covariance depends on the reference and on which samples came, never on what they say: plants that share both share
one covariance of shape (6, 6, n_axes).
"""

from typing import Any, ClassVar

import numpy as np

from hil.laws.base import Array, Law, LawInputs, Model
from hil.laws.feedforward import Feedforward, default_damping, default_stiffness

SHORTEST = 1e-9  # s; intervals are never taken as shorter
PRIOR_SPEED = 1e-3  # m/s, standard deviation at the start, at rest
START, END = 0, 1  # the two intervals looked at: before the sample, and from the sample to the next force


class Regressors:
    """Reference increments and means over the last two intervals: up to the sample, and from there to `start`."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._position = np.zeros((3, *shape))
        self._velocity = np.zeros((3, *shape))
        self._speed = np.zeros((3, *shape))
        self._sum = np.zeros((2, *shape))
        self.time = np.zeros((2, *shape))
        self.moved = np.zeros((2, *shape))  # increments of position and velocity
        self.gained = np.zeros((2, *shape))
        self.h = np.ones((2, 4, *shape))  # 1, mean sgn, mean velocity, mean acceleration
        self.before = self._velocity[:2]  # velocity at each interval's start

    def seed(self, inputs: LawInputs) -> None:
        """There is no earlier sample: the reference is taken to have rested where it is now."""
        self._position[1] = inputs.sample.position
        self._velocity[1] = inputs.sample.velocity

    def update(self, inputs: LawInputs) -> None:
        """Take this tick's reference."""
        position, velocity, speed, total = self._position, self._velocity, self._speed, self._sum
        position[0] = position[1]
        position[1] = inputs.sample.position
        position[2] = inputs.start.position
        velocity[0] = velocity[1]
        velocity[1] = inputs.sample.velocity
        velocity[2] = inputs.start.velocity
        self.time[0] = inputs.sample_interval
        self.time[1] = inputs.ahead
        np.maximum(self.time, SHORTEST, out=self.time)
        np.subtract(position[1:], position[:2], out=self.moved)
        np.subtract(velocity[1:], velocity[:2], out=self.gained)
        np.divide(self.moved, self.time, out=self.h[:, 2])
        np.divide(self.gained, self.time, out=self.h[:, 3])
        np.abs(velocity, out=speed)
        np.add(speed[1:], speed[:2], out=total)
        np.maximum(total, 1e-300, out=total)
        np.add(velocity[1:], velocity[:2], out=self.h[:, 1])
        np.divide(self.h[:, 1], total, out=self.h[:, 1])


class Covariance:
    """P (6, 6, ...) of the structured filter, symmetric; row and column operations of its sparse transition only."""

    def __init__(self, prior: Array, noise: Array, measurement: Array, shape: tuple[int, ...]) -> None:
        self._p = np.zeros((6, 6, *shape))
        self._diagonal = self._p.reshape((36, *shape))[::7]
        self._diagonal[:] = prior
        self._noise = noise  # variance per second
        self._cap = np.maximum(prior, noise)
        self._measurement = measurement
        self.gain = np.zeros((6, *shape))
        self._w4 = np.zeros((4, 6, *shape))
        self._rows = np.zeros((2, 6, *shape))
        self._c4 = np.zeros((2, 4, *shape))
        self._block = np.zeros((2, 2, *shape))
        self._six = np.zeros((6, *shape))
        self._mask = np.zeros((6, *shape), dtype=np.bool_)
        self._outer = np.zeros((6, 6, *shape))
        self._scratch = np.zeros(shape)
        self._pair = np.zeros((2, *shape))

    def predict(self, h: Array, time: Array, per_force: Array) -> None:
        """P <- F P F' + Q time; h (4, ...): regressors; per_force = time / mass: speed gained per newton."""
        p, rows, block, w4, c4, six = self._p, self._rows, self._block, self._w4, self._c4, self._six
        half = np.multiply(0.5, time, out=self._scratch)
        # Rows: speed loses what the disturbance takes; position gains the mean of the speed before and after.
        np.multiply(p[2:], h[:, None], out=w4)
        w = np.add(w4[0], w4[1], out=w4[0])
        np.add(w, w4[2], out=w)
        np.add(w, w4[3], out=w)
        np.multiply(w, per_force, out=w)
        np.subtract(p[1], w, out=rows[1])
        np.add(p[1], rows[1], out=six)
        np.multiply(six, half, out=six)
        np.add(p[0], six, out=rows[0])
        # Columns: by symmetry only the leading 2 x 2 block still has to be worked out.
        np.multiply(rows[:, 2:], h, out=c4)
        c = np.add(c4[:, 0], c4[:, 1], out=self._pair)
        np.add(c, c4[:, 2], out=c)
        np.add(c, c4[:, 3], out=c)
        np.multiply(c, per_force, out=c)
        np.subtract(rows[:, 1], c, out=block[:, 1])
        np.add(rows[:, 1], block[:, 1], out=c)
        np.multiply(c, half, out=c)
        np.add(rows[:, 0], c, out=block[:, 0])
        p[:2, 2:] = rows[:, 2:]
        p[2:, 0] = rows[0, 2:]
        p[2:, 1] = rows[1, 2:]
        p[0, 0] = block[0, 0]
        p[1, 1] = block[1, 1]
        p[0, 1] = p[1, 0] = block[0, 1]
        np.less(self._diagonal, self._cap, out=self._mask)
        np.multiply(self._noise, time, out=six)
        np.multiply(six, self._mask, out=six)
        np.add(self._diagonal, six, out=self._diagonal)

    def update(self, fresh: Array) -> None:
        """P <- (I - K H) P with K in `gain`, zero where `fresh` is 0."""
        p = self._p
        np.add(p[0, 0], self._measurement, out=self._scratch)
        np.divide(p[0], self._scratch, out=self.gain)
        np.multiply(self.gain, fresh, out=self.gain)
        np.multiply(self.gain[:, None], p[0], out=self._outer)
        np.subtract(p, self._outer, out=p)


class StructuredKalman(Law):
    """tau = feedforward(15) + d(estimated) - Kp e - Kd ė on the filter's own estimates, at the instant the force acts.

    kp: N/m; kd: N s/m; None: from mass and rate. Noise densities of the random walks, per sqrt(s): acceleration_noise
    m/s^2 sqrt(s); bias_noise N; coulomb_noise N; viscous_noise N s/m; mass_noise kg. measurement_noise: m, standard
    deviation of a sample; not below 29 nm at 0.1 um counts. Estimates are bounded by the force limit.
    """

    name = "structured-kalman"
    GAINS: ClassVar[dict[str, Any]] = {
        "kp": None,
        "kd": None,
        "acceleration_noise": 1e-2,
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
        acceleration_noise: float | Array = 1e-2,
        bias_noise: float | Array = 1e-2,
        coulomb_noise: float | Array = 1e-2,
        viscous_noise: float | Array = 1e-2,
        mass_noise: float | Array = 1e-4,
        measurement_noise: float | Array = 29e-9,
    ) -> None:
        self._model = model
        self._kp = default_stiffness(model, period) if kp is None else kp
        self._kd = default_damping(model, period) if kd is None else kd
        self._feedforward = Feedforward(model)
        self._inverse_mass = 1.0 / model.mass
        one = np.ones(np.broadcast_shapes(model.mass.shape, *(np.shape(g) for g in (acceleration_noise, bias_noise))))
        densities = (0.0, acceleration_noise, bias_noise, coulomb_noise, viscous_noise, mass_noise)
        self._noise = np.stack([np.multiply(d, d) * one for d in densities])
        self._measurement = np.multiply(measurement_noise, measurement_noise) * one
        # What the model may be wrong by before anything is known: a third of the force limit, of the mass.
        third = force_limit / 3.0
        spread = (np.sqrt(self._measurement), PRIOR_SPEED * one, third, third, third, 0.5 * model.mass)
        self._prior = np.stack([s * s for s in spread])
        self._bound = np.stack([force_limit * one, force_limit * one, force_limit * one, 0.9 * model.mass])
        self._wide = False
        self.reset(np.zeros_like(model.mass), model.gravity)

    def reset(self, position: Array, force: Array) -> None:
        """At rest, without error; what `force` has beyond the gravity hold is taken as bias."""
        shape = position.shape
        self._x = np.zeros((6, *shape))
        self._x[2] = np.minimum(np.maximum(force - self._model.gravity, -self._bound[0]), self._bound[0])
        self._force = np.zeros(shape)
        self._terms = np.zeros((4, *shape))
        self._states = np.zeros((6, *shape))
        self._net = np.zeros(shape)
        self._ahead = np.zeros((2, *shape))
        self._begun = False

    def _begin(self, inputs: LawInputs) -> None:
        noise = self._noise
        reference = (inputs.fresh.shape, inputs.sample_interval.shape, inputs.sample.position.shape)
        shape = np.broadcast_shapes(noise.shape[1:], *reference)

        def wide(values: Array, ndim: int) -> Array:
            """Room for batch axes between the states and the axes."""
            return values.reshape((values.shape[0], *(1,) * (ndim + 1 - values.ndim), *values.shape[1:]))

        self._regressors = Regressors(shape)
        prior, noise = wide(self._prior, len(shape)), wide(noise, len(shape))
        self._covariance = Covariance(prior, noise, self._measurement, shape)
        self._per_force = np.zeros((2, *shape))
        self._friction = np.zeros((2, *shape))
        self._h_end = np.ones((4, *shape))
        self._high = wide(self._bound, self._force.ndim)
        self._low = -self._high
        self._gap = (slice(None),) + (None,) * (self._force.ndim - len(shape)) + (Ellipsis,)
        self._regressors.seed(inputs)
        self._begun = True

    def _disturbance(self, h: Array) -> Array:
        """d0 + theta1 h1 + theta2 h2 + theta3 h3, N; valid until the next call."""
        terms = self._terms
        np.multiply(self._x[2:], h[self._gap], out=terms)
        total: Array = terms[0]
        np.add(total, terms[1], out=total)
        np.add(total, terms[2], out=total)
        np.add(total, terms[3], out=total)
        return total

    def _move(self, error: Array, rate: Array, force: Array, interval: int, to: Array) -> None:
        """Error and its rate at the end of an interval under `force`, into to[0], to[1]."""
        r, net = self._regressors, self._net
        d = self._disturbance(r.h[interval])
        np.subtract(force, self._friction[interval], out=net)
        np.subtract(net, d, out=net)
        np.multiply(net, self._per_force[interval], out=net)  # speed gained
        np.multiply(net, 0.5, out=d)
        np.add(d, rate, out=d)
        np.add(d, r.before[interval], out=d)
        np.multiply(d, r.time[interval], out=d)
        np.subtract(d, r.moved[interval], out=d)
        np.add(error, d, out=to[0])
        np.subtract(net, r.gained[interval], out=net)
        np.add(rate, net, out=to[1])

    def _nominal_friction(self) -> None:
        """Nominal friction and gravity over both intervals, N."""
        model, h, out = self._model, self._regressors.h, self._friction
        np.abs(h[:, 2], out=out)
        np.multiply(out, model.quadratic, out=out)
        np.add(out, model.viscous, out=out)
        np.multiply(out, h[:, 2], out=out)
        np.add(out, model.coulomb * h[:, 1], out=out)
        np.add(out, model.gravity, out=out)

    def force(self, inputs: LawInputs) -> Array:
        """Filter the sample in, look ahead to `start`, feed forward what is known and feed back what is left."""
        if not self._begun:
            self._begin(inputs)
        x, r, covariance = self._x, self._regressors, self._covariance
        r.update(inputs)
        np.multiply(r.time, self._inverse_mass, out=self._per_force)
        self._nominal_friction()
        self._move(x[0], x[1], inputs.force_before, START, x)
        covariance.predict(r.h[START], r.time[START], self._per_force[START])
        covariance.update(inputs.fresh)
        innovation = np.subtract(inputs.position, inputs.sample.position, out=self._net)
        np.subtract(innovation, x[0], out=innovation)
        np.multiply(covariance.gain[self._gap], innovation, out=self._states)
        np.add(x, self._states, out=x)
        np.minimum(x[2:], self._high, out=x[2:])
        np.maximum(x[2:], self._low, out=x[2:])
        self._move(x[0], x[1], inputs.force_last, END, self._ahead)
        h = self._h_end
        h[1] = inputs.mean_sign
        h[2] = inputs.mean_velocity
        h[3] = inputs.mean_acceleration
        out = self._force
        np.add(self._disturbance(h), self._feedforward(inputs), out=out)
        np.multiply(self._ahead[0], self._kp, out=self._net)
        np.subtract(out, self._net, out=out)
        np.multiply(self._ahead[1], self._kd, out=self._net)
        np.subtract(out, self._net, out=out)
        return out
