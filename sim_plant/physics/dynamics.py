"""Equation of motion of an axis that is more than a rigid mass under set-valued friction, and one step of it.

    motor side   m1 q'' = f + e + sum A sin(q) - cable(q) - friction(q, q', z) + k (y - q) + c (y' - q') - m1 g(t)
    tool side    m2 y'' = k (q - y) + c (q' - y') - membrane(y, y') - m2 g(t)

f: the drive's force behind a first-order lag. e: gravity, bias, noise. g: the floor's acceleration. Without a mode
m2 = 0 and y = q.

Up to two masses more hang on the motor, beside the tool's and like it, each on a spring of its own; nothing else
touches them. Seen from where it is driven, a structure is such masses in parallel, one a mode (Wada, Bamford, Garba,
"Equivalent spring-mass system: a physical interpretation", Shock and Vibration Bulletin 42(5), 1972). Only the first
carries the tool.

Friction with presliding is the LuGre model (Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40(3), 1995):

    friction = s0 z + s1 z' + viscous q' + quadratic q' |q'|,   z' = q' - |q'| z / limit(q'),
    limit = presliding (1 + (stribeck / coulomb) / (1 + (q' / v_s)^2)),   s0 = coulomb / presliding

An axis that has elements has Maxwell-slip friction (Al-Bender, Lampaert, Swevers, IEEE TAC 50(11), 2005): springs side
by side. Each follows the motor until it slips at its own length. z is then their mean deflection, weighted by
stiffness. So the force is s0 z as well, and all slip where z = limit. s1 damps them as it damps the bristle.

Between two reversals z depends on the distance alone: z = s limit + (z0 - s limit) exp(-|q - q0| / limit). It is worked
out so at every stage of a Runge-Kutta step, which leaves nothing stiff: a step may be long against limit / |q'| once
the axis slides. Without presliding friction is set-valued, and a step is one smooth branch of it (events.py).

What an axis has of all that, and how long a step may be, is in terms.py. One source for floats and arrays (number.py).
"""

from sim_plant.physics.exact_trigonometry import TURN
from sim_plant.physics.number import (
    Number,
    anywhere,
    decay,
    decay_with_mean,
    direction,
    select,
    sincos,
)
from sim_plant.physics.structure import HUNG, Motion
from sim_plant.physics.terms import Pair, Terms, Triple


def _sinusoids(lines: list[Triple], middle: Number, span: Number) -> Triple:
    """Their sum along a step over `span` (m or s) about `middle`: to third order of the angle, from one sine each."""
    first = inner = last = 0.0 * span
    for amplitude, wavenumber, phase in lines:
        sine, cosine = sincos(middle * wavenumber + phase)
        angle = 0.5 * TURN * (span * wavenumber)
        bent = amplitude * (sine * (1.0 - 0.5 * (angle * angle)))
        tilt = amplitude * (cosine * angle)
        first = first + (bent - tilt)
        inner = inner + amplitude * sine
        last = last + (bent + tilt)
    return first, inner, last


class Dynamics(Terms):
    """The same axis, or axes, in motion."""

    def _prepare_lag(self, h: Number) -> Triple:
        """Of the force still to come, f(0) - command: parts at a step's beginning and end of the straight line with its
        impulse and first moment, so that a free mass gets exactly what the exponential gives it; and what is left."""
        if anywhere(h != self._lag_h):
            x = h * self.inverse_lag
            left = decay(0.25 * x)
            left = left * left
            left = left * left
            mean = (1.0 - left) / x
            moment = (1.0 - mean) / x
            self._lag_weights = 6.0 * moment - 2.0 * mean, 6.0 * mean - 12.0 * moment, left
            self._lag_h = h
        return self._lag_weights

    def limit_at(self, velocity: Number) -> Number:
        """Deflection (m) at which the bristle slides at this speed."""
        if not self.has_stribeck:
            return self.structure.presliding
        ratio = velocity * self._slowness
        return self.structure.presliding + self.peak / (1.0 + ratio * ratio)

    def bend(self, begin: Triple, arrived: tuple[Number, Number], span: Number) -> tuple[Number, Number]:
        """The bristle `span` seconds later, and its limit there; at most one reversal in between.

        begin: the bristle, its limit and the velocity at the start. arrived: metres moved, and the velocity then.
        """
        z, before, v0 = begin
        moved, velocity = arrived
        towards = direction(velocity)
        turned = velocity * v0 < 0.0
        if anywhere(turned):  # a uniform deceleration to the turning point, which is close against the limit
            there = v0 * v0 * span / (2.0 * select(turned, v0 - velocity, 1.0))
            a = abs(there) / before
            z = select(turned, (z + towards * before) * (1.0 - a * (1.0 - 0.5 * a)) - towards * before, z)
            moved = select(turned, moved - there, moved)
        if not self.has_stribeck:
            sliding = towards * before
            return sliding + (z - sliding) * decay(towards * moved * self.inverse_limit), before
        limit = self.limit_at(velocity)  # a ramp over the distance
        left, mean = decay_with_mean(towards * moved * (0.5 / before + 0.5 / limit))
        return towards * (limit - (limit - before) * mean) + (z - towards * before) * left, limit

    def slip(self, begun: list[Number], v0: Number, arrived: Pair, span: Number) -> list[Number]:
        """By how much each element is bent `span` seconds later (m); at most one reversal in between, as in `bend`."""
        moved, velocity = arrived
        turned = velocity * v0 < 0.0
        turns = anywhere(turned)
        there, most = moved, self.limit_at(0.0 * velocity)
        if turns:
            there = select(turned, v0 * v0 * span / (2.0 * select(turned, v0 - velocity, 1.0)), moved)
        limit, bent = self.limit_at(velocity), []
        for z, reach in zip(begun, self.structure.slip_reach, strict=False):
            if turns:
                z = select(turned, _within(z + there, -(most * reach), most * reach), z)
                z = z + select(turned, moved - there, moved)
            else:
                z = z + moved
            bent.append(_within(z, -(limit * reach), limit * reach))
        return bent

    def _mean(self, slips: list[Number]) -> Number:
        """Of the elements' deflections (m), weighted by their stiffness."""
        mean: Number = 0.0
        for bent, weight in zip(slips, self.structure.slip_weight, strict=False):
            mean = mean + weight * bent
        return mean

    def _bent(self, begin: Triple, arrived: tuple[Number, Number], turn: Number, h: Number) -> Number:
        """The bristle at the end of a step. turn: how much the acceleration fell in it.

        Where the limit changes with the speed, a step in one and in two halves together cancel the error of second
        order that the ramp over the distance makes (Richardson's extrapolation).
        """
        z, _ = self.bend(begin, arrived, h)
        if not self.has_stribeck:
            return z
        (moved, velocity), v0 = arrived, begin[2]
        there, then = 0.5 * moved + 0.125 * h * (v0 - velocity), 0.5 * (v0 + velocity) + 0.125 * h * turn
        middle, limit = self.bend(begin, (there, then), 0.5 * h)
        halved, _ = self.bend((middle, limit, then), (moved - there, velocity), 0.5 * h)
        return halved + (halved - z) * (1.0 / 3.0)

    def friction(self, velocity: Number, bristle: tuple[Number, Number], sign: Number, scale: Number) -> Number:
        """Force (N) against the motion. bristle: z, and its limit. sign: of the branch of set-valued friction."""
        s = self.structure
        if self.has_bristle:
            z, limit = bristle
            dry = self.stiffness * z + s.bristle_damping * (velocity - abs(velocity) * z / limit)
        else:
            dry = sign * s.coulomb
            if self.has_stribeck:
                ratio = velocity * self._slowness
                dry = sign * (s.coulomb + s.stribeck / (1.0 + ratio * ratio))
        if self.has_variation:
            dry = scale * dry
        return dry + (s.viscous + s.quadratic * abs(velocity)) * velocity

    def transition(self, at: Motion) -> Number:
        """Positive once the membrane's state changes (membrane.py)."""
        return self.membrane.transition(at.load_position, at.pierced)

    def load_on_motor(self, at: Motion, time: Number, forces: tuple[Number, Number]) -> tuple[Number, Number]:
        """Where friction is set-valued and the motor at rest: what acts on it but friction, and the most friction (N).

        In the frame of the floor, whose acceleration acts on the motor as well.
        """
        s = self.structure
        still = 0.0 * at.position
        net = forces[0] + (at.force if self.has_lag else forces[1])
        if self.lines:
            net = net + _sinusoids(self.lines, at.position, still)[1]
        if self.has_cable:
            net = net - s.cable_hysteresis * at.cable - s.cable_stiffness * at.position
        if self.has_mode:
            net = net + s.mode_stiffness * (at.load_position - at.position) + s.mode_damping * at.load_velocity
        elif self.has_cell:
            net = net - self.membrane.resistance(at.position, still, at.pierced)
        for (stiffness, damping, _), (p, w) in zip(self.hung, self.hung_at(at), strict=True):
            net = net + (stiffness * (p - at.position) + damping * w)
        if self.floor:
            net = net - self.motor_mass * _sinusoids(self.floor, time + still, still)[1]
        hold = s.coulomb + s.stribeck
        if self.has_variation:
            hold = hold * (1.0 + _sinusoids(self._varying, at.position, still)[1])
        return net, hold

    def _along(
        self, at: Motion, time: Number, forces: tuple[Number, Number], h: Number
    ) -> tuple[Triple, Triple, Triple]:
        """At a step's beginning, middle and end each: what pulls on the motor whatever it does (N), the scale of its
        dry friction, and the floor's acceleration (m/s^2).
        """
        s = self.structure
        v0 = at.velocity
        external, command = forces
        middle = at.position + 0.5 * h * v0
        pull1 = pull2 = pull4 = external + command
        if self.has_lag:
            begin, slope, _ = self._prepare_lag(h)
            rest = at.force - command
            pull1 = pull1 + rest * begin
            pull2 = pull2 + rest * (begin + 0.5 * slope)
            pull4 = pull4 + rest * (begin + slope)
        if self.lines:
            first, inner, last = _sinusoids(self.lines, middle, h * v0)
            pull1, pull2, pull4 = pull1 + first, pull2 + inner, pull4 + last
        if self.has_cable:
            hysteresis = s.cable_hysteresis * self._strained(at, 0.5 * h * v0)
            pull1, pull2, pull4 = pull1 - hysteresis, pull2 - hysteresis, pull4 - hysteresis
        scales: Triple = (1.0, 1.0, 1.0)
        if self.has_variation:
            first, inner, last = _sinusoids(self._varying, middle, h * v0)
            scales = 1.0 + first, 1.0 + inner, 1.0 + last
        floors: Triple = (0.0, 0.0, 0.0)
        if self.floor:
            still = 0.0 * v0
            floors = _sinusoids(self.floor, time + 0.5 * h + still, h + still)
        return (pull1, scales[0], floors[0]), (pull2, scales[1], floors[1]), (pull4, scales[2], floors[2])

    def _strained(self, at: Motion, moved: Number) -> Number:
        """The cable's state (-1 to 1) `moved` metres later."""
        onward = direction(moved)
        return onward + (at.cable - onward) * decay(abs(moved) / self.structure.cable_reach)

    def step(self, at: Motion, time: Number, forces: tuple[Number, Number], sign: Number, h: Number) -> Motion:
        """The state h seconds later: one classical Runge-Kutta step. time: s, of its beginning. forces: N, external and
        commanded. sign: of the velocity where friction is set-valued (0.0: held).
        """
        begin, middle, end = self._along(at, time, forces, h)
        q0, v0, y0, u0 = at.position, at.velocity, at.load_position, at.load_velocity
        q, v, y, u = q0, v0, y0, u0
        before: Number = self.limit_at(v0) if self.has_bristle else 0.0
        start: Triple = (at.bristle, before, v0)
        bristle: tuple[Number, Number] = (at.bristle, before)
        turn: Number = 0.0
        speeds = accelerations = load_speeds = load_accelerations = 0.0
        hung0 = hung = self.hung_at(at) if self.hung else []
        slips = self.slips_at(at) if self.n_slips else []
        sums: list[Pair] = [(0.0, 0.0)] * len(hung)
        rates: list[Pair] = []
        pulls: list[Number] = []
        for stage in range(4):
            along = begin if stage == 0 else end if stage == 3 else middle
            if hung:
                pulls = self._pulls(q, v, hung)
            a, b = self._accelerations(at.pierced, (q, v, y, u), bristle, sign, along, pulls)
            weight = 2.0 if stage == 1 or stage == 2 else 1.0
            if hung:
                rates = self._hung_rates(hung, pulls, along[2])
                sums = [(p + weight * w, r + weight * c) for (p, r), (w, c) in zip(sums, rates, strict=True)]
            turn = a if stage == 0 else turn - a if stage == 3 else turn
            speeds = speeds + weight * v
            accelerations = accelerations + weight * a
            if self.has_mode:
                load_speeds = load_speeds + weight * u
                load_accelerations = load_accelerations + weight * b
            if stage == 3:
                break
            ahead = h if stage == 2 else 0.5 * h
            if self.has_mode:
                y, u = y0 + ahead * u, u0 + ahead * b
            if hung:
                hung = [(p + ahead * w, r + ahead * c) for (p, r), (w, c) in zip(hung0, rates, strict=True)]
            q, v = q0 + ahead * v, v0 + ahead * a
            if self.has_bristle:
                bristle = self._underway(start, slips, (q - q0, v), ahead)
        sixth = h * (1.0 / 6.0)
        q, v = q0 + sixth * speeds, v0 + sixth * accelerations
        y, u = (y0 + sixth * load_speeds, u0 + sixth * load_accelerations) if self.has_mode else (q, v)
        if hung:
            hung = [(p + sixth * w, r + sixth * c) for (p, r), (w, c) in zip(hung0, sums, strict=True)]
        z = at.bristle
        if self.n_slips:
            slips = self.slip(slips, v0, (q - q0, v), h)
            z = self._mean(slips)
        elif self.has_bristle:
            z = self._bent(start, (q - q0, v), turn, h)
        return self._arrived(at, (q, v, y, u, z), hung, slips, (forces[1], h))

    def _underway(self, start: Triple, slips: list[Number], arrived: Pair, span: Number) -> Pair:
        """`bend`, or where there are elements, their mean and its limit."""
        if slips:
            return self._mean(self.slip(slips, start[2], arrived, span)), self.limit_at(arrived[1])
        return self.bend(start, arrived, span)

    def _pulls(self, q: Number, v: Number, hung: list[Pair]) -> list[Number]:
        """Of the springs of the masses hung beside the load, on the motor (N)."""
        springs = zip(self.hung, hung, strict=True)
        return [stiffness * (p - q) + damping * (w - v) for (stiffness, damping, _), (p, w) in springs]

    def _hung_rates(self, hung: list[Pair], pulls: list[Number], floor: Number) -> list[Pair]:
        """Velocity and acceleration of each of those masses under these pulls."""
        rates: list[Pair] = []
        for (_, _, inverse), (_, w), pull in zip(self.hung, hung, pulls, strict=True):
            c = -pull * inverse
            rates.append((w, c - floor if self.floor else c))
        return rates

    def _accelerations(
        self,
        pierced: Number,
        state: tuple[Number, Number, Number, Number],
        bristle: tuple[Number, Number],
        sign: Number,
        along: Triple,
        pulls: list[Number],
    ) -> tuple[Number, Number]:
        """Of motor and load (m/s^2) in a state (q, q', y, y'); load: 0 without a mode. along: one of `_along`'s. pulls:
        `_pulls`.
        """
        s = self.structure
        q, v, y, u = state
        pull, scale, floor = along
        net = pull - self.friction(v, bristle, sign, scale)
        if self.has_cable:
            net = net - s.cable_stiffness * q
        b: Number = 0.0
        if self.has_mode:
            coupling = s.mode_stiffness * (y - q) + s.mode_damping * (u - v)
            net = net + coupling
            if self.has_cell:
                coupling = coupling + self.membrane.resistance(y, u, pierced)
            b = -coupling * self.inverse_load
        elif self.has_cell:
            net = net - self.membrane.resistance(q, v, pierced)
        for other in pulls:
            net = net + other
        a = net * self.inverse_mass
        if self.floor:
            a, b = a - floor, b - floor
        if not self.has_bristle:
            a = select(sign == 0.0, 0.0, a)
        return a, b

    def _arrived(
        self,
        at: Motion,
        state: tuple[Number, Number, Number, Number, Number],
        hung: list[Pair],
        slips: list[Number],
        under: Pair,
    ) -> Motion:
        """The whole state after a step that ends at (q, q', y, y', z), with the other masses and the elements there.
        under: the command (N), and how long (s)."""
        command, h = under
        q, v, y, u, bristle = state
        moved = q - at.position
        cable = self._strained(at, moved) if self.has_cable else at.cable
        force = command + (at.force - command) * self._prepare_lag(h)[2] if self.has_lag else command
        played = self._play(at, y, u, h) if self.has_backlash else y
        p2, w2, p3, w3, a, b, c, d = q, v, q, v, at.slip0, at.slip1, at.slip2, at.slip3
        if hung:
            (p2, w2), (p3, w3) = [*hung, (q, v)][:HUNG]
        if slips:
            a, b, c, d = [*slips, *[a, b, c, d][len(slips) :]]
        return Motion(q, v, at.pierced, y, u, bristle, cable, force, played, at.walked, p2, w2, p3, w3, a, b, c, d)

    def _play(self, at: Motion, y: Number, u: Number, h: Number) -> Number:
        """The load's position behind the backlash: it follows the load at half of it, by way of its turning point."""
        half, played, u0 = 0.5 * self.structure.backlash, at.played, at.load_velocity
        turned = u0 * u < 0.0
        if anywhere(turned):
            there = at.load_position + u0 * u0 * h / (2.0 * select(turned, u0 - u, 1.0))
            there = select(turned, there, y)
            played = _followed(played, there, half)
        return _followed(played, y, half)


def _followed(played: Number, y: Number, half: Number) -> Number:
    return _within(played, y - half, y + half)


def _within(value: Number, low: Number, high: Number) -> Number:
    return select(value < low, low, select(value > high, high, value))
