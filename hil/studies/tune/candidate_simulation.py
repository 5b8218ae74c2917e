"""Many candidates for one axis' gains, each on many trials at once: one batch of arrays (candidates, trials, 1).

As hil/virtual/batch.py, with three differences. Every plant has a reference of its own, so that tasks of all kinds run
side by side. A command can be late (jitter) or lost; and one axis runs alone, as axes do not interact. References are
worked out once and serve every generation of a search.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from hil.control.estimator import behind_estimator
from hil.control.estimator.gains import design_gains, per_axis
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws import law_on_arrays
from hil.control.laws.base import Array, LawInputs, Model, Reference
from hil.control.nominal_model import blank_inputs, rig_model
from hil.control.setpoints import nominal_net_force
from hil.control.trajectories import Trajectory, make_trajectory
from hil.control.trajectories.base import Times
from hil.cycle.limits import force_limits
from hil.rig.schema import LawConfig, RigConfig
from hil.virtual.batch import Bounds, sent, standing
from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Truth
from sim_plant.user_stage import stage_of

LOST = 1.0  # m: error of a candidate that diverged
STAMP_NS = 1_000  # the drives' clock
STEADY_TICK = 5  # commands before this one arrive and on time: the axes are being enabled


class Trial(NamedTuple):
    """A task on a plant under a disturbance, and what counts as good there.

    task: overrides of the rig's own. mass, friction: scales of the plant's; error: on top of its friction, as a part of
    the force limit.
    jitter: s, delay of a command, uniform in [0, 2 jitter]. loss: part of commands that never arrive. good: error in
    encoder counts, the largest one met or, with `rms`, its RMS. plant: overrides of [plant]. step: N, a constant force
    that begins in the middle of what is judged. brief: judged over the window of its own task alone, of which the first
    `learns` seconds do not count.
    """

    name: str
    task: Mapping[str, Any]
    good: float
    mass: float = 1.0
    friction: float = 1.0
    error: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    rms: bool = False
    plant: Mapping[str, Any] = MappingProxyType({})
    step: float = 0.0
    brief: bool = False
    learns: float = 0.0


class Figures(NamedTuple):
    """Of every candidate and trial (candidates, trials): largest and RMS error, m; RMS change of force a tick, N. ever:
    largest error of the whole run, what is not judged as well, m.
    """

    largest: Array
    rms: Array
    chatter: Array
    ever: Array


class Schedule:
    """When commands arrive, (ticks + 1, trials) ns, and which do not; drawn from `seed`, so the same for every rig.
    Trials of the same jitter have the same delays, so that their plants can move together. Trials of the same loss lose
    the same commands: one lost just where a figure reverses costs any law friction T^2 / m, and says nothing of gains.
    """

    def __init__(self, trials: Sequence[Trial], ticks: int, period_ns: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        shape = (ticks + 1, len(trials))
        self.jitter = jitter = np.array([trial.jitter for trial in trials])
        loss = np.array([trial.loss for trial in trials])
        delay = rng.random(shape)[:, _first_alike(jitter)] * (2e9 * jitter)
        lost = rng.random(shape)[:, _first_alike(loss)] < loss
        lost[1:] &= ~lost[:-1]  # two in a row may be a fault, and then no law matters
        lost[:STEADY_TICK] = False
        self.lost = lost
        self.delay = np.rint(delay / STAMP_NS).astype(np.int64) * STAMP_NS
        self.arrival = self.delay + np.arange(ticks + 1)[:, None] * period_ns
        self.latency = np.array([round(trial.jitter * 1e9) for trial in trials])
        self.regular = not self.delay.any()


def _first_alike(values: Array) -> Any:
    """For each of (n,) values, where the first one equal to it is."""
    _, first, alike = np.unique(values, return_index=True, return_inverse=True)
    return first[alike]


def validated_plant(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Values of [plant]'s keys, of the types that a rig file would give them."""
    plant = PlantConfig.model_validate(dict(changes))
    return {name: getattr(plant, name) for name in changes}


class _Table:
    """Position and velocity of every trial's reference at given task times, arrays (ticks, 1, trials, 1)."""

    def __init__(self, trajectories: Sequence[Trajectory], times: Times, axis: int, n_axes: int) -> None:
        shape = (len(times), 1, len(trajectories), 1)
        self.position, self.velocity, self.acceleration = np.empty(shape), np.empty(shape), np.empty(shape)
        for index, trajectory in enumerate(trajectories):
            column = np.repeat(times[:, index, None], n_axes, axis=1)
            reference = trajectory.sample(column)
            self.position[:, 0, index, 0] = reference.position[:, axis]
            self.velocity[:, 0, index, 0] = reference.velocity[:, axis]
            self.acceleration[:, 0, index, 0] = reference.acceleration[:, axis]

    def fill(self, reference: Reference, tick: int) -> None:
        reference.position, reference.velocity = self.position[tick], self.velocity[tick]
        reference.acceleration = self.acceleration[tick]


class CandidateSimulation:
    """One axis of a rig on a set of trials, from activation on. Figures are of its ticks `first` <= tick < `last`,
    which None takes from every trial's own task: from where its statistics begin until it ends. preview: periods that
    laws may look ahead.
    """

    def __init__(
        self, rig: RigConfig, axis: int, trials: Sequence[Trial], first: int | None, last: int | None, seed: int,
        *, preview: int = 0,
    ) -> None:  # fmt: skip
        n = len(rig.axes)
        self._rig, self._axis = rig, axis
        self._period = rig.period_ns * 1e-9
        pick = slice(axis, axis + 1)
        whole = rig_model(rig)
        self.model = Model(*(getattr(whole, field.name)[pick] for field in fields(Model)))
        self.limit = np.array([[*rig.axes.values()][axis].limits.force])
        gains, _ = design_gains(rig)
        self._gains = list(gains[:, pick])
        self._limits = [force_limits(rig)[axis]]
        self._nominal_resolution = [*rig.axes.values()][axis].encoder_resolution
        self._resolution = float(per_axis(rig.plant.encoder_resolution, n)[axis])
        initial = per_axis(rig.plant.initial_position, n)
        self._initial = float(initial[axis])
        self._truths = [self._truth(trial, pick) for trial in trials]
        origin = np.rint(initial / self._resolution) * self._nominal_resolution
        self.origin = float(origin[axis])
        tasks = [rig.task.model_copy(update=dict(trial.task)) for trial in trials]
        paths = [make_trajectory(task, rig.axis_names, origin, rig.period_ns, rig.counts) for task in tasks]
        begins = [
            (path.steady_from_ns + round(trial.learns * 1e9)) // rig.period_ns + 1 if first is None else first
            for path, trial in zip(paths, trials, strict=True)
        ]
        once = [(path.repeat_ns or 0) // rig.period_ns for path in paths]  # of a task that has no end
        ends = [
            last or (path.duration_ns // rig.period_ns + 1 if path.duration_ns else begin + ticks)
            for path, begin, ticks in zip(paths, begins, once, strict=True)
        ]
        self._window = np.array(begins), np.array(ends)
        self.steps = np.array([trial.step for trial in trials])  # N
        self.steps_at = np.where(self.steps != 0.0, (self._window[0] + self._window[1]) // 2, -1)  # ticks
        self._ticks = ticks = int(self._window[1].max())
        self.schedule = schedule = Schedule(trials, ticks, rig.period_ns, seed)
        # Instants of the samples, and the regular grid on which forces are expected to begin, from one tick before the
        # first; the task's clock starts in tick 1, where commands are expected at the latency.
        starts = schedule.latency + rig.period_ns
        grid = np.arange(-1, ticks + 1 + preview)[:, None] * rig.period_ns + schedule.latency - starts
        self._grid = _Table(paths, grid, axis, n)
        self._samples = self._grid if schedule.regular else _Table(paths, self._instants() - starts, axis, n)

    def _truth(self, trial: Trial, pick: slice) -> Truth:
        plant = self._rig.plant
        change = {
            "mass_scale": plant.mass_scale * trial.mass,
            "friction_scale": plant.friction_scale * trial.friction,
            "modelling_error": np.add(plant.modelling_error, trial.error * self.limit[0]).tolist(),
            **validated_plant(trial.plant),
        }
        whole = Truth.from_config(plant.model_copy(update=change), len(self._rig.axes), self._rig.axis_names)
        return Truth(**{name: getattr(whole, name)[pick] for name in Truth.__dataclass_fields__})

    def _instants(self) -> Times:
        """Of the sample that tick k works on, (ticks + 2, trials) ns: where command k - 1 arrived, or should have."""
        schedule, period = self.schedule, self._rig.period_ns
        instants = np.empty((self._ticks + 2, schedule.lost.shape[1]), dtype=np.int64)
        instants[0] = schedule.arrival[0] - period
        instants[1:] = schedule.arrival
        for tick in range(1, self._ticks + 2):
            lost = schedule.lost[tick - 1]
            instants[tick, lost] = instants[tick - 1, lost] + period
        return instants

    def run(self, law: LawConfig, gains: Mapping[str, Array], fixed: Mapping[str, Any] | None = None) -> Figures:
        """gains: (candidates,) each, none: one candidate with the law's defaults; fixed: words, and what all candidates
        share. Figures (candidates, trials).
        """
        candidates = next(iter(gains.values())).size if gains else 1
        shape = (candidates, len(self._truths), 1)
        columns = {name: values.reshape(candidates, 1, 1) for name, values in gains.items()}
        each = law_on_arrays(law)(self.model, self._period, self.limit, **columns, **(fixed or {}))
        each = behind_estimator(each, self._rig, self.model, [self._axis])
        return _Run(self, each, _Plants(self, candidates), shape).figures()


class _Plants:
    """Stages of all candidates and trials: one for every jitter."""

    def __init__(self, of: CandidateSimulation, candidates: int) -> None:
        jitter = of.schedule.jitter
        self._groups = [np.flatnonzero(jitter == each) for each in np.unique(jitter)]
        self._stages = []
        for group in self._groups:
            truth = Truth.stack([Truth.stack([of._truths[index] for index in group])] * candidates)
            self._stages.append(stage_of(of._rig.plant, truth, np.full(truth.shape, of._initial)))
        self._arrival, self._brakes_open_on_it = of.schedule.arrival, of._rig.opening_ticks > 0
        self._steps, self._steps_at = of.steps, of.steps_at
        self.position: Array = np.full((candidates, len(of._truths), 1), of._initial)  # true
        self.shown: Array = self.position.copy()  # by the encoders
        self.look()

    def look(self) -> None:
        """Read the encoders: each reading has noise of its own."""
        for group, stage in zip(self._groups, self._stages, strict=True):
            self.shown[:, group] = stage.read()

    def stand(self, force: Array) -> None:
        """Brakes open on this force (N)."""
        if self._brakes_open_on_it:
            for group, stage in zip(self._groups, self._stages, strict=True):
                stage.stand(force[:, group])

    def advance(self, tick: int, force: Array) -> None:
        """From the arrival of command tick - 1 to that of command tick, under `force` (N)."""
        for group, stage in zip(self._groups, self._stages, strict=True):
            begun = self._steps_at[group] == tick
            if begun.any():
                step = np.where(begun, self._steps[group], 0.0)[:, None]
                stage.change(replace(stage.truth, bias=stage.truth.bias + step))
            duration = int(self._arrival[tick, group[0]] - self._arrival[tick - 1, group[0]])
            stage.advance(duration, force[:, group])
            self.position[:, group] = stage.position
        self.look()


class _Run:
    """The state of one batch while it runs."""

    def __init__(self, simulation: CandidateSimulation, law: Any, plants: _Plants, shape: tuple[int, ...]) -> None:
        self._of, self._law, self._stage = simulation, law, plants
        self._filter = MotionFilter(simulation._gains, simulation.model.mass)
        self._bounds = Bounds(simulation._limits)
        self._inputs: LawInputs = blank_inputs((1, 1, 1))
        if law.preview:
            self._inputs.preview = [blank_inputs((1, 1, 1)).start for _ in range(law.preview + 1)]
        zero = np.zeros(shape)
        self._net = [zero, zero]  # last, before
        start = zero + simulation.origin
        self._force = self._force_before = standing(simulation._rig, self._bounds, simulation.model.gravity, start)
        self._applied = sent(self._force)
        plants.stand(self._applied)
        self._error = zero
        self._instants = simulation._instants()

    def figures(self) -> Figures:
        of = self._of
        shape = self._force.shape
        largest, squares, changes, ever = (np.zeros(shape) for _ in range(4))
        first, last = (ticks[:, None] for ticks in of._window)
        with np.errstate(all="ignore"):
            for tick in range(of._ticks):
                before = self._force
                self._tick(tick)
                np.maximum(ever, np.abs(self._error), out=ever)
                counts = (first <= tick) & (tick < last)
                if counts.any():
                    largest = np.where(counts, np.maximum(largest, np.abs(self._error)), largest)
                    squares += np.where(counts, self._error * self._error, 0.0)
                    changes += np.where(counts, (self._force - before) ** 2, 0.0)
        count = last - first
        bad = ~(largest < LOST)
        ever = np.where(ever < LOST, ever, LOST)
        largest = np.where(bad, LOST, np.maximum(largest, 1e-12))
        rms = np.where(bad, LOST, np.sqrt(squares / count))
        chatter = np.where(bad, LOST, np.sqrt(changes / count))
        return Figures(largest[..., 0], rms[..., 0], chatter[..., 0], ever[..., 0])

    def _tick(self, tick: int) -> None:
        of, inputs, stage = self._of, self._inputs, self._stage
        self._times(tick)
        self._estimate()
        if tick == 0:
            self._filter.reseed(self._measured)
            self._law.reset(self._measured, of.model.gravity)
        self._reference(tick)
        inputs.position, inputs.force_before, inputs.force_last = self._measured, self._force_before, self._force
        self._filter.tell(inputs)
        asked = self._law.force(inputs)
        fresh = inputs.fresh != 0.0
        self._error = np.where(fresh, stage.position - inputs.sample.position, self._error)
        self._force_before = self._force
        self._force = self._bounds.limit(asked, self._force, self._measured)
        net = nominal_net_force(self._force, of.model, inputs.mean_velocity, inputs.mean_sign)
        self._net = [net, self._net[0]]
        if tick:  # until the first command arrives the brakes hold the stage
            stage.advance(tick, self._applied)
        else:
            stage.look()
        self._applied = np.where(of.schedule.lost[tick][:, None], self._applied, sent(self._force))

    def _times(self, tick: int) -> None:
        of, inputs, instants = self._of, self._inputs, self._instants
        before = instants[tick - 1] if tick else instants[0] - of._rig.period_ns
        start = tick * of._rig.period_ns + of.schedule.latency
        inputs.sample_interval = ((instants[tick] - before) * 1e-9)[None, :, None]
        inputs.ahead = ((start - instants[tick]) * 1e-9)[None, :, None]
        lost = of.schedule.lost[tick - 1] if tick else np.zeros(len(start), bool)
        inputs.fresh = np.where(lost, 0.0, 1.0)[None, :, None]
        inputs.answered = inputs.fresh

    def _estimate(self) -> None:
        of, motion, inputs = self._of, self._filter, self._inputs
        measured = np.rint(self._stage.shown / of._resolution) * of._nominal_resolution
        motion.correct(self._net[1], inputs.sample_interval, measured, inputs.fresh)
        self._measured = np.where(inputs.fresh != 0.0, measured, motion.position)
        motion.look_ahead(self._net[0], inputs.ahead)

    def _reference(self, tick: int) -> None:
        of, inputs = self._of, self._inputs
        of._samples.fill(inputs.sample, tick)
        of._grid.fill(inputs.start, tick + 1)
        of._grid.fill(inputs.end, tick + 2)
        for ahead, reference in enumerate(inputs.preview or ()):
            of._grid.fill(reference, tick + 1 + ahead)
        period, start, end = of._period, inputs.start, inputs.end
        inputs.mean_velocity = (end.position - start.position) / period
        inputs.mean_acceleration = (end.velocity - start.velocity) / period
        total = np.abs(start.velocity) + np.abs(end.velocity)
        inputs.mean_sign = (start.velocity + end.velocity) / np.maximum(total, 1e-300)
