"""PD plus feedforward for real guides: friction by the motion since the reversal, learnt while moving; lag and a
flexible mode inside the observer; a bias that is found.

    force = lag^-1 [(m + dm) a + viscous v + quadratic v |v| + gravity + sum w_i z_i(r + s) + table(r)]
            - Kp e - Kd e' + d

- z_i: operators of presliding friction (hil/control/laws/presliding_bank.py) on the reference r. s integrates the error
  through them: an integral whose loop gain does not depend on the guide's stiffness.
- w_i and dm: by a Kalman filter on the observer's innovations (hil/control/laws/weight_regression.py), only while the
  reference moves. Its regressors are the operators on the observed position, as the axis is not where the reference is;
  but measured friction itself is never fed forward, which would be positive feedback with delay.
- table: what the observer's disturbance d repeats along the travel, by direction (hil/control/laws/position_table.py).
- e, e', d: by a steady Kalman filter with lag and mode (hil/control/laws/motion_observer.py), predicted to where the
  force acts. It is the tool that follows: the encoder goes ahead of the reference by what the spring bends under its
  acceleration. At rest the axis hangs on its friction's stiffness, a mode of its own: unless it is known to be
  soft, the loop then takes gains that are stable on any.
- A change of the reference's acceleration makes the mode swing, too. To the weights that is noise while it rings: from
  fast moves they would else learn a friction that is too stiff.
- Where a weight hangs on the axis, its brake opens before the drive's force has come up over its lag, and throws it:
  a speed to the observer, and noise to the weights while the mode rings. Weights that take it for friction make it too
  stiff, and s, whose loop gain is that stiffness over the guide's, then rings at rest.
- Where the task repeats and law.iterative_learning says so, what d still is at each instant of it is fed forward in
  the next repeat (hil/control/laws/repeat_memory.py); weights and table stay as they are meanwhile. Where a repeat
  begins, d steps by what that force changes: else both would act until d has found out, which throws a light axis.

After the method of an independent study on LuGre and Maxwell-slip guides. Models: Canudas de Wit and others, IEEE TAC
40(3), 1995; Al-Bender, Lampaert, Swevers, IEEE TAC 50(11), 2005.
"""

from typing import Any, ClassVar

from hil.control.gain import TINIEST, Gain, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.breakaway import anywhere
from hil.control.laws.motion_observer import Channel, Gains, MotionModel, MotionObserver
from hil.control.laws.position_table import NODES, PositionTable
from hil.control.laws.presliding_bank import RATIO, Bank, averaged, moved, slopes, weighed
from hil.control.laws.presliding_gains import of_model
from hil.control.laws.repeat_memory import RepeatMemory
from hil.control.laws.weight_regression import Spread, Weights, diagonal, learnt
from hil.control.number import Number, at_least, bounded, root, select

TAKEN_OVER, SEEN, STARTED = 1, 2, 3  # ticks: the drive takes over; what that did is seen
RINGING = 2.0  # times what the throw makes the mode swing by: noise to the weights
SHAKEN = 20.0  # times what a change of the reference's acceleration does, which is known less well
REST_PERIODS = 20.0  # until an axis counts as at rest
MOVED_PERIODS = 200.0  # in motion, until the friction's stiffness counts as known
STRETCH = 4.0  # s stays within this many times the coarsest reach
TABLE_LIMIT, LARGEST_STEP = 0.5, 0.2  # of the friction; of the table's change in a period
CENTRE = 0.125
WEIGHTS = 7
KEPT = WEIGHTS + 2 * NODES  # numbers of a learnt state before its force


def _of_model(unit: str, meaning: str) -> Gain:
    return Gain(None, unit, meaning)


class PreslidingKalman(Law):
    """Gains that are None follow from the model (hil/control/laws/presliding_gains.py). rest_...: while it
    rests.
    """

    own_estimate: ClassVar[bool] = True
    learns_repeats: ClassVar[bool] = True
    GAINS: ClassVar[dict[str, Gain]] = {
        "bandwidth": _of_model("rad", "natural frequency of the loop in motion times the period"),
        "damping": _of_model("1", "damping ratio in motion"),
        "force_noise": _of_model("1", "noise of the force in motion; see MotionModel.gains"),
        "disturbance_noise": _of_model("1", "noise of the disturbance in motion; see MotionModel.gains"),
        "rest_bandwidth": _of_model("rad", "natural frequency of the loop at rest times the period"),
        "rest_damping": _of_model("1", "damping ratio at rest"),
        "rest_force_noise": _of_model("1", "noise of the force at rest"),
        "rest_disturbance_noise": _of_model("1", "noise of the disturbance at rest"),
        "innovation_noise": _of_model(
            "1", "innovation that the weights leave, in parts of how far friction moves the axis"
        ),
        "integral": _of_model("1", "share of the error that s takes in a period"),
        "table_delay": _of_model("1", "periods that the disturbance's estimate lags"),
        "mode_noise": _of_model("1", "noise of the mode; see MotionModel.gains"),
        "mode_share": _of_model("1", "of the mode's frequency: what the observer takes it for"),
        "soft_bandwidth": Gain(0.6, "rad", "an axis that rings below it on its friction's stiffness counts as soft"),
        "friction_prior": Gain(0.3, "1", "of a weight at the start, in parts of Coulomb friction"),
        "friction_walk": Gain(0.002, "1", "of a weight in a period, in parts of Coulomb friction"),
        "mass_prior": Gain(0.2, "1", "of the mass at the start, in parts of it"),
        "mass_walk": Gain(0.002, "1", "of the mass in a period, in parts of it"),
        "finest": Gain(0.3e-6, "m", "smallest reach of presliding friction; the coarsest is 200 times that", TINIEST),
        "play": Gain(7.5e-9, "m", "motion within it counts as noise"),
        "table_pitch": Gain(1e-3, "m", "distance of the table's nodes", TINIEST),
        "table_rate": Gain(0.8, "1", "share of the disturbance learnt on the way from node to node; 0: none"),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        soft_bandwidth: Number = given["soft_bandwidth"]
        friction_prior: Number = given["friction_prior"]
        friction_walk: Number = given["friction_walk"]
        mass_prior: Number = given["mass_prior"]
        mass_walk: Number = given["mass_walk"]
        finest: Number = given["finest"]
        play: Number = given["play"]
        table_pitch: Number = given["table_pitch"]
        table_rate: Number = given["table_rate"]
        zero = model.mass - model.mass
        swings = zero + model.mode_frequency * root(1.0 / (1.0 - (zero + model.mode_load))) * period

        def default(name: str) -> Number:
            value: Number | None = given[name]
            return of_model(name, swings, zero + model.presliding_greatest) if value is None else value + zero

        self._model, self._period = model, period
        self._motion = motion = MotionModel(model, period, default("mode_share"))
        mode_noise = default("mode_noise")
        self._moving = motion.gains(default("force_noise"), default("disturbance_noise"), mode_noise)
        self._resting = motion.gains(
            default("rest_force_noise"),
            default("rest_disturbance_noise"),
            mode_noise,
        )
        omega = default("bandwidth") * (1.0 / period)
        self.stiffness = model.mass * (omega * omega)
        self.damping = model.mass * (2.0 * default("damping") * omega)
        omega = default("rest_bandwidth") * (1.0 / period)
        self._rest_stiffness = model.mass * (omega * omega)
        self._rest_damping = model.mass * (2.0 * default("rest_damping") * omega)
        omega = soft_bandwidth * (1.0 / period)
        self._softness = 1.0 / (model.mass * (omega * omega))
        self._shaken = SHAKEN * motion.swing * model.mass  # m per m/s^2
        self._integral = default("integral")
        self._slopes: Bank = slopes(finest + zero)
        coarsest = (finest + zero) * (RATIO * RATIO * RATIO * RATIO * RATIO)
        self._most_shift = STRETCH * coarsest
        self._play = play + zero
        # Friction of the model, or what is not nothing against the force limit.
        dry = at_least(model.coulomb + zero, 1e-3 * force_limit)
        noise = default("innovation_noise") * dry * motion.e_d
        self._noise = noise * noise
        w, m = friction_prior * dry, mass_prior * model.mass
        w, m = w * w, m * m
        self._prior: Weights = (w, w, w, w, w, w, m)
        w, m = friction_walk * dry, mass_walk * model.mass
        w, m = w * w, m * m
        self._walk: Weights = (w, w, w, w, w, w, m)
        self._dry, self._limit = dry, force_limit + zero
        self._pitch, self._table_limit = table_pitch + zero, TABLE_LIMIT * dry
        self._table_gain = table_rate * (period / self._pitch)
        self._delay = default("table_delay") * period
        self._memory: RepeatMemory | None = None
        self._kept: list[Number] = []  # weights and tables to begin with
        self.reset(zero, model.gravity + zero)

    def learn_repeats(self, repeat_ns: int, from_ns: int) -> None:
        """See Law."""
        self._memory = RepeatMemory(repeat_ns, from_ns, self._period, 0.5 * self._limit)

    def learnt_state(self) -> list[Number]:
        """See Law: weights, both tables, and the force of every tick of the repeat."""
        if self._memory is None:
            return []
        weights: list[Number] = list(self._weights)
        return weights + self._forward.values() + self._backward.values() + self._memory.best()

    def begin_learnt(self, state: list[Number]) -> None:
        """See Law."""
        if self._memory is None:
            raise ValueError("law.learnt: only with law.iterative_learning = true")
        if len(state) < KEPT:
            raise ValueError(f"law.learnt: it has {len(state)} values; a state of this law has at least {KEPT}")
        self._memory.begin_with(state[KEPT:])
        self._kept = state[:KEPT]

    def found_of_pulse(self, ticks: int) -> list[Number]:
        """See Law; in motion."""
        zero = self._model.mass - self._model.mass
        channel, found = Channel(zero), []
        for tick in range(ticks):
            channel.innovation(zero + (1.0 if tick == 0 else 0.0), self._motion, self._moving)
            found.append(channel.found)
        return found

    def reset(self, position: Number, force: Number) -> None:
        """At rest, without error; what `force` has beyond the gravity hold is taken as a disturbance."""
        zero, model = position - position, self._model
        force = zero + force
        self._observer = MotionObserver(self._motion, zero)
        self._observer.restart(zero, bounded(force - model.gravity, self._limit))
        self._channels = [Channel(zero) for _ in range(7)]
        self._known = Channel(zero)
        self._gains = Gains(zero, zero, zero, zero, zero)
        self._gains.blend(self._moving, self._resting, zero + 1.0)
        still: Bank = (zero, zero, zero, zero, zero, zero)
        self._bank, self._measured = still, still  # operators on the reference, on the axis
        none: Weights = (zero, zero, zero, zero, zero, zero, zero)
        self._coming, self._acting = none, none  # regressors of the interval after the sample, of that before it
        coulomb = (
            zero + model.coulomb
        )  # on a coarse operator: what is not known yet is taken as soft, and never overshoots
        self._weights: Weights = (zero, zero, zero, zero, coulomb, zero, zero)
        self._spread: Spread = diagonal(self._prior)
        self._forward = PositionTable(zero + self._pitch, zero + self._table_limit)
        self._backward = PositionTable(zero + self._pitch, zero + self._table_limit)
        self._shift, self._rest, self._stiff, self._moved = zero, zero + 1.0, zero + 1.0, zero
        self._lagged = zero + model.gravity  # force behind the lag that the feedforward has come to
        self._known_last, self._known_before = self._lagged, self._lagged  # feedforward of the last two forces
        self._force_before = force
        self._position, self._velocity = zero, zero  # of the reference, at the newest sample
        self._place, self._ahead = zero, zero  # of the axis in its bank; of the reference in its own
        self._tick = 0  # since the start, up to STARTED
        self._short, self._thrown = zero, zero  # force beyond the gravity hold before the drive takes over; 1.0: thrown
        self._ringing = zero  # m, of the mode after the throw
        self._learnt, self._open = zero, zero + 1.0  # by repeating; 1.0 where weights and table learn
        if self._memory is not None:
            self._memory.forget()
            self._open = 1.0 - self._memory.frozen
        kept = self._kept
        if kept:
            w = [zero + value for value in kept[:WEIGHTS]]
            self._weights = (w[0], w[1], w[2], w[3], w[4], w[5], w[6])
            self._forward.fill(kept[WEIGHTS : WEIGHTS + NODES])
            self._backward.fill(kept[WEIGHTS + NODES :])

    def _begin(self, inputs: LawInputs) -> None:
        """The axis rests, held by its drive or brake until the first command arrives; so does the reference."""
        sample, start = inputs.sample, inputs.start
        self._position, self._velocity = sample.position + 0.0, sample.velocity + 0.0
        self._place, self._ahead = sample.position + 0.0, start.position + 0.0
        self._short = short = inputs.force_last - self._model.gravity
        self._thrown = select(short != 0.0, 1.0 + 0.0 * short, 0.0 * short)

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
        self._force_before = last + 0.0  # arrays are reused by the caller: keep a copy
        observer, sample, start, half = self._observer, inputs.sample, inputs.start, 0.5 * self._period
        q, v = sample.position, sample.velocity
        memory = self._memory
        if memory is not None:
            observer.d = observer.d - memory.steps[0]
        observer.advance(before - self._known_before, (q - self._position) - half * (v + self._velocity))
        error = observer.e + observer.x  # as predicted
        innovation = (inputs.position - q - error) * inputs.fresh
        moves = (v != 0.0) | (q != self._position)
        self._position, self._velocity = q + 0.0, v + 0.0
        if tick == SEEN:  # for this sample alone: the next schedule replaces the gains
            self._gains.blend(self._gains, self._motion.thrown, self._thrown)
            moves = moves & (self._thrown == 0.0)
        observer.correct(innovation, self._gains)
        d = observer.d
        if memory is not None:
            d = d - memory.steps[1]  # as it is after the sample
            self._repeat(memory, inputs)
        learn = select(moves, inputs.fresh, 0.0 * inputs.fresh) * self._open
        self._learn(q + (observer.e + observer.x), innovation, learn)
        if tick == TAKEN_OVER:
            observer.f = self._short + 0.0
            self._ringing = (RINGING * self._motion.swing) * self._short
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

    def _learn(self, position: Number, innovation: Number, learn: Number) -> None:
        """Weights from the innovation of the interval before the sample; `position` of the axis, observed."""
        acting, gains, motion = self._acting, self._gains, self._motion
        way = position - self._place
        way = way - bounded(way, self._play)
        self._place = self._place + way
        begin, slope, w = self._measured, self._slopes, self._weights
        middle = moved(begin, slope, 0.5 * way)
        end = moved(middle, slope, 0.5 * way)
        self._measured = end
        z = averaged(begin, middle, end)
        bank: Bank = (w[0], w[1], w[2], w[3], w[4], w[5])
        fed: Bank = (acting[0], acting[1], acting[2], acting[3], acting[4], acting[5])
        known = self._known.innovation(weighed(bank, z) - weighed(bank, fed), motion, gains)
        c = self._channels
        r: Weights = (
            c[0].innovation(z[0], motion, gains), c[1].innovation(z[1], motion, gains),
            c[2].innovation(z[2], motion, gains), c[3].innovation(z[3], motion, gains),
            c[4].innovation(z[4], motion, gains), c[5].innovation(z[5], motion, gains),
            c[6].innovation(acting[6], motion, gains),
        )  # fmt: skip
        self._acting = self._coming
        ringing = self._ringing
        self._ringing = ringing * motion.fade + self._shaken * abs(self._acting[6] - acting[6])
        if not anywhere(learn > 0.0):
            return
        noise = self._noise + ringing * ringing
        self._spread, k = learnt(self._spread, r, noise, self._walk, self._prior, learn)
        missing = innovation - known
        self._weights = (
            w[0] + k[0] * missing, w[1] + k[1] * missing, w[2] + k[2] * missing, w[3] + k[3] * missing,
            w[4] + k[4] * missing, w[5] + k[5] * missing,
            bounded(w[6] + k[6] * missing, 0.5 * self._model.mass),
        )  # fmt: skip

    def _feedforward(self, inputs: LawInputs) -> Number:
        """What the reference needs of the drive in the coming interval, N; the gains for the next sample."""
        start, end, observer, model, w = inputs.start, inputs.end, self._observer, self._model, self._weights
        q0, q1, v0, v1 = start.position, end.position, start.velocity, end.velocity
        rests = (v0 == 0.0) & (v1 == 0.0)
        bank: Bank = (w[0], w[1], w[2], w[3], w[4], w[5])
        self._schedule(rests, bank)
        shift = bounded(self._shift - self._integral * (observer.e + observer.x), self._most_shift)
        more = 0.5 * (shift - self._shift)
        self._shift = shift
        # Through the interval's middle, by a cubic; a reference that jumps at rest jumps at the beginning.
        centre = 0.5 * (q1 - q0) + (CENTRE * self._period) * (v0 - v1)
        begin, slope = self._bank, self._slopes
        middle = moved(begin, slope, (q0 - self._ahead) + centre + more)
        last = moved(middle, slope, (q1 - q0) - centre + more)
        self._bank, self._ahead = last, q1 + 0.0
        z = averaged(begin, middle, last)
        friction = weighed(bank, z)
        v, a = inputs.mean_velocity, inputs.mean_acceleration
        self._coming = (z[0], z[1], z[2], z[3], z[4], z[5], a + 0.0)
        # How far friction has turned round, -1 to 1, shares the tables of both directions.
        total = at_least(w[0] + w[1] + w[2] + w[3] + w[4] + w[5], 0.3 * self._dry)
        turned = 0.5 * bounded(friction / total, 1.0)
        self._tabulate(rests)
        place = q0 + centre
        table = (0.5 + turned) * self._forward.at(place) + (0.5 - turned) * self._backward.at(place)
        smooth = (model.mass + w[6]) * a + (model.viscous + model.quadratic * abs(v)) * v + model.gravity
        wanted = smooth + friction + table
        if self._memory is not None:
            wanted = wanted + self._learnt
        motion = self._motion
        known = (wanted - motion.tardy * self._lagged) / (1.0 - motion.tardy)
        self._lagged = motion.kept * self._lagged + motion.taken * known
        self._known_before, self._known_last = self._known_last, known
        return known

    def _schedule(self, rests: Any, bank: Bank) -> None:
        """Between the gains in motion and at rest, for the next sample."""
        s, one = self._slopes, self._rest - self._rest + 1.0
        self._rest = select(rests, -at_least(-(self._rest + 1.0 / REST_PERIODS), -one), 0.0 * one)
        self._moved = self._moved + select(rests, 0.0 * one, one)
        stiff = at_least(weighed(bank, s) * self._softness, 0.0)
        stiff = select(self._moved > MOVED_PERIODS, stiff, one)
        self._stiff = -at_least(-self._rest, -stiff)
        self._gains.blend(self._moving, self._resting, self._stiff)

    def _tabulate(self, rests: Any) -> None:
        """Put the disturbance where the axis was when it acted."""
        v = self._velocity
        step = -at_least(-(self._table_gain * abs(v)), -LARGEST_STEP)
        d = self._observer.d * (select(rests, 0.0 * step, step) * self._open)
        place = self._position - self._delay * v
        self._forward.add(place, select(v > 0.0, d, 0.0 * d))
        self._backward.add(place, select(v < 0.0, d, 0.0 * d))
