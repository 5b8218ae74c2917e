"""Weights of presliding friction, and what the mass is off by: learnt from an observer's innovations in motion.

Written for floats and arrays. The regressors are the operators on the observed position, as the axis is not where its
reference is; what the innovation shows is the difference to what was fed forward, on the reference.

Where an innovation is biased, as by a mode that rings, thousands of fast short moves can lead the finest weight far
below zero. Learnt friction would then push behind a reversal, the integral through it would have the wrong sign, and an
axis at rest would creep. So the stiffness behind a reversal never falls below what it is taken for at the start.
"""

from hil.control.gain import TINIEST
from hil.control.laws.breakaway import anywhere
from hil.control.laws.motion_observer import Channel, Gains, MotionModel
from hil.control.laws.presliding_bank import Bank, averaged, moved, weighed
from hil.control.laws.weight_regression import Spread, Weights, diagonal, learnt
from hil.control.number import Number, at_least, bounded, copy, full_like, select, zeros_like

WEIGHTS = 7
RINGING = 2.0  # times what the throw makes the mode swing by: noise to the weights
STEP_FADE = 0.8  # of a rigid axis: what a period leaves of that noise
MOST_MASS = 0.5  # of the model's mass: what it may be off by

Deviations = tuple[Number, Number]  # of a weight of friction, N; of the mass, kg


class FrictionWeights:
    """Six weights of the operators of presliding_bank.py (N) and one of the mass (kg)."""

    def __init__(
        self, mass: Number, motion: MotionModel, slopes: Bank, play: Number, noise: Number, prior: Deviations,
        walk: Deviations, *, shaken: Number,
    ) -> None:  # fmt: skip
        """slopes: of the operators, 1/m. play: motion within it counts as noise, m. noise: of the force that they
        leave, N. prior, walk: standard deviations at the start, and gained in a period. shaken: times what a change of
        the reference's acceleration makes the mode swing by counts as noise. Of a rigid axis all counts that the step
        of force moves it by in a period.
        """
        self._motion, self._slopes, self._play = motion, slopes, play
        self._most_mass = MOST_MASS * mass
        rings, one = motion.swing > 0.0, full_like(mass, 1.0)
        self._shaken = select(rings, shaken * motion.swing, motion.e_d * one) * mass  # m per m/s^2
        self._fade = select(rings, motion.fade, STEP_FADE * one)
        noise = noise * motion.e_d
        self._noise = noise * noise
        self._prior, self._walk = _variances(prior), _variances(walk)
        self.reset(zeros_like(mass), zeros_like(mass))

    def reset(self, zero: Number, coulomb: Number) -> None:
        """Nothing is known but the model's Coulomb friction (N), on a coarse operator: what is not known yet is taken
        as soft, and never overshoots. zero: 0 for every axis.
        """
        self._softest = coulomb * self._slopes[4]  # N/m
        self._channels = [Channel(zero) for _ in range(WEIGHTS)]
        self._known = Channel(zero)
        self._place, self._ringing = zero, zero  # of the axis in its bank; of the mode, m
        self._measured: Bank = (zero, zero, zero, zero, zero, zero)  # operators on the axis
        none: Weights = (zero, zero, zero, zero, zero, zero, zero)
        self._coming, self._acting = none, none  # regressors of the interval after the sample, of that before it
        self._weights: Weights = (zero, zero, zero, zero, coulomb, zero, zero)
        self._spread: Spread = diagonal(self._prior)

    def begin_at(self, place: Number) -> None:
        """The axis rests there."""
        self._place = copy(place)

    def throw(self, force: Number) -> None:
        """A force (N) that steps up at once makes the mode ring."""
        self._ringing = (RINGING * self._motion.swing) * force

    def friction(self) -> Bank:
        """Weights of the operators, N."""
        w = self._weights
        return w[0], w[1], w[2], w[3], w[4], w[5]

    def calm(self) -> Number:
        """Share of an innovation's variance that the ringing mode has not made, 0 to 1."""
        noise, ringing = self._noise, self._ringing
        return noise / at_least(noise + ringing * ringing, TINIEST)

    def mass(self) -> Number:
        """What the mass is more than the model's, kg."""
        return self._weights[6]

    def values(self) -> list[Number]:
        """All of them."""
        return list(self._weights)

    def fill(self, values: list[Number]) -> None:
        """Begin with these."""
        self._weights = (values[0], values[1], values[2], values[3], values[4], values[5], values[6])

    def fed(self, z: Bank, acceleration: Number) -> None:
        """What is fed forward in the interval after the sample: operators on the reference, and its acceleration."""
        self._coming = (z[0], z[1], z[2], z[3], z[4], z[5], copy(acceleration))

    def learn(self, position: Number, innovation: Number, learn: Number, gains: Gains) -> None:
        """From the innovation (m) of the interval before the sample; `position` (m) of the axis, observed. learn: 1.0
        where there is something to learn, else 0.0. gains: those of the observer that made the innovation.
        """
        acting, motion = self._acting, self._motion
        way = position - self._place
        way = way - bounded(way, self._play)
        self._place = self._place + way
        begin, slope, w = self._measured, self._slopes, self._weights
        middle = moved(begin, slope, 0.5 * way)
        end = moved(middle, slope, 0.5 * way)
        self._measured = end
        z = averaged(begin, middle, end)
        weights = self.friction()
        fed: Bank = (acting[0], acting[1], acting[2], acting[3], acting[4], acting[5])
        known = self._known.innovation(weighed(weights, z) - weighed(weights, fed), motion, gains)
        c = self._channels
        r: Weights = (
            c[0].innovation(z[0], motion, gains), c[1].innovation(z[1], motion, gains),
            c[2].innovation(z[2], motion, gains), c[3].innovation(z[3], motion, gains),
            c[4].innovation(z[4], motion, gains), c[5].innovation(z[5], motion, gains),
            c[6].innovation(acting[6], motion, gains),
        )  # fmt: skip
        self._acting = self._coming
        ringing = self._ringing
        self._ringing = ringing * self._fade + self._shaken * abs(self._acting[6] - acting[6])
        if not anywhere(learn > 0.0):
            return
        noise = self._noise + ringing * ringing
        self._spread, k = learnt(self._spread, r, noise, self._walk, self._prior, learn)
        missing = innovation - known
        w0, w1, w2 = w[0] + k[0] * missing, w[1] + k[1] * missing, w[2] + k[2] * missing
        w3, w4, w5 = w[3] + k[3] * missing, w[4] + k[4] * missing, w[5] + k[5] * missing
        short = at_least(self._softest - weighed((w0, w1, w2, w3, w4, w5), slope), 0.0)
        mass = bounded(w[6] + k[6] * missing, self._most_mass)
        self._weights = (w0 + learn * short / slope[0], w1, w2, w3, w4, w5, mass)


def _variances(deviations: Deviations) -> Weights:
    friction, mass = deviations[0] * deviations[0], deviations[1] * deviations[1]
    return friction, friction, friction, friction, friction, friction, mass
