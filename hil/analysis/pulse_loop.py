"""The rig's own filter and law around a linear axis, in error coordinates: what the loop answers to a pulse.

The law's code is not transcribed into equations: a unit pulse is added to one axis' measured position and the loop (rig
filter, law, zero-order hold, plant) answers. All plants run at once, as rows of one batch.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from hil.analysis.flexible_plant import AxisDynamics, FlexiblePlant
from hil.control.estimator import behind_estimator
from hil.control.estimator.gains import design_gains
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws import make_law
from hil.control.laws.base import Array, LawInputs, Model, Reference, axis_model
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


def nominal_plant(model: Model, period: float, shape: tuple[int, ...], gain: float | Array = 1.0) -> Plant:
    """The axes as the model says, without friction; lag and modes of those that have a mode. A law that lives on its
    mode is unstable on a rigid axis. gain: nominal mass over the true one, for all axes or each (n_axes,).
    """
    mass = model.mass / gain
    axes = [_nominal_axis(axis_model(model, i), own) for i, own in enumerate(mass.tolist())]
    if not any(axis.mode_hz or axis.others for axis in axes):
        return RigidPlant(mass, period, shape)
    return FlexiblePlant([axes] * shape[0], period)


def _nominal_axis(model: Model, mass: float) -> AxisDynamics:
    first = model.mode_frequency, model.mode_damping, model.mode_load
    second = model.second_frequency, model.second_damping, model.second_load
    third = model.third_frequency, model.third_damping, model.third_load
    others = tuple([mode for mode in (second, third) if mode[0]])
    return AxisDynamics(mass, model.torque_lag, *first, others=others) if first[0] or others else AxisDynamics(mass)


class PulseLoop:
    """Filter and law as in the cycle, around m a = force - (what the reference needs).

    Rows: `copies` plants, each with one row in which all axes are pulsed, or one for each axis where the law looks at
    all. A last row is left alone. speed: of the reference, m/s, (copies,) or one; 0: it rests.
    """

    def __init__(self, rig: RigConfig, model: Model, copies: int = 1, speed: float | Array = CRUISE) -> None:
        n = model.mass.size
        self.copies, self.period = copies, rig.period_ns * 1e-9
        gains, _ = design_gains(rig)
        self._filter = MotionFilter(list(gains), model.mass)
        limit = np.array([axis.limits.force for axis in rig.axes.values()])
        # What it has learnt is a force of its own, and no part of what it makes of an error.
        plain = rig.law.model_copy(update={"iterative_learning": False, "learnt": "", "learnt_state": []})
        self._law = behind_estimator(make_law(plain, model, self.period, limit), rig, model, range(n))
        self._pulsed = np.arange(n) if self._law.coupled else np.zeros(n, dtype=int)  # the row, for each axis
        self._folded = (copies, int(self._pulsed.max()) + 2, n)
        self.shape = shape = (copies * self._folded[1], n)
        self._inputs: LawInputs = blank_inputs(shape)
        self._inputs.fresh = np.ones(n)
        self._inputs.sample_interval = self._inputs.ahead = np.full(n, self.period)
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
        self.plant = nominal_plant(model, self.period, shape)
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

    def beyond(self, errors: Array) -> Array:
        """Of every axis where it is pulsed, beyond the copy left alone, in pulses, (copies, n_axes)."""
        folded = errors.reshape(self._folded)
        answer: Array = (folded[:, self._pulsed, np.arange(self._folded[2])] - folded[:, -1]) / PULSE
        return answer

    def alone(self, errors: Array) -> Array:
        """Of the rows left alone, (copies, n_axes)."""
        left: Array = errors.reshape(self._folded)[:, -1]
        return left

    def rows(self, values: Array, copies: slice) -> Array:
        """Of these copies, all rows alike, (copies, rows of each, n_axes)."""
        own: Array = values.reshape(self._folded)[copies]
        return own

    def _reference(self) -> None:
        inputs, k = self._inputs, self._index
        for reference, instant in ((inputs.sample, k - 1), (inputs.start, k), (inputs.end, k + 1)):
            reference.position = self._speed * self.period * instant
            reference.velocity = self._speed.copy()
            reference.acceleration = np.zeros(self._needed.shape)
        if self._law.preview:
            still = np.zeros(self._needed.shape)
            inputs.preview = [
                Reference(self._speed * self.period * (k + ahead), self._speed.copy(), still.copy())
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
        return self.plant.error + self.plant.rate * self.period


class Trial(Protocol):
    """What some copies of a loop, next to each other, are tried for once it has settled.

    speed: of their reference, m/s, (copies,), for who makes the loop.
    """

    copies: int
    speed: Array

    def begin(self, pulse: Array, period: float) -> tuple[Plant, Array]:
        """Their plant from then on, and what is added to their first measurement, m. pulse: PULSE on every axis where
        it is pulsed, (rows, n_axes); period: s.
        """

    def note(self, tick: int, loop: PulseLoop, errors: Array, own: slice) -> bool:
        """A tick, from 0 on, with its measured errors, (rows, n_axes) of the loop; own: the trial's copies. Whether it
        has seen enough.
        """


class _Plants:
    """The plants of a loop's trials, as one."""

    def __init__(self, plants: Sequence[Plant], edges: Sequence[int]) -> None:
        self._plants, self._edges = list(plants), list(edges)

    @property
    def error(self) -> Array:
        """See Plant."""
        return np.concatenate([plant.error for plant in self._plants])

    @property
    def rate(self) -> Array:
        """See Plant."""
        return np.concatenate([plant.rate for plant in self._plants])

    def advance(self, force: Array) -> None:
        """See Plant."""
        for plant, part in zip(self._plants, np.split(force, self._edges), strict=True):
            plant.advance(part)

    def place(self, error: Array, rate: Array) -> None:
        """See Plant."""
        parts = zip(self._plants, np.split(error, self._edges), np.split(rate, self._edges), strict=True)
        for plant, error_part, rate_part in parts:
            plant.place(error_part, rate_part)


def loop_of(rig: RigConfig, trials: Sequence[Trial]) -> PulseLoop:
    """A loop with the copies of these trials, in their order."""
    speed = np.concatenate([trial.speed for trial in trials])
    return PulseLoop(rig, rig_model(rig), speed.size, speed)


def try_together(loop: PulseLoop, trials: Sequence[Trial]) -> None:
    """Settle the loop, then try its copies, which are the trials' in their order: the law's lines cost as much for ten
    rows as for a hundred. Before, it settles on the nominal plant from a start that no rig has, at full speed.
    """
    per_copy, period = loop.shape[0] // sum(trial.copies for trial in trials), loop.period
    edges = np.cumsum([trial.copies for trial in trials])[:-1]
    owned = [slice(*ends) for ends in zip([0, *edges], [*edges, None], strict=True)]
    pulses = np.split(loop.pulse(), edges * per_copy)
    begun = [trial.begin(part, period) for trial, part in zip(trials, pulses, strict=True)]
    plant: Plant = begun[0][0] if len(begun) == 1 else _Plants([own for own, _ in begun], (edges * per_copy).tolist())
    quiet, pulse = np.zeros(loop.shape), np.concatenate([added for _, added in begun])
    with np.errstate(all="ignore"):
        for _ in range(SETTLE):
            loop.step(quiet)
        loop.change_plant(plant)
        tick, left = 0, list(zip(trials, owned, strict=True))
        while left:
            errors = loop.step(pulse if tick == 0 else quiet)
            left = [(trial, own) for trial, own in left if not trial.note(tick, loop, errors, own)]
            tick += 1


class Pulsed:
    """A unit pulse on an axis' own measurement. `answer`: its measured error, `motion`: its true error moved on by one
    period at its rate, each (ticks, copies, n_axes).

    A force that alternates from tick to tick shows in the speed alone, as every sample falls on a node of the position.
    plant: from the pulse on, for so many rows. Both less those of a loop without the pulse: an integrator or an
    observer that has not settled yet still moves. Zero from where less than `faded` of a pulse is left. Infinite where
    the loop circles by itself. kicked: the last copy gets a unit kick in place of the pulse: one pulse a period faster,
    of a force of an instant.
    """

    def __init__(
        self,
        plant: Callable[[int], Plant],
        copies: int,
        ticks: int,
        *,
        speed: float | Array = CRUISE,
        faded: float = FADED,
        kicked: bool = False,
    ) -> None:
        self.copies, self._plant, self._ticks, self._faded, self._kicked = copies, plant, ticks, faded, kicked
        self.speed: Array = np.broadcast_to(speed, copies)
        self._alone = self.answer = self.motion = np.zeros(0)

    def begin(self, pulse: Array, period: float) -> tuple[Plant, Array]:
        """See Trial."""
        self.answer, self.motion, self._alone = np.zeros((3, self._ticks, self.copies, pulse.shape[1]))
        plant = self._plant(len(pulse))
        if not self._kicked:
            return plant, pulse
        kick, pulse, last = np.zeros(pulse.shape), pulse.copy(), -(len(pulse) // self.copies)
        kick[last:], pulse[last:] = pulse[last:] / period, 0.0
        return _Kicked(plant, kick), pulse

    def note(self, tick: int, loop: PulseLoop, errors: Array, own: slice) -> bool:
        """See Trial."""
        answer, motion, alone = self.answer, self.motion, self._alone
        answer[tick], alone[tick] = loop.beyond(errors)[own], loop.alone(errors)[own]
        motion[tick] = loop.beyond(loop.motion())[own]
        over, latest = tick + 1 == self._ticks, slice(tick + 1 - LOOKED, tick + 1)
        if tick % LOOKED == LOOKED - 1 and _left(answer[latest], motion[latest], alone[latest]) < self._faded:
            alone[tick + 1 :] = alone[tick]
            over = True
        if over:
            unseen = _circles(alone) & (np.abs(motion).max(axis=0) < GROWN)
            answer[:, unseen] = motion[:, unseen] = np.inf
        return over


class PlantAround:
    """Another plant; a subclass changes what is asked of it."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    @property
    def error(self) -> Array:
        """See Plant."""
        return self._plant.error

    @property
    def rate(self) -> Array:
        """See Plant."""
        return self._plant.rate

    def advance(self, force: Array) -> None:
        """See Plant."""
        self._plant.advance(force)

    def place(self, error: Array, rate: Array) -> None:
        """See Plant."""
        self._plant.place(error, rate)


class _Kicked(PlantAround):
    """A plant that begins faster than it is asked to."""

    def __init__(self, plant: Plant, kick: Array) -> None:
        super().__init__(plant)
        self._kick = kick

    def place(self, error: Array, rate: Array) -> None:
        """See Plant."""
        super().place(error, rate + self._kick)


def responses(loop: PulseLoop, plant: Plant, ticks: int) -> tuple[Array, Array]:
    """Answer and motion of Pulsed, where all of a loop's copies get that."""
    pulsed = Pulsed(lambda _: plant, loop.copies, ticks)
    try_together(loop, [pulsed])
    return pulsed.answer, pulsed.motion


def pulse_response(rig: RigConfig, ticks: int, plant_gain: float | Array = 1.0) -> tuple[Array, Array]:
    """`responses`, (ticks, n_axes), on the nominal plant. plant_gain: as in `nominal_plant`."""
    model = rig_model(rig)
    loop = PulseLoop(rig, model)
    plant = nominal_plant(model, loop.period, loop.shape, plant_gain)
    answer, motion = responses(loop, plant, ticks)
    return answer[:, 0], motion[:, 0]


def pulse_and_kick(rig: RigConfig, ticks: int, beside: Sequence[Trial] = ()) -> tuple[Array, Array, Array]:
    """As `pulse_response` on the nominal plant, and the motion after a kick, each (ticks, n_axes). beside: other trials
    of the rig's loop, which cost next to nothing here.
    """
    model = rig_model(rig)

    def nominal(rows: int) -> Plant:
        return nominal_plant(model, rig.period_ns * 1e-9, (rows, model.mass.size))

    pulsed = Pulsed(nominal, 2, ticks, kicked=True)
    try_together(loop_of(rig, [pulsed, *beside]), [pulsed, *beside])
    return pulsed.answer[:, 0], pulsed.motion[:, 0], pulsed.motion[:, 1]


def _left(answer: Array, motion: Array, alone: Array) -> float:
    """What is left of the pulse in these ticks, of it, or what the loop left alone swings."""
    return float(max(np.abs(answer).max(), np.abs(motion).max(), np.abs(np.diff(alone, 2, axis=0)).max() / PULSE))


def _circles(error: Array) -> Any:
    """Where a loop moves to and fro by itself, of its errors (ticks, ...): a limit cycle forgets a pulse as a stable
    loop does. Second differences, for a slow integrator may still be on its way.
    """
    swing = np.abs(np.diff(error, 2, axis=0))
    quarter = max(len(swing) // 4, 1)
    bearable = np.maximum(PULSE, DECAYED * swing[:quarter].max(axis=0))
    return np.logical_not(swing[-quarter:].max(axis=0) <= bearable)
