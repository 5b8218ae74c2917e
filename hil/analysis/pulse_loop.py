"""The rig's own filter and law around a linear axis, in error coordinates: what the loop answers to a pulse.

The law's code is not transcribed into equations: a unit pulse is added to one axis' measured position and the loop (rig
filter, law, zero-order hold, plant) answers. All plants run at once, as rows of one batch.
"""

from typing import Any, Protocol

import numpy as np

from hil.control.estimator import behind_estimator
from hil.control.estimator.gains import design_gains
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws import make_law
from hil.control.laws.base import Array, LawInputs, Model, Reference
from hil.control.nominal_model import blank_inputs, rig_model
from hil.rig.schema import RigConfig

PULSE = 1e-8  # m: small enough for every law's linear range
SETTLE = 400  # ticks until time-varying filters have settled
CRUISE = 2.0**-5  # m/s: friction's sign is known, as in motion; a power of two keeps rounding out of the answer
GROWN = 1e3  # an answer beyond this many pulses has left the linear range
DECAYED = 0.5  # of its peak: the last quarter of a stable loop's answer
FADED = 1e-7  # of a pulse: an answer below it for LOOKED ticks is rounding, and nothing follows
LOOKED = 128


class Plant(Protocol):
    """Motion of the motor of every axis in every row, (rows, n_axes); linear, a force held over each period."""

    @property
    def error(self) -> Array:
        """m, at the sample."""

    @property
    def rate(self) -> Array:
        """m/s, at the sample."""

    def advance(self, force: Array) -> None:
        """On by one period under `force` (N)."""

    def place(self, error: Array, rate: Array) -> None:
        """Begin there: m and m/s."""


class RigidPlant:
    """m a = force: friction is left out, for what it does to a loop is damp it. mass: (n_axes,)."""

    def __init__(self, mass: Array, period: float, shape: tuple[int, ...]) -> None:
        self.mass, self._period = mass, period
        self.error, self.rate = np.zeros(shape), np.zeros(shape)

    def advance(self, force: Array) -> None:
        """On by one period."""
        change = force / self.mass * self._period
        self.error = self.error + (self.rate + 0.5 * change) * self._period
        self.rate = self.rate + change

    def place(self, error: Array, rate: Array) -> None:
        """Begin there."""
        self.error, self.rate = error.copy(), rate.copy()


class PulseLoop:
    """Filter and law as in the cycle, around m a = force - (what the reference needs).

    Rows: `copies` plants, each with one row in which all axes are pulsed, or one for each axis where the law looks at
    all. A last row is left alone. speed: of the reference, m/s, (copies,) or one; 0: it rests.
    """

    def __init__(self, rig: RigConfig, model: Model, copies: int = 1, speed: float | Array = CRUISE) -> None:
        n = model.mass.size
        self._period = rig.period_ns * 1e-9
        gains, _ = design_gains(rig)
        self._filter = MotionFilter(list(gains), model.mass)
        limit = np.array([axis.limits.force for axis in rig.axes.values()])
        plain = rig.law.model_copy(update={"iterative_learning": False})
        self._law = behind_estimator(make_law(plain, model, self._period, limit), rig, model, range(n))
        self._pulsed = np.arange(n) if self._law.coupled else np.zeros(n, dtype=int)  # the row, for each axis
        self._folded = (copies, int(self._pulsed.max()) + 2, n)
        self.shape = shape = (copies * self._folded[1], n)
        self._inputs: LawInputs = blank_inputs(shape)
        self._inputs.fresh = np.ones(n)
        self._inputs.sample_interval = self._inputs.ahead = np.full(n, self._period)
        of_rows = np.repeat(np.broadcast_to(speed, copies), self._folded[1])
        self._speed = np.broadcast_to(of_rows[:, None], shape)
        self._inputs.mean_velocity = self._speed
        self._inputs.mean_sign = sign = np.sign(self._speed)
        self._needed = (
            sign * model.coulomb
            + model.viscous * self._speed
            + model.quadratic * (self._speed * self._speed)
            + model.gravity
        )  # N, friction along the reference
        self.plant: Plant = RigidPlant(model.mass, self._period, shape)
        self._net = [np.zeros(shape) for _ in range(2)]  # force less what the reference needs: last, before
        self._index = 0
        self._filter.reseed(np.zeros(shape))
        self._law.reset(np.zeros(shape), model.gravity)

    def change_plant(self, plant: Plant) -> None:
        """Go on with another plant from where this one is: what settles in the law has settled before."""
        plant.place(self.plant.error, self.plant.rate)
        self.plant = plant

    def pulse(self) -> Array:
        """PULSE on every axis where it is pulsed, (rows, n_axes)."""
        folded = np.zeros(self._folded)
        folded[:, self._pulsed, np.arange(self._folded[2])] = PULSE
        return folded.reshape(self.shape)

    def kick(self, pulse: Array) -> Array:
        """A speed (m/s) in place of the pulse that the last copy would get, (rows, n_axes); takes it out of `pulse`."""
        last = slice((self._folded[0] - 1) * self._folded[1], None)
        kick = np.zeros(self.shape)
        kick[last] = pulse[last] / self._period
        pulse[last] = 0.0
        return kick

    def beyond(self, errors: Array) -> Array:
        """Of every axis where it is pulsed, beyond the copy left alone, in pulses, (copies, n_axes)."""
        folded = errors.reshape(self._folded)
        answer: Array = (folded[:, self._pulsed, np.arange(self._folded[2])] - folded[:, -1]) / PULSE
        return answer

    def alone(self, errors: Array) -> Array:
        """Of the rows left alone, (copies, n_axes)."""
        left: Array = errors.reshape(self._folded)[:, -1]
        return left

    def _reference(self) -> None:
        inputs, k = self._inputs, self._index
        for reference, instant in ((inputs.sample, k - 1), (inputs.start, k), (inputs.end, k + 1)):
            reference.position = self._speed * self._period * instant
            reference.velocity = self._speed.copy()
            reference.acceleration = np.zeros(self._needed.shape)
        if self._law.preview:
            still = np.zeros(self._needed.shape)
            inputs.preview = [
                Reference(self._speed * self._period * (k + ahead), self._speed.copy(), still.copy())
                for ahead in range(self._law.preview + 1)
            ]

    def step(self, pulse: Array) -> Array:
        """One tick with `pulse` (m) added to the measured error; the measured error."""
        inputs, motion = self._inputs, self._filter
        self._reference()
        last, before = self._net
        seen = self.plant.error + pulse
        inputs.position = inputs.sample.position + seen
        # The rig's filter works on the error here: the loop is linear, and the reference moves without acceleration.
        motion.correct(before, inputs.sample_interval, seen)
        motion.look_ahead(last, inputs.ahead)
        inputs.position_estimate = motion.ahead_position + inputs.start.position
        inputs.velocity_estimate = motion.ahead_velocity + inputs.start.velocity
        inputs.disturbance_estimate = motion.disturbance
        inputs.force_last, inputs.force_before = last + self._needed, before + self._needed
        asked = self._law.force(inputs) - self._needed
        self.plant.advance(last)  # the sample is from the start of the last period
        self._net = [asked.copy(), last]
        self._index += 1
        return seen

    @property
    def force(self) -> Array:
        """Asked for in the latest tick, beyond what the reference needs (N), (rows, n_axes)."""
        return self._net[0]

    def motion(self) -> Array:
        """True error after the latest tick, moved on by one period at its rate (m)."""
        return self.plant.error + self.plant.rate * self._period


def responses(loop: PulseLoop, plant: Plant, ticks: int, *, kicked: bool = False) -> tuple[Array, Array]:
    """After a unit pulse on an axis' own measurement: its measured error, and its motion, each (ticks, copies, n_axes).

    The motion is the true error moved on by one period at its rate. A force that alternates from tick to tick shows in
    the speed alone, as every sample falls on a node of the position. plant: from the pulse on; before, the loop settles
    on the rigid nominal one from a start that no rig has, at full speed. Both less those of a loop without the pulse:
    an integrator or an observer that has not settled yet still moves. Zero from where nothing is left of it. Infinite
    where the loop circles by itself. kicked: the last copy gets a unit kick in place of the pulse: one pulse a period
    faster, of a force of an instant.
    """
    pulse, quiet = loop.pulse(), np.zeros(loop.shape)
    kick = loop.kick(pulse) if kicked else quiet
    with np.errstate(all="ignore"):
        for _ in range(SETTLE):
            loop.step(quiet)
        loop.change_plant(plant)
        plant.place(plant.error, plant.rate + kick)
        answer, motion, alone = np.zeros((3, ticks, *loop.alone(quiet).shape))
        for k in range(ticks):
            errors = loop.step(pulse if k == 0 else quiet)
            answer[k], alone[k] = loop.beyond(errors), loop.alone(errors)
            motion[k] = loop.beyond(loop.motion())
            if k % LOOKED == LOOKED - 1 and _faded(*(part[k + 1 - LOOKED : k + 1] for part in (answer, motion, alone))):
                alone[k + 1 :] = alone[k]
                break
        unseen = _circles(alone) & (np.abs(motion).max(axis=0) < GROWN)
    answer[:, unseen] = motion[:, unseen] = np.inf
    return answer, motion


def pulse_response(rig: RigConfig, ticks: int, plant_gain: float | Array = 1.0) -> tuple[Array, Array]:
    """`responses`, (ticks, n_axes), on a rigid plant. plant_gain: nominal mass over the true one, for all axes or each
    (n_axes,).
    """
    model = rig_model(rig)
    loop = PulseLoop(rig, model)
    plant = RigidPlant(model.mass / plant_gain, rig.period_ns * 1e-9, loop.shape)
    answer, motion = responses(loop, plant, ticks)
    return answer[:, 0], motion[:, 0]


def pulse_and_kick(rig: RigConfig, ticks: int) -> tuple[Array, Array, Array]:
    """As `pulse_response` on the nominal plant, and the motion after a kick, each (ticks, n_axes)."""
    model = rig_model(rig)
    loop = PulseLoop(rig, model, copies=2)
    answer, motion = responses(loop, RigidPlant(model.mass, rig.period_ns * 1e-9, loop.shape), ticks, kicked=True)
    return answer[:, 0], motion[:, 0], motion[:, 1]


def _faded(answer: Array, motion: Array, alone: Array) -> bool:
    """Whether nothing is left of the pulse in these ticks, and the loop left alone does not swing."""
    left = max(np.abs(answer).max(), np.abs(motion).max(), np.abs(np.diff(alone, 2, axis=0)).max() / PULSE)
    return bool(left < FADED)


def _circles(error: Array) -> Any:
    """Where a loop moves to and fro by itself, of its errors (ticks, ...): a limit cycle forgets a pulse as a stable
    loop does. Second differences, for a slow integrator may still be on its way.
    """
    swing = np.abs(np.diff(error, 2, axis=0))
    quarter = max(len(swing) // 4, 1)
    bearable = np.maximum(PULSE, DECAYED * swing[:quarter].max(axis=0))
    return np.logical_not(swing[-quarter:].max(axis=0) <= bearable)
