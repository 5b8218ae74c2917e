"""Linear observer of an axis' error behind a drive's lag and with one flexible mode, written for floats and arrays.

State [e, v, f, x, n, d]: error of the axis' centre of mass (m) and its rate; force behind the lag (N); the encoder's
motion against it (m) and its rate; disturbance (N). The encoder sees e + x. Inputs and forces are differences to what
the reference needs, so that all is zero where the reference is followed. With the tool, a part `load` of the mass, on a
spring (two-mass model, e.g. Schmidt, Schitter, Rankers, The Design of High Performance Mechatronics (2014), section
3.3):

    e'' = (f - d) / m,   f' = (u - f) / lag,   x'' = load / (1 - load) (f - d) / m - w^2 x - 2 zeta w x'

Further resonances have two states each behind these (hil/control/laws/other_modes.py). The encoder sees them, too.

Gains are those of the steady Kalman filter, in units of period and measurement noise: they depend on lag, mode and the
noises' ratios alone.
"""

from collections.abc import Sequence

from hil.control.laws.base import Model
from hil.control.laws.breakaway import anywhere
from hil.control.laws.other_modes import TURN, Springs, corrected, motion, stated, with_others
from hil.control.number import Number, at_least, at_most, root, select, zeros_like

LEAST_LAG = 1e-3  # of a period: what no lag is calculated as
SQUARINGS, TERMS = 12, 8  # of the matrix exponential
SLOWEST_FADE = 0.995  # a period, of a mode that the model does not damp
DOUBLINGS = 18  # of the Riccati equation: 2^18 periods
FORCE = 6  # its place in the transition, behind the axis' own states
Matrix = list[list[Number]]


def _product(a: Matrix, b: Matrix) -> Matrix:
    inner = range(len(b))
    result = []
    for row in a:
        line = []
        for column in range(len(b[0])):
            total = row[0] * b[0][column]
            for i in inner[1:]:
                total = total + row[i] * b[i][column]
            line.append(total)
        result.append(line)
    return result


def _transposed(a: Matrix) -> Matrix:
    return [[row[i] for row in a] for i in range(len(a[0]))]


def _sum(a: Matrix, b: Matrix) -> Matrix:
    return [[p + q for p, q in zip(one, other, strict=True)] for one, other in zip(a, b, strict=True)]


def _identity(n: int, one: Number) -> Matrix:
    return [[one if i == k else zeros_like(one) for k in range(n)] for i in range(n)]


def _exponential(a: Matrix, one: Number) -> Matrix:
    """Taylor's series of a / 2^SQUARINGS, squared SQUARINGS times."""
    n = len(a)
    small = [[value * 0.5**SQUARINGS for value in row] for row in a]
    result = term = _identity(n, one)
    for k in range(1, TERMS + 1):
        term = [[value / k for value in row] for row in _product(term, small)]
        result = _sum(result, term)
    for _ in range(SQUARINGS):
        result = _product(result, result)
    return result


def _inverse(a: Matrix, one: Number) -> Matrix:
    """Gauss-Jordan without pivoting: of I + G H with G, H positive semidefinite, which needs none."""
    n = len(a)
    rows = [list(row) + unit for row, unit in zip(a, _identity(n, one), strict=True)]
    for i in range(n):
        pivot = rows[i][i]
        rows[i] = [value / pivot for value in rows[i]]
        for k in range(n):
            if k != i:
                factor = rows[k][i]
                rows[k] = [value - factor * own for value, own in zip(rows[k], rows[i], strict=True)]
    return [row[n:] for row in rows]


def _riccati(a: Matrix, c: Sequence[Number], q: Matrix, one: Number) -> Matrix:
    """P = A P A' - A P c' (c P c' + 1)^-1 c P A' + Q by doubling (Chu, Fan, Lin, Int. J. Control 77(8), 2004)."""
    n = len(a)
    alpha, h = _transposed(a), q
    g: Matrix = [[p * r for r in c] for p in c]
    for _ in range(DOUBLINGS):
        w = _inverse(_sum(_identity(n, one), _product(g, h)), one)
        back = _transposed(alpha)
        left = _product(alpha, w)
        further = _product(_product(_product(back, h), w), alpha)
        g = _sum(g, _product(_product(left, g), back))
        alpha = _product(left, alpha)
        h = _sum(h, further)
    return h


class Gains:
    """Of the observer's correction: of e, v, x, n, d and the states of other resonances per metre of innovation."""

    def __init__(self, e: Number, v: Number, x: Number, n: Number, d: Number, others: Sequence[Number] = ()) -> None:
        self.e, self.v, self.x, self.n, self.d, self.others = e, v, x, n, d, list(others)

    def values(self) -> list[Number]:
        """In the order of the arguments."""
        return [self.e, self.v, self.x, self.n, self.d, *self.others]

    def blend(self, one: "Gains", other: "Gains", share: Number) -> None:
        """Become `one` with `share` (0 to 1) of `other`."""
        self.e = one.e + share * (other.e - one.e)
        self.v = one.v + share * (other.v - one.v)
        self.x = one.x + share * (other.x - one.x)
        self.n = one.n + share * (other.n - one.n)
        self.d = one.d + share * (other.d - one.d)
        if one.others:
            self.others = [mine + share * (its - mine) for mine, its in zip(one.others, other.others, strict=True)]


class MotionModel:
    """The axis over one period: coefficients of the state [e, v, f, x, n, d], and the gains of an observer of it."""

    def __init__(self, model: Model, period: float, mode_share: Number = 1.0, transition: Matrix | None = None) -> None:
        """mode_share: of the model's mode frequency that the observer takes the mode to have. transition: (7, 7)
        and two more for each other resonance, as another such model of this axis has it; None: it is found.
        """
        zero = zeros_like(model.mass)
        one = zero + 1.0
        load = zero + model.mode_load
        # The mode of the free axis, not that of the tool on a held motor.
        turn = TURN * model.mode_frequency * root(1.0 / (1.0 - load)) * period
        ring = (turn + zero) * mode_share
        rings = model.mode_frequency + zero > 0.0
        self.others = stated(model)
        self.flexible = anywhere(rings) or bool(self.others)
        self._seen = select(rings, one, zero)
        # s^2: the tool is behind the encoder by that times the acceleration. What the reference bends the spring by is
        # not in x, which is of forces beyond the reference's: the error seen is the encoder's.
        held = (1.0 - load) * (turn * turn)
        self.tool_lag = select(rings, period * period / select(rings, held, one), zero)
        part = self._seen * load / (1.0 - load)
        lag = at_least(zero + model.torque_lag * (1.0 / period), LEAST_LAG)
        # In periods, and in forces of 2 m / T^2 a metre: a constant force of 1 moves the axis by 1 in a period.
        o = zero
        rates = [
            [o, one, o, o, o, o, o],
            [o, o, one + 1.0, o, o, -one - 1.0, o],
            [o, o, -one / lag, o, o, o, one / lag],
            [o, o, o, o, one, o, o],
            [o, o, 2.0 * part, -ring * ring, -2.0 * (model.mode_damping + zero) * ring, -2.0 * part, o],
            [o, o, o, o, o, o, o],
            [o, o, o, o, o, o, o],
        ]  # fmt: skip
        if self.others:
            motor = 1.0 - load
            tool = motor * (ring * ring), motor * (2.0 * (model.mode_damping + zero) * ring), load * self._seen
            rates = with_others(rates, tool, self.others, period)
        f = transition or _exponential(rates, one)
        self.transition = f
        states = [i for i in range(len(f)) if i != FORCE]
        self._transition, self._one = [[f[i][k] for k in states] for i in states], one
        metre, self._period = period * period / (2.0 * model.mass), period
        self.springs = Springs(f, metre, period) if self.others else None
        rate = metre / period
        self.kept, self.taken = f[2][2], f[2][6]  # of the lagged force, of its input
        # Mean over a period of the force behind the lag: 1 - tardy parts input, tardy parts of what it was.
        self.tardy = lag * (1.0 - f[2][2])
        self.e_f, self.e_u, self.e_d = f[0][2] * metre, f[0][6] * metre, -f[0][5] * metre
        self.v_f, self.v_u, self.v_d = f[1][2] * rate, f[1][6] * rate, -f[1][5] * rate
        self.x_x, self.x_n = f[3][3], f[3][4] * period
        self.x_f, self.x_u, self.x_d = f[3][2] * metre, f[3][6] * metre, -f[3][5] * metre
        self.n_x, self.n_n = f[4][3] / period, f[4][4]
        self.n_f, self.n_u, self.n_d = f[4][2] * rate, f[4][6] * rate, -f[4][5] * rate
        # A force behind the lag that was another than expected, once: gains that put an innovation down to it; how far
        # the mode swings after it (m/N), and what a period leaves of that.
        seen, thrown = self.e_f + self.x_f, list[Number]()
        if self.springs is not None:
            thrown = self.springs.by_lagged
            seen = seen + motion(thrown)
        others = [value / seen for value in thrown]
        self.thrown = Gains(self.e_f / seen, self.v_f / seen, self.x_f / seen, self.n_f / seen, zero, others)
        n = self.n_f * period / select(rings, ring, one)
        self.swing = root(self.x_f * self.x_f + n * n) * self._seen
        self.fade = at_most(root(self.x_x * self.n_n - self.x_n * self.n_x), SLOWEST_FADE)
        self._metre = metre
        self.time = period

    def gains(
        self, force_noise: Number, disturbance_noise: Number, mode_noise: Number, other_noises: Sequence[Number] = ()
    ) -> Gains:
        """Of the steady Kalman filter. Noises per period, in standard deviations of a sample: position that white
        force and the disturbance's steps make, and the encoder's speed that the mode's own make, and each other one's.
        """
        one = self._one
        zero = zeros_like(one)
        of_others = [select(hertz > 0.0, one, zero) for hertz, _, _ in self.others]
        by_force = [-row[5] * force_noise for row in self._transition]
        by_force[5] = zero
        q = [[p * r for r in by_force] for p in by_force]
        q[4][4] = q[4][4] + mode_noise * mode_noise * self._seen
        q[5][5] = q[5][5] + disturbance_noise * disturbance_noise
        c = [one, zero, zero, self._seen, zero, zero]
        for place, (noise, there) in enumerate(zip(other_noises, of_others, strict=True)):
            at = 2 * place + 7
            q[at][at] = q[at][at] + noise * noise * there
            c += [there, zero]
        p = _riccati(self._transition, c, q, one)
        seen = [row[0] + row[3] * self._seen + motion(row[6:]) for row in p]
        scale = 1.0 / (seen[0] + seen[3] * self._seen + motion(seen[6:]) + 1.0)
        rate = scale * (1.0 / self._period)
        return Gains(
            seen[0] * scale, seen[1] * rate, seen[3] * scale * self._seen, seen[4] * rate * self._seen,
            seen[5] * scale / self._metre, [value * scale for value in seen[6:]],
        )  # fmt: skip


def as_designed(
    model: Model, period: float, mode_share: Number, designed: Sequence[Number]
) -> tuple[MotionModel, Gains, Gains]:
    """A model and two gains of it from their numbers: its transition by rows, then those of either."""
    n = FORCE + 1 + 2 * len(stated(model))
    rows = [list(designed[at : at + n]) for at in range(0, n * n, n)]
    moving, resting = [
        Gains(one[0], one[1], one[2], one[3], one[4], one[5:])
        for one in (designed[n * n : n * n + n - 2], designed[n * n + n - 2 :])
    ]
    return MotionModel(model, period, mode_share, rows), moving, resting


class Channel:
    """What one metre of innovation a disturbance of known course makes: the observer's own error under it."""

    def __init__(self, zero: Number) -> None:
        self._e, self._v, self._x, self._n, self._d, self._none = zero, zero, zero, zero, zero, zero
        self._others: list[Number] = []

    @property
    def found(self) -> Number:
        """What the observer has come to take it for, N."""
        return -self._d

    def innovation(self, opposing: Number, model: MotionModel, gains: Gains) -> Number:
        """Innovation at the end of a period in which a force `opposing` (N) acted that the observer knows nothing of,
        m.
        """
        time = model.time
        force = opposing + self._d
        e = self._e + time * self._v - model.e_d * force
        v = self._v - model.v_d * force
        if model.flexible:
            x = model.x_x * self._x + model.x_n * self._n - model.x_d * force
            n = model.n_x * self._x + model.n_n * self._n - model.n_d * force
            seen = e + x
            springs = model.springs
            if springs is not None:
                before = self._others or [self._none] * springs.states
                others = springs.moved(before, self._x, self._n, (self._none, self._none, force))
                x, n = x + springs.on_motion(before), n + springs.on_rate(before)
                seen = e + x + motion(others)
                self._others = corrected(others, gains.others, -seen)
            self._x = x - gains.x * seen
            self._n = n - gains.n * seen
        else:
            seen = e
        self._e = e - gains.e * seen
        self._v = v - gains.v * seen
        self._d = self._d - gains.d * seen
        return seen


class MotionObserver:
    """The state, at the newest sample."""

    def __init__(self, model: MotionModel, zero: Number) -> None:
        self._model = model
        self.restart(zero, zero)

    def restart(self, zero: Number, force: Number) -> None:
        """On the reference, at rest; a force (N) that holds against a disturbance."""
        self.e, self.v, self.x, self.n = zero, zero, zero, zero
        self.f, self.d = zero + force, zero + force
        springs = self._model.springs
        self._others = [zero] * springs.states if springs is not None else []
        self.seen = zero  # error of the encoder, m

    def advance(self, force: Number, lost: Number) -> None:
        """One period on under `force` (N); `lost`: m by which the reference moved beyond its mean velocity."""
        m, f, d, v = self._model, self.f, self.d, self.v
        self.e = self.e + m.time * v + (m.e_f * f + m.e_u * force - m.e_d * d) - lost
        self.v = v + (m.v_f * f + m.v_u * force - m.v_d * d)
        if m.flexible:
            x, n = self.x, self.n
            self.x = m.x_x * x + m.x_n * n + (m.x_f * f + m.x_u * force - m.x_d * d)
            self.n = m.n_x * x + m.n_n * n + (m.n_f * f + m.n_u * force - m.n_d * d)
            if m.springs is not None:
                others = self._others
                self._others = m.springs.moved(others, x, n, (f, force, d))
                self.x, self.n = self.x + m.springs.on_motion(others), self.n + m.springs.on_rate(others)
        self.f = m.kept * f + m.taken * force
        self.seen = self.e + self.x
        if self._others:
            self.seen = self.seen + motion(self._others)

    def correct(self, innovation: Number, gains: Gains) -> None:
        """Take in what a sample says beyond the prediction (m)."""
        self.e = self.e + gains.e * innovation
        self.v = self.v + gains.v * innovation
        if self._model.flexible:
            self.x = self.x + gains.x * innovation
            self.n = self.n + gains.n * innovation
            if self._others:
                self._others = corrected(self._others, gains.others, innovation)
        self.d = self.d + gains.d * innovation
        self.seen = self.e + self.x
        if self._others:
            self.seen = self.seen + motion(self._others)

    def ahead(self, force: Number, lost: Number, d: Number) -> tuple[Number, Number]:
        """Error and rate of the centre of mass one period on, under `force` and against a disturbance `d` (N)."""
        m, f, v = self._model, self.f, self.v
        return (
            self.e + m.time * v + (m.e_f * f + m.e_u * force - m.e_d * d) - lost,
            v + (m.v_f * f + m.v_u * force - m.v_d * d),
        )
