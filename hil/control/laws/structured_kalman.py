"""PD plus feedforward, with the model's error estimated by one structured covariance filter per axis and fed forward.

State per axis: [e, ė, d0, theta1, theta2, theta3], error and disturbance

    d = d0 + theta1 sgn(q̇d) + theta2 q̇d + theta3 q̈d      (N)

Every regressor is the reference's mean over the interval in which a force acted, by the samples' own time stamps. The
Coulomb term therefore switches on the reference's reversal, not on the measured speed, and needs no time to be found
again; theta3 carries the error of the mass. What the filter expects of the next sample follows set-valued friction all
the same. An axis that sticks, before it first moves or where it reverses slowly, says only that friction holds. A
filter that expects it to move would learn a bias that is not there. Kalman filter: e.g. Simon, Optimal State Estimation
(2006), section 5.1. Where a slow axis' friction falls with speed, theta2 may be the height of that peak instead of
viscous friction.

The covariance depends on the reference and on which samples came, never on what they say: plants that share both share
one covariance. The arithmetic is in hil/control/laws/structured_filter.py.
"""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.breakaway import Breakaway, anywhere
from hil.control.laws.structured_filter import (
    Covariance,
    Disturbance,
    Noise,
    choose,
    diagonal,
    force_of,
    interval,
    keep_disturbance,
    mean_sign_over,
    move,
    peak,
    predict,
    slide,
    standing,
    update,
)
from hil.control.laws.terms import DEFAULT_BANDWIDTH, DEFAULT_DAMPING
from hil.control.number import Number, at_least, bounded, copy, select, zeros_like

# Standard deviations at the start, at rest: m/s; of gravity and dry friction; of dry friction; of the force limit.
PRIOR_SPEED, BIAS_PART, DRY_PART, SMALL_PART = 1e-3, 0.1, 1.0, 0.05


def _learnt(low: float, high: float, scale: str) -> Knob:
    """Noise of a parameter of the disturbance: how much of a force as large as that of the acceleration's noise is put
    down to it per period.
    """
    return Knob(low, high, scale, "acceleration_noise", density=True)


class StructuredKalman(Law):
    """tau = feedforward(15) + d(estimated) - Kp e - Kd ė on the filter's own estimates, at the instant the force acts.

    omega = bandwidth (rad per period) / period, so that the same gains fit every rate. The noises are densities of
    random walks, per sqrt(s). Estimates are bounded by the force limit. The priors are standard deviations at the
    start, of what the model may be wrong by before anything is known. Where stribeck_velocity is above 0, theta2 is the
    height (N) of friction's peak at rest, of that width, and viscous_noise and viscous_prior are in N. Where
    breakaway_rate is above 0 (hil/control/laws/breakaway.py), what is learnt while the reference rests leaves the
    variances of d as they were: an axis that friction holds is no evidence.
    """

    own_estimate: ClassVar[bool] = True
    told_of_learning: ClassVar[bool] = True
    GAINS: ClassVar[dict[str, Gain]] = {
        "kp": Gain(None, "N/m", "stiffness; default: mass times omega^2"),
        "kd": Gain(None, "N s/m", "damping; default: 2 damping omega times the mass"),
        "bandwidth": Gain(
            DEFAULT_BANDWIDTH, "rad", "omega times the period", tune=Knob(0.15, 0.45), plan=Knob(0.15, 0.35)
        ),
        "damping": Gain(DEFAULT_DAMPING, "1", "damping ratio", tune=Knob(0.4, 1.2), plan=Knob(0.6, 1.0)),
        # What a filter does with a sample depends on ratios: of the acceleration's noise to the encoder's, and of a
        # slow parameter's noise to the acceleration's, which is how quickly it is learnt.
        "acceleration_noise": Gain(
            1e-2, "m/s/sqrt(s)", "noise density of the speed",
            tune=Knob(1.0, 3e3, "count/T1.5", density=True), plan=Knob(5e-5, 1e-3),
        ),
        "reversal_noise": Gain(
            0.5, "1", "standard deviation of the speed at a reversal, as a part of the speed gained there",
            tune=Knob(1e-2, 1.0), plan=Knob(5e-3, 0.1),
        ),
        "bias_noise": Gain(
            1e-2, "N/sqrt(s)", "noise density of d0", tune=_learnt(1e-5, 0.3, "m/T"), plan=Knob(3e-4, 0.1, "C")
        ),
        "coulomb_noise": Gain(
            1e-2, "N/sqrt(s)", "noise density of theta1", tune=_learnt(3e-3, 1.0, "m/T"), plan=Knob(3e-3, 0.1, "C")
        ),
        "viscous_noise": Gain(1e-2, "N s/m/sqrt(s)", "noise density of theta2", tune=_learnt(1e-3, 1.0, "m2/FT2")),
        "mass_noise": Gain(
            1e-4, "kg/sqrt(s)", "noise density of theta3", tune=_learnt(0.03, 30.0, "m2/FT"), plan=Knob(0.01, 1.0, "m")
        ),
        "measurement_noise": Gain(
            29e-9, "m", "standard deviation of a sample; not below 29 nm at 0.1 um counts",
            tune=Knob(0.29, 1.0, "count"), plan=Knob(0.5, 1.0, "count"),
        ),
        "bias_prior": Gain(
            None, "N", "standard deviation of d0 at the start; default: from the model", plan=Knob(1e-3, 1.0, "C")
        ),
        "coulomb_prior": Gain(
            None, "N", "standard deviation of theta1 at the start; default: from the model", plan=Knob(0.03, 1.0, "C")
        ),
        "viscous_prior": Gain(
            None, "N s/m", "standard deviation of theta2 at the start; default: from the model",
            plan=Knob(0.03, 0.5, "C"),
        ),
        "mass_prior": Gain(
            None, "kg", "standard deviation of theta3 at the start; default: from the model", plan=Knob(0.01, 0.1, "m")
        ),
        "stribeck_velocity": Gain(0.0, "m/s", "width of friction's peak at rest; 0: theta2 is viscous friction"),
        "breakaway_rate": Gain(0.0, "N/s", "creep of the force at rest; 0: none", plan=Knob(5.0, 50.0, "C")),
        "breakaway_lag": Gain(0.0, "m", "lead of the reference at which the creep begins"),
    }  # fmt: skip

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        kp: Number | None = given["kp"]
        kd: Number | None = given["kd"]
        bandwidth: Number = given["bandwidth"]
        damping: Number = given["damping"]
        acceleration_noise: Number = given["acceleration_noise"]
        reversal_noise: Number = given["reversal_noise"]
        bias_noise: Number = given["bias_noise"]
        coulomb_noise: Number = given["coulomb_noise"]
        viscous_noise: Number = given["viscous_noise"]
        mass_noise: Number = given["mass_noise"]
        measurement_noise: Number = given["measurement_noise"]
        bias_prior: Number | None = given["bias_prior"]
        coulomb_prior: Number | None = given["coulomb_prior"]
        viscous_prior: Number | None = given["viscous_prior"]
        mass_prior: Number | None = given["mass_prior"]
        stribeck_velocity: Number = given["stribeck_velocity"]
        breakaway_rate: Number = given["breakaway_rate"]
        breakaway_lag: Number = given["breakaway_lag"]
        omega = bandwidth * (1.0 / period)
        self.stiffness = model.mass * (omega * omega) if kp is None else kp
        self.damping = model.mass * (2.0 * damping * omega) if kd is None else kd
        self._model, self._period = model, period
        self._inverse_mass = 1.0 / model.mass
        self._noise: Noise = (
            acceleration_noise * acceleration_noise, reversal_noise * reversal_noise, bias_noise * bias_noise,
            coulomb_noise * coulomb_noise, viscous_noise * viscous_noise, mass_noise * mass_noise,
        )  # fmt: skip
        self._measurement = measurement_noise * measurement_noise
        # What the model may be wrong by before anything is known. What holds an axis still looks like friction until it
        # has moved both ways: bias must stay within what gravity or the drive's offset can be.
        bias: Number = BIAS_PART * (abs(model.gravity) + model.coulomb) if bias_prior is None else bias_prior
        dry: Number = DRY_PART * model.coulomb + SMALL_PART * force_limit if coulomb_prior is None else coulomb_prior
        wet: Number = abs(model.viscous) + model.mass if viscous_prior is None else viscous_prior
        inertia: Number = 0.5 * model.mass if mass_prior is None else mass_prior
        prior = (measurement_noise, PRIOR_SPEED, bias, dry, wet, inertia)
        self._prior = diagonal(*(value * value for value in prior))
        zero = zeros_like(model.mass)
        self._breakaway = Breakaway(zero + breakaway_rate, zero + breakaway_lag)
        speed = zero + stribeck_velocity
        self._peaked = speed > 0.0
        self._has_peak = anywhere(self._peaked)
        self._slowness = 1.0 / select(self._peaked, speed, 1.0)
        self._bounds: Disturbance = (force_limit, force_limit, force_limit, 0.9 * model.mass)
        self.reset(zeros_like(model.mass), model.gravity)

    def reset(self, position: Number, force: Number) -> None:
        """At rest, without error; what `force` has beyond the gravity hold is taken as bias."""
        zero = zeros_like(position)
        bias = bounded(zero + (force - self._model.gravity), self._bounds[0])
        self._error, self._rate = zero, zero  # at the newest sample, as all that follows
        self._disturbance: Disturbance = (bias, zero, zero, zero)
        self._covariance: Covariance = self._prior
        self._position, self._velocity = zero, zero  # of the reference
        self._breakaway.reset(zero + position)
        self._begun = False
        self._acting = zero + force  # in the interval before the newest sample

    @property
    def error_rate(self) -> Number:
        """Rate of the error at the newest sample, estimated (m/s)."""
        return self._rate

    def _acted(self, inputs: LawInputs) -> tuple[Number, Number]:
        """The forces that acted before the newest sample and after it."""
        before, last = self._acting, inputs.force_last
        if not self._begun:
            # The axis rests, held by its drive or brake until the first command arrives; so does the reference.
            last = before
            sample = inputs.sample
            self._position, self._velocity = sample.position, sample.velocity
            self._begun = True
        # Where no axis answered, the command was lost, and drives hold the force before it.
        last = select(inputs.answered != 0.0, last, before)
        self._acting = copy(last)
        return before, last

    def _friction(self, mean_sign: Number, mean_velocity: Number) -> Number:
        """Nominal friction and gravity hold, N."""
        model = self._model
        dry = model.coulomb * mean_sign + model.gravity
        return dry + (model.viscous + model.quadratic * abs(mean_velocity)) * mean_velocity

    def _third(self, mean_sign: Number, mean_velocity: Number) -> Number:
        """What theta2 multiplies."""
        if not self._has_peak:
            return mean_velocity
        shape = peak(mean_sign, mean_velocity, self._slowness)
        return shape if self._peaked is True else select(self._peaked, shape, mean_velocity)

    def force(self, inputs: LawInputs) -> Number:
        """Filter the sample in, look ahead to `start`, feed forward what is known and feed back what is left."""
        force_before, force_last = self._acted(inputs)
        error, rate, d = self._correct(inputs, force_before)
        model = self._model
        mass, coulomb = model.mass, model.coulomb + d[1]
        sample, start = inputs.sample, inputs.start
        coming = interval(mass, coulomb, inputs.ahead, sample.position, sample.velocity, start.position, start.velocity)
        _, _, _, _, s, v, a, stuck, _ = coming
        net = force_last - self._friction(s, v) - force_of(d, s, self._third(s, v), a) - stuck
        error, rate = move(error, rate, net, self._inverse_mass, coming)
        # An axis that waited for its reversal has the speed still to gain that the reference has already: `stuck`.
        s, _, _ = mean_sign_over(start.velocity, inputs.end.velocity, self._period, mass, coulomb)
        v, a = inputs.mean_velocity, inputs.mean_acceleration
        known = mass * a + stuck + self._friction(s, v) + force_of(d, s, self._third(s, v), a)
        return known - self.stiffness * error - self.damping * rate

    def _correct(self, inputs: LawInputs, force_before: Number) -> tuple[Number, Number, Disturbance]:
        """Predict to the newest sample and learn from it: error, its rate and the disturbance there."""
        rate, d, kept, q0, v0 = self._rate, self._disturbance, self._covariance, self._position, self._velocity
        model, inverse_mass, sample = self._model, self._inverse_mass, inputs.sample
        q1, v1 = sample.position, sample.velocity
        past = interval(model.mass, model.coulomb + d[1], inputs.sample_interval, q0, v0, q1, v1)
        time, moved, _, _, sign, v, a, _, _ = past
        bias, dry, wet, inertia = d
        third = self._third(sign, v)
        sliding, driving = dry, wet * third
        if self._has_peak:  # a peak of friction holds as friction does
            shape = peak(1.0, v, self._slowness)
            sliding = select(self._peaked, at_least(dry + wet * shape, -model.coulomb), dry)
            driving = select(self._peaked, 0.0, driving)
        push = force_before - self._friction(0.0, v) - (bias + driving + inertia * a)
        end, way = slide(rate + v0, push, model.coulomb + sliding, time, inverse_mass)
        error, rate = self._error + (way - moved), end - v1
        expected = predict(kept, self._noise, inverse_mass, past, third)
        covariance, (k0, k1, k2, k3, k4, k5) = update(expected, self._measurement, inputs.fresh)
        innovation = (inputs.position - q1) - error
        error = error + k0 * innovation
        rate = rate + k1 * innovation
        limit, dry_limit, wet_limit, inertia_limit = self._bounds
        learnt: Disturbance = (
            bounded(bias + k2 * innovation, limit),
            at_least(bounded(dry + k3 * innovation, dry_limit), -model.coulomb),  # friction never drives
            bounded(wet + k4 * innovation, wet_limit),
            bounded(inertia + k5 * innovation, inertia_limit),
        )
        if self._breakaway.ever:
            rests, holds, position = self._breakaway.watch(inputs.position, inputs.fresh, v0, v1)
            if anywhere(rests):
                covariance = keep_disturbance(covariance, expected, rests)
            if anywhere(holds):
                lag = position - q1
                error, rate = select(holds, lag, error), select(holds, -v1, rate)
                learnt = self._crept(holds, lag, inputs, learnt)
                covariance = choose(holds, standing(kept, self._measurement), covariance)
        self._error, self._rate, self._disturbance, self._covariance = error, rate, learnt, covariance
        self._position, self._velocity = copy(q1), copy(v1)
        return error, rate, learnt

    def _crept(self, holds: Any, lag: Number, inputs: LawInputs, learnt: Disturbance) -> Disturbance:
        """d where the axis holds: what it was before this sample, and more of what is missing."""
        bias, dry, wet, inertia = self._disturbance
        velocity, time = inputs.sample.velocity, inputs.sample_interval
        more_bias, more_dry = self._breakaway.creep(lag, velocity, time, self._covariance)
        bias, dry = bounded(bias + more_bias, self._bounds[0]), bounded(dry + more_dry, self._bounds[1])
        b, d, w, i = learnt
        return select(holds, bias, b), select(holds, dry, d), select(holds, wet, w), select(holds, inertia, i)
