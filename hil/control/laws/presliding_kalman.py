"""PD plus feedforward for real guides: friction by the motion since the reversal, learnt while moving; lag and a
flexible mode inside the observer; a bias that is found.

    force = lag^-1 [(m + dm) a + viscous v + quadratic v |v| + gravity + sum w_i z_i(r + s) + wave(r) + table(r)]
            - Kp e - Kd e' + d

- z_i: operators of presliding friction (hil/control/laws/presliding_bank.py) on the reference r. s integrates the error
  through them: an integral whose loop gain does not depend on the guide's stiffness.
- At rest, where the floor or noise shakes the axis, its friction gives way for seconds. That is a ramp of the force,
  which s alone would follow with a steady error. So at rest s has a ramp of its own, which small errors feed.
- w_i and dm: by a Kalman filter on the observer's innovations (hil/control/laws/weight_regression.py), only while the
  reference moves. Its regressors are the operators on the observed position, as the axis is not where the reference is;
  but measured friction itself is never fed forward, which would be positive feedback with delay.
- wave(r): friction that varies with a period of the model too fine for the table (hil/control/laws/friction_wave.py).
- table: what the observer's disturbance d repeats along the travel, by direction (hil/control/laws/position_table.py).
  While the mode rings d follows it, and nothing is learnt: moves to and fro over one place would add it up.
- e, e', d: by a steady Kalman filter with lag and mode (hil/control/laws/motion_observer.py), predicted to where the
  force acts. It is the tool that follows: the encoder goes ahead of the reference by what the spring bends under its
  acceleration. At rest the axis hangs on its friction's stiffness, a mode of its own: unless it is known to be
  soft, the loop then takes gains that are stable on any.
- A change of the reference's acceleration makes the mode swing, too. To the weights that is noise while it rings: from
  fast moves they would else learn a friction that is too stiff. A rigid axis goes through all of its presliding in a
  few periods of such a move, and what lag and micro-slip then leave is far more than the noise of slow motion. Weights
  that took it for friction swung to ten times it, and the axis ended in SPEED or OSCILLATION. So the force's step is
  noise there, too.
- Where a weight hangs on the axis, its brake opens before the drive's force has come up over its lag, and throws it.
  That is a speed to the observer, and noise to the weights while the mode rings. Weights that take it for friction make
  it too stiff, and s, whose loop gain is that stiffness over the guide's, then rings at rest.
- Where the task repeats and law.iterative_learning says so, what d still is at each instant of it is fed forward in
  the next repeat (hil/control/laws/repeat_memory.py); weights and table stay as they are meanwhile. Where a repeat
  begins, d steps by what that force changes: else both would act until d has found out, which throws a light axis.

After the method of an independent study on LuGre and Maxwell-slip guides. Models: Canudas de Wit and others, IEEE TAC
40(3), 1995; Al-Bender, Lampaert, Swevers, IEEE TAC 50(11), 2005.
"""

from typing import Any, ClassVar

from hil.control.gain import TINIEST, Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.breakaway import anywhere
from hil.control.laws.friction_wave import WAVES, FrictionWave, fine
from hil.control.laws.friction_weights import WEIGHTS, FrictionWeights
from hil.control.laws.motion_observer import Channel, Gains, MotionModel, MotionObserver, as_designed
from hil.control.laws.other_modes import noises, slowed
from hil.control.laws.position_table import LAST_CELL, NODES, PositionTable
from hil.control.laws.presliding_bank import RATIO, Bank, averaged, moved, slopes, weighed
from hil.control.laws.presliding_gains import OF_MODE, of_model, swings_of
from hil.control.laws.repeat_memory import RepeatMemory
from hil.control.number import Number, at_least, at_most, bounded, copy, full_like, select, zeros_like

TAKEN_OVER, SEEN, STARTED = 1, 2, 3  # ticks: the drive takes over; what that did is seen
REST_PERIODS = 20.0  # until an axis counts as at rest
MOVED_PERIODS = 200.0  # in motion, until the friction's stiffness counts as known
STRETCH = 4.0  # s stays within this many times the coarsest reach
LEAST_PITCH = 1e-3  # m: of the table
TABLE_LIMIT, LARGEST_STEP = 0.5, 0.2  # of the friction; of the table's change in a period
CENTRE = 0.125
BESIDE_WAVE = 0.9  # of the bandwidth, on a flexible axis: learning a wave of friction costs 2 of the 30 degrees
CREEPING = 0.5  # of the finest reach: a larger error is an arrival or a step, after which a ramp would overshoot
KEPT = WEIGHTS + 2 * NODES + WAVES  # numbers of a learnt state before its force


def _of_model(unit: str, meaning: str, tune: Knob | None = None) -> Gain:
    return Gain(None, unit, meaning, tune=tune)


def _times(low: float, high: float) -> Knob:
    """Searched between so many times the gain that the law has by itself."""
    return Knob(low, high, "own")


class PreslidingKalman(Law):
    """Gains that are None follow from the model (hil/control/laws/presliding_gains.py). rest_...: while it
    rests.
    """

    own_estimate: ClassVar[bool] = True
    learns_repeats: ClassVar[bool] = True
    GAINS: ClassVar[dict[str, Gain]] = {
        "bandwidth": _of_model("rad", "natural frequency of the loop in motion times the period", _times(0.5, 2.0)),
        "damping": _of_model("1", "damping ratio in motion", _times(0.5, 2.0)),
        "force_noise": _of_model("1", "noise of the force in motion; see MotionModel.gains", _times(0.3, 3.0)),
        "disturbance_noise": _of_model(
            "1", "noise of the disturbance in motion; see MotionModel.gains", _times(0.3, 3.0)
        ),
        "rest_bandwidth": _of_model("rad", "natural frequency of the loop at rest times the period"),
        "rest_damping": _of_model("1", "damping ratio at rest"),
        "rest_force_noise": _of_model("1", "noise of the force at rest"),
        "rest_disturbance_noise": _of_model("1", "noise of the disturbance at rest"),
        "innovation_noise": _of_model(
            "1", "innovation that the weights leave, in parts of how far friction moves the axis", _times(0.5, 4.0)
        ),
        "integral": _of_model("1", "share of the error that s takes in a period", _times(0.3, 4.0)),
        "ramp": Gain(0.01, "1", "share of the error that s's ramp takes in a period at rest, if presliding is stated"),
        "table_delay": _of_model("1", "periods that the disturbance's estimate lags"),
        "mode_noise": _of_model("1", "noise of the mode; see MotionModel.gains", _times(0.3, 3.0)),
        "mode_share": _of_model("1", "of the mode's frequency: what the observer takes it for"),
        "shaken": _of_model(
            "1", "noise to the weights where the reference shakes the mode, in parts of what it makes that swing by"
        ),
        "soft_bandwidth": Gain(0.6, "rad", "an axis that rings below it on its friction's stiffness counts as soft"),
        "friction_prior": Gain(
            0.3, "1", "of a weight at the start, in parts of Coulomb friction", tune=_times(0.3, 4.0)
        ),
        "friction_walk": Gain(0.002, "1", "of a weight in a period, in parts of Coulomb friction"),
        "mass_prior": Gain(0.2, "1", "of the mass at the start, in parts of it"),
        "mass_walk": Gain(0.002, "1", "of the mass in a period, in parts of it"),
        "finest": Gain(
            0.3e-6,
            "m",
            "smallest reach of presliding friction; the coarsest is 200 times that",
            TINIEST,
            tune=_times(0.3, 3.0),
        ),
        "play": Gain(7.5e-9, "m", "motion within it counts as noise"),
        "table_pitch": Gain(
            None, "m", "distance of the table's nodes; 1 mm, or so far that it spans the travel", TINIEST
        ),
        "table_rate": Gain(0.8, "1", "share of the disturbance learnt on the way from node to node; 0: none"),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        designed: list[Number] = gains.pop("designed", [])
        given, shape = with_defaults(self.GAINS, gains), model.mass
        own = self.own_gains(model, period)

        def gain(name: str) -> Number:
            value: Number | None = given[name]
            return own[name] if value is None else full_like(shape, value)

        self._model, self._period, self._limit = model, period, full_like(shape, force_limit)
        if designed:
            self._motion, self._moving, self._resting = as_designed(model, period, gain("mode_share"), designed)
        else:
            self._motion = motion = MotionModel(model, period, gain("mode_share"))
            mode, others = gain("mode_noise"), noises(model, period)
            self._moving = motion.gains(gain("force_noise"), gain("disturbance_noise"), mode, others)
            less = own["rest_force_noise"] / own["force_noise"]
            others = [noise * less for noise in others]
            self._resting = motion.gains(gain("rest_force_noise"), gain("rest_disturbance_noise"), mode, others)
        omega, rest_omega = gain("bandwidth") * (1.0 / period), gain("rest_bandwidth") * (1.0 / period)
        soft_omega = gain("soft_bandwidth") * (1.0 / period)
        self.stiffness = shape * (omega * omega)
        self.damping = shape * (2.0 * gain("damping") * omega)
        self._rest_stiffness = shape * (rest_omega * rest_omega)
        self._rest_damping = shape * (2.0 * gain("rest_damping") * rest_omega)
        self._softness = 1.0 / (shape * (soft_omega * soft_omega))
        self._integral, self._creeping = gain("integral"), CREEPING * gain("finest")
        # On ideal friction, which gives way at once, an axis would hunt.
        guided = full_like(shape, model.presliding_greatest) > 0.0
        self._ramp = select(guided, gain("ramp"), zeros_like(shape))
        self._slopes: Bank = slopes(gain("finest"))
        self._most_shift = STRETCH * (gain("finest") * (RATIO * RATIO * RATIO * RATIO * RATIO))
        # Friction of the model, or what is not nothing against the force limit.
        self._dry = dry = at_least(full_like(shape, model.coulomb), 1e-3 * force_limit)
        self._weights = FrictionWeights(
            shape, self._motion, self._slopes, gain("play"), gain("innovation_noise") * dry,
            (gain("friction_prior") * dry, gain("mass_prior") * shape),
            (gain("friction_walk") * dry, gain("mass_walk") * shape), shaken=gain("shaken"),
        )  # fmt: skip
        self._pitch, self._table_limit = gain("table_pitch"), TABLE_LIMIT * dry
        self._table_gain = gain("table_rate") * (period / self._pitch)
        self._delay = gain("table_delay") * period
        self._wave = FrictionWave(full_like(shape, model.friction_period), self._pitch, dry, self._motion)
        self._memory: RepeatMemory | None = None
        self._kept: list[Number] = []  # weights and tables to begin with
        self.reset(zeros_like(shape), full_like(shape, model.gravity))

    @classmethod
    def own_gains(cls, model: Model, period: float) -> dict[str, Number]:
        """See Law."""
        shape, swings = model.mass, swings_of(model, period)
        guided, known = full_like(shape, model.presliding_greatest), full_like(shape, model.known)
        own = {name: of_model(name, swings, guided, known) for name in OF_MODE}
        own["table_pitch"] = at_least(full_like(shape, model.travel) * (1.0 / LAST_CELL), LEAST_PITCH)
        own = slowed(own, model, period)
        turns = (swings > 0.0) & fine(full_like(shape, model.friction_period), own["table_pitch"])
        own["bandwidth"] = own["bandwidth"] * select(turns, full_like(shape, BESIDE_WAVE), full_like(shape, 1.0))
        return own

    def learn_repeats(self, repeat_ns: int, from_ns: int) -> None:
        """See Law."""
        self._memory = RepeatMemory(repeat_ns, from_ns, self._period, 0.5 * self._limit)

    def learnt_state(self) -> list[Number]:
        """See Law: weights, both tables, waves, and the force of every tick of the repeat, where it learns one."""
        learnt = self._map()
        return learnt if self._memory is None else learnt + self._memory.best()

    def _map(self) -> list[Number]:
        tables = self._forward.values() + self._backward.values()
        return self._weights.values() + tables + self._wave.values()

    def begin_learnt(self, state: list[Number]) -> None:
        """See Law."""
        if len(state) < KEPT or (self._memory is None and len(state) > KEPT):
            more = "at least " if self._memory is not None else ""
            raise ValueError(f"law.learnt: it has {len(state)} values; a state of this law has {more}{KEPT}")
        if self._memory is not None:
            self._memory.begin_with(state[KEPT:])
        self._kept = state[:KEPT]

    def keep(self) -> None:
        """See Law."""
        if anywhere(self._moved > MOVED_PERIODS):
            self._kept = self._map()
            if self._memory is not None:
                self._memory.keep()

    def kept(self) -> list[Number]:
        """See Law."""
        return self._kept if self._memory is None or not self._kept else self._kept + self._memory.start()

    def designed(self) -> list[Number]:
        """See Law: the observer's transition over a period, and its gains in motion and at rest."""
        found = [value for row in self._motion.transition for value in row]
        return found + self._moving.values() + self._resting.values()

    def found_of_pulse(self, ticks: int) -> list[Number]:
        """See Law; in motion."""
        none = zeros_like(self._model.mass)
        channel, found = Channel(none), []
        for tick in range(ticks):
            channel.innovation(full_like(none, 1.0) if tick == 0 else none, self._motion, self._moving)
            found.append(channel.found)
        return found

    def reset(self, position: Number, force: Number) -> None:
        """At rest, without error; what `force` has beyond the gravity hold is taken as a disturbance."""
        zero, one, model = zeros_like(position), full_like(position, 1.0), self._model
        gravity = full_like(position, model.gravity)
        self._observer = MotionObserver(self._motion, zero)
        self._observer.restart(zero, bounded(full_like(position, force) - gravity, self._limit))
        self._gains = Gains(zero, zero, zero, zero, zero)
        self._gains.blend(self._moving, self._resting, one)
        self._bank: Bank = (zero, zero, zero, zero, zero, zero)  # operators on the reference
        self._weights.reset(zero, full_like(position, model.coulomb))
        self._forward = PositionTable(full_like(position, self._pitch), full_like(position, self._table_limit))
        self._backward = PositionTable(full_like(position, self._pitch), full_like(position, self._table_limit))
        self._wave.reset(zero)
        self._shift, self._rest, self._stiff, self._moved = zero, one, one, zero
        self._creep = zero  # error that would make s move as it goes on moving at rest, m
        self._lagged = gravity  # force behind the lag that the feedforward has come to
        self._known_last, self._known_before = gravity, gravity  # feedforward of the last two forces
        self._force_before = full_like(position, force)
        self._position, self._velocity = zero, zero  # of the reference, at the newest sample
        self._ahead = zero  # of the reference in its bank
        self._tick = 0  # since the start, up to STARTED
        self._short, self._thrown = zero, zero  # force beyond the gravity hold before the drive takes over; 1.0: thrown
        self._learnt, self._open = zero, one  # by repeating; 1.0 where weights and table learn
        if self._memory is not None:
            self._memory.forget()
            self._open = 1.0 - self._memory.frozen
        if self._kept:
            kept = [full_like(position, value) for value in self._kept[:WEIGHTS]]
            self._weights.fill(kept)
            self._forward.fill(self._kept[WEIGHTS : WEIGHTS + NODES])
            self._backward.fill(self._kept[WEIGHTS + NODES : KEPT - WAVES])
            self._wave.fill(self._kept[KEPT - WAVES :])

    def _begin(self, inputs: LawInputs) -> None:
        """The axis rests, held by its drive or brake until the first command arrives; so does the reference."""
        sample = inputs.sample
        self._position, self._velocity = copy(sample.position), copy(sample.velocity)
        self._weights.begin_at(sample.position)
        self._ahead = copy(inputs.start.position)
        self._short = short = inputs.force_last - self._model.gravity
        self._thrown = select(short != 0.0, full_like(short, 1.0), zeros_like(short))

    def force(self, inputs: LawInputs) -> Number:
        """Correct the observer, learn, look ahead to `start`, feed forward what is known and back what is left."""
        tick = self._tick
        first = tick == 0
        if first:
            self._begin(inputs)
        if tick < STARTED:
            self._tick = tick + 1
        before = self._force_before
        # Where no axis answered, the command was lost, and drives hold the force before it.
        last = before if first else select(inputs.answered != 0.0, inputs.force_last, before)
        self._force_before = copy(last)
        observer, sample, start, half = self._observer, inputs.sample, inputs.start, 0.5 * self._period
        q, v = sample.position, sample.velocity
        memory = self._memory
        if memory is not None:
            observer.d = observer.d - memory.steps[0]
        observer.advance(before - self._known_before, (q - self._position) - half * (v + self._velocity))
        error = observer.seen  # as predicted
        innovation = (inputs.position - q - error) * inputs.fresh
        moves = (v != 0.0) | (q != self._position)
        self._position, self._velocity = copy(q), copy(v)
        if tick == SEEN:  # for this sample alone: the next schedule replaces the gains
            self._gains.blend(self._gains, self._motion.thrown, self._thrown)
            moves = moves & (self._thrown == 0.0)
        observer.correct(innovation, self._gains)
        d = observer.d
        if memory is not None:
            d = d - memory.steps[1]  # as it is after the sample
            self._repeat(memory, inputs)
        learn = select(moves, inputs.fresh, zeros_like(inputs.fresh)) * self._open
        if self._wave.anywhere:
            self._wave.learn(innovation, learn, self._weights.calm(), self._gains)
        self._weights.learn(q + observer.seen, innovation, learn, self._gains)
        if tick == TAKEN_OVER:
            observer.f = copy(self._short)
            self._weights.throw(self._short)
        lost = (start.position - q) - half * (v + start.velocity)
        error, rate = observer.ahead(last - self._known_last, lost, d)
        known = self._feedforward(inputs)
        if self._motion.flexible:
            tool = self._motion.tool_lag
            error = error - tool * start.acceleration
            rate = rate - (tool * (1.0 / self._period)) * (inputs.end.acceleration - start.acceleration)
        share = self._stiff
        kp = self.stiffness + share * (self._rest_stiffness - self.stiffness)
        kd = self.damping + share * (self._rest_damping - self.damping)
        if memory is not None:
            d = d - memory.steps[1]  # as it will be in the interval that begins now
        return known + d - kp * error - kd * rate

    def _repeat(self, memory: RepeatMemory, inputs: LawInputs) -> None:
        """Tell the memory what the sample says of the repeat, and take from it the force of the coming interval."""
        tick, observer = memory.tick(inputs.task_ns), self._observer
        error = observer.e - self._motion.tool_lag * inputs.sample.acceleration
        memory.note(tick, observer.d, error, inputs.fresh * (abs(inputs.force_before) < self._limit))
        self._learnt = memory.force(tick)
        self._open = 1.0 - memory.frozen

    def _feedforward(self, inputs: LawInputs) -> Number:
        """What the reference needs of the drive in the coming interval, N; the gains for the next sample."""
        start, end, observer, model = inputs.start, inputs.end, self._observer, self._model
        q0, q1, v0, v1 = start.position, end.position, start.velocity, end.velocity
        rests = (v0 == 0.0) & (v1 == 0.0)
        weights = self._weights.friction()
        self._schedule(rests, weights)
        error = observer.seen
        none = zeros_like(error)
        crept = self._creep + self._ramp * select(abs(error) < self._creeping, error, none)
        self._creep = creep = select(self._rest < 1.0, none, crept)
        shift = bounded(self._shift - self._integral * (error + creep), self._most_shift)
        more = 0.5 * (shift - self._shift)
        self._shift = shift
        # Through the interval's middle, by a cubic; a reference that jumps at rest jumps at the beginning.
        centre = 0.5 * (q1 - q0) + (CENTRE * self._period) * (v0 - v1)
        begin, slope = self._bank, self._slopes
        middle = moved(begin, slope, (q0 - self._ahead) + centre + more)
        last = moved(middle, slope, (q1 - q0) - centre + more)
        self._bank, self._ahead = last, copy(q1)
        z = averaged(begin, middle, last)
        friction = weighed(weights, z)
        v, a = inputs.mean_velocity, inputs.mean_acceleration
        self._weights.fed(z, a)
        # How far friction has turned round, -1 to 1, shares the tables of both directions.
        w = weights
        total = at_least(w[0] + w[1] + w[2] + w[3] + w[4] + w[5], 0.3 * self._dry)
        turned = 0.5 * bounded(friction / total, 1.0)
        self._tabulate(rests)
        place = q0 + centre
        table = (0.5 + turned) * self._forward.at(place) + (0.5 - turned) * self._backward.at(place)
        mass = model.mass + self._weights.mass()
        smooth = mass * a + (model.viscous + model.quadratic * abs(v)) * v + model.gravity
        wanted = smooth + friction + table
        if self._wave.anywhere:
            wanted = wanted + self._wave.force(place, q1 - q0, 0.5 + turned)
        if self._memory is not None:
            wanted = wanted + self._learnt
        motion = self._motion
        known = (wanted - motion.tardy * self._lagged) / (1.0 - motion.tardy)
        self._lagged = motion.kept * self._lagged + motion.taken * known
        self._known_before, self._known_last = self._known_last, known
        return known

    def _schedule(self, rests: Any, weights: Bank) -> None:
        """Between the gains in motion and at rest, for the next sample."""
        none, one = zeros_like(self._rest), full_like(self._rest, 1.0)
        self._rest = select(rests, at_most(self._rest + 1.0 / REST_PERIODS, one), none)
        self._moved = self._moved + select(rests, none, one)
        stiff = at_least(weighed(weights, self._slopes) * self._softness, 0.0)
        stiff = select(self._moved > MOVED_PERIODS, stiff, one)
        self._stiff = at_most(self._rest, stiff)
        self._gains.blend(self._moving, self._resting, self._stiff)

    def _tabulate(self, rests: Any) -> None:
        """Put the disturbance where the axis was when it acted."""
        v = self._velocity
        step = at_most(self._table_gain * abs(v), LARGEST_STEP)
        d = self._observer.d * (select(rests, zeros_like(step), step) * self._open * self._weights.calm())
        place, none = self._position - self._delay * v, zeros_like(d)
        self._forward.add(place, select(v > 0.0, d, none))
        self._backward.add(place, select(v < 0.0, d, none))
