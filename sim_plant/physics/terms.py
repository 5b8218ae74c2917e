"""What an axis' equation of motion (dynamics.py) has in it: its terms, their constants, and the steps they ask for.

A step has to be short against whatever changes within it: a ring, a sinusoid, friction that breaks loose or turns
round. What that costs in metres is weighed, so that what moves little may step long. One source for floats and arrays
(number.py).
"""

from typing import Final

from sim_plant.physics.exact_trigonometry import TURN
from sim_plant.physics.membrane import Membrane
from sim_plant.physics.number import Number, direction, greater, root, select
from sim_plant.physics.structure import HUNG, Motion, Structure

# A step of x rad is off by x^4 / 120 of a ring's amplitude, for each radian: so much in metres says how long it may be.
MODE_STEP: Final = 0.28  # rad of the mode's ring, where that leaves MODE_ERROR of its ring-down
MODE_ERROR: Final = 6e-10  # m (rad)
MODE_LEAST: Final = 0.01  # of such a ring: a smaller one has the steps of this one, 0.9 rad
LEAST_DAMPING: Final = 0.01  # of a mode, in that
BRISTLE_STEP: Final = 0.19  # of sqrt(openness (4 s0 / m1 + (speed / limit)^2)): a tenth of a radian of a stuck ring
BRISTLE_RING: Final = 1.2e4  # 1/m (1/rad): a ring of one over this, where such a step leaves 6e-11 m for each radian
BRISTLE_BENT: Final = 4.0  # a ring of half the limit, where friction is no spring any more, is such a ring too
BRISTLE_LEAST: Final = 0.001  # of such a ring: a smaller one has the steps of this one, half a radian
TURN_STEP: Final = 1e-8  # m (rad): eight times how far an axis comes to a stop within a step, where it may turn round
BREAKING_LOOSE: Final = 0.3  # of the dry friction, that may be gone within a piece
MOST_TURN_STEPS: Final = 16.0  # a piece: where accelerations are so large, positions are not judged by the nanometre
SLOPE_BROKEN: Final = 4.0  # where elements may slip, which breaks the force's slope: half as long a step
STICKING: Final = 0.999  # of its limit: less, and an element sticks
LINE_STEP: Final = 0.4  # rad of a sinusoid
SLOPE_STEP: Final = 0.1  # of the other rates
PEAK_STEP: Final = 0.08  # of v_s on the way through a Stribeck peak

Pair = tuple[Number, Number]  # position and velocity of a mass
Triple = tuple[Number, Number, Number]  # at the beginning, in the middle and at the end of a step


class Terms:
    """One axis (floats) or many that have the same terms (arrays)."""

    def __init__(self, structure: Structure, kind: int) -> None:
        """kind: bits of what the axes have, as `kind_bits` says."""
        s = structure
        self.has_bristle = bool(kind & 1)
        self.has_mode = bool(kind & 2)
        self.has_lag = bool(kind & 4)
        self.has_stribeck = bool(kind & 8)
        self.has_variation = bool(kind & 16)
        self.has_cable = bool(kind & 32)
        self.has_backlash = bool(kind & 64)
        self.has_cell = bool(kind & 128)
        self.n_slips = kind >> 18 & 7
        self.structure = structure
        self.kind = kind
        self.membrane = Membrane(s.surface, s.direction, s.membrane, s.puncture_depth, s.drag)
        self.motor_mass: Number = s.mass - s.load - s.hung_mass[0] - s.hung_mass[1]
        motor = self.motor_mass
        self.inverse_mass: Number = 1.0 / motor
        self.inverse_load: Number = 1.0 / s.load if self.has_mode else 0.0 * motor
        self.stiffness: Number = s.coulomb / s.presliding if self.has_bristle else 0.0 * motor
        self.peak: Number = s.presliding * s.stribeck / s.coulomb if self.has_bristle else 0.0 * motor
        self.inverse_limit: Number = 1.0 / s.presliding if self.has_bristle else 0.0 * motor
        self.inverse_lag: Number = 1.0 / s.lag if self.has_lag else 0.0 * motor
        count = kind >> 8 & 7
        self.lines: list[Triple] = [(s.line_amplitude[i], s.line_wavenumber[i], s.line_phase[i]) for i in range(count)]
        self.floor: list[Triple] = [
            (s.floor_amplitude[i], s.floor_frequency[i], s.floor_phase[i]) for i in range(kind >> 11 & 7)
        ]
        # Stiffness and damping of the spring of each mass hung beside the load, and the inverse of that mass
        self.hung: list[Triple] = [
            (s.hung_stiffness[i], s.hung_damping[i], 1.0 / s.hung_mass[i]) for i in range(kind >> 16 & 3)
        ]
        self._slowness: Number = s.slowness * (s.stribeck > 0.0)
        self._varying: list[Triple] = [(s.variation, s.variation_wavenumber, s.variation_phase)]
        self._lag_h: Number = -1.0
        self._lag_weights: Triple = (motor, motor, motor)
        self._set_rates(motor)

    def _set_rates(self, motor: Number) -> None:
        s = self.structure
        steepest = 3.0 * s.membrane * s.puncture_depth * s.puncture_depth
        rate = (abs(s.viscous) + s.drag) * self.inverse_mass + root(steepest * self.inverse_mass)
        rate = (rate + root(s.cable_stiffness * self.inverse_mass)) * (1.0 / SLOPE_STEP)
        self._ring_rate: Number = 0.0 * motor
        self._ring_time: Number = 0.0 * motor
        self._ring_scale: Number = 0.0 * motor
        if self.has_mode:
            self._ring_rate, self._ring_time, self._ring_scale = self._ring(
                s.mode_stiffness, s.mode_damping, self.inverse_load
            )
        self._hung_rings: list[Triple] = [self._ring(*spring) for spring in self.hung]
        per_speed, amplitudes = 0.0 * motor, abs(s.cable_hysteresis)
        for amplitude, wavenumber, _ in self.lines:
            per_speed = per_speed + (TURN / LINE_STEP) * wavenumber * (amplitude != 0.0)
            amplitudes = amplitudes + abs(amplitude)
            rate = rate + root(abs(amplitude) * wavenumber * TURN * self.inverse_mass) * (1.0 / SLOPE_STEP)
        if self.has_variation:
            per_speed = per_speed + (TURN / LINE_STEP) * s.variation_wavenumber * (s.variation != 0.0)
        for amplitude, frequency, _ in self.floor:
            rate = rate + (TURN / LINE_STEP) * frequency * (amplitude != 0.0)
        self._amplitudes: Number = amplitudes
        self._rate: Number = rate
        self._speed_rate: Number = per_speed + 2.0 * abs(s.quadratic) * self.inverse_mass * (1.0 / SLOPE_STEP)
        self._stuck_rate: Number = 4.0 * self.stiffness * self.inverse_mass
        self._compliance: Number = 0.0 * motor
        self._stuck_time: Number = 0.0 * motor
        if self.has_bristle:
            self._compliance, self._stuck_time = 1.0 / self.stiffness, root(motor / self.stiffness)

    def _ring(self, stiffness: Number, spring_damping: Number, inverse: Number) -> Triple:
        """Of a mass on a spring of the motor: rate, time and scale of its ring, as `effort` takes them."""
        softness = self.inverse_mass + inverse
        ring = root(stiffness * softness)
        damping = greater(0.5 * spring_damping * softness / ring, LEAST_DAMPING)
        return ring * (1.0 / MODE_STEP), 1.0 / ring, MODE_STEP**4 / (120.0 * MODE_ERROR) / damping

    def parameters(self) -> list[Number]:
        """Of one axis: all of its numbers, in the order of `axis` in sim_plant/native/dynamics.h."""
        values = [v for value in self.structure for v in (value if isinstance(value, tuple) else (value,))]
        of_motor = [self.inverse_mass, self.inverse_load, self.stiffness, self.peak, self.inverse_limit]
        of_ring = [self._ring_rate, self._ring_time, self._ring_scale]
        of_effort = [self._amplitudes, self._rate, self._speed_rate, self._stuck_rate]
        of_effort += [self._compliance, self._stuck_time]
        none = [0.0] * (HUNG - len(self.hung))
        of_hung = [value for spring in self.hung for value in spring[2:]] + none
        for place in range(3):
            of_hung += [ring[place] for ring in self._hung_rings] + none
        return [*values, *of_motor, self.inverse_lag, self._slowness, *of_ring, *of_effort, *of_hung]

    def hung_at(self, at: Motion) -> list[Pair]:
        """Position and velocity of each mass hung beside the load."""
        both = [(at.second_position, at.second_velocity), (at.third_position, at.third_velocity)]
        return both[: len(self.hung)]

    def slips_at(self, at: Motion) -> list[Number]:
        """By how much each Maxwell-slip element is bent (m)."""
        return [at.slip0, at.slip1, at.slip2, at.slip3][: self.n_slips]

    def _sticking(self, at: Motion, towards: Number) -> Number:
        """The part of the stiffness at rest whose elements stick in this direction."""
        s = self.structure
        stuck: Number = 0.0
        for bent, weight, reach in zip(self.slips_at(at), s.slip_weight, s.slip_reach, strict=False):
            stuck = stuck + select(towards * bent < STICKING * s.presliding * reach, weight, 0.0)
        return stuck

    def effort(self, at: Motion, forces: tuple[Number, Number], h: float) -> Number:
        """Steps that h seconds should be divided into, not rounded. forces: as in `step`."""
        s = self.structure
        external, command = forces
        drive = external + command
        speed = abs(at.velocity)
        push: Number = 0.0
        pull = s.mode_stiffness * abs(at.load_position - at.position) + s.cable_stiffness * abs(at.position)
        hung = self.hung_at(at) if self.hung else []
        for (stiffness, _, _), (p, _) in zip(self.hung, hung, strict=True):
            pull = pull + stiffness * abs(p - at.position)
        if self.has_bristle:  # friction changes with the motion alone, though fast where it breaks loose
            push = abs(drive - self.stiffness * at.bristle)
            pull = pull + push + BREAKING_LOOSE * s.coulomb
        else:
            pull = pull + abs(drive) + s.coulomb + s.stribeck
        if self.has_lag:
            pull = pull + abs(at.force - command)
        reach = h * (pull + self._amplitudes) * self.inverse_mass
        fastest = speed + reach
        work = h * (self._rate + fastest * self._speed_rate)
        if self.has_mode:
            swing = abs(at.load_position - at.position) + self._ring_time * abs(at.load_velocity - at.velocity)
            work = greater(work, h * self._ring_rate * root(root(greater(swing * self._ring_scale, MODE_LEAST))))
        for (rate, span, scale), (p, w) in zip(self._hung_rings, hung, strict=True):
            swing = abs(p - at.position) + span * abs(w - at.velocity)
            work = greater(work, h * rate * root(root(greater(swing * scale, MODE_LEAST))))
        if self.has_stribeck:
            nearest = speed - reach
            nearest = 0.5 * (nearest + abs(nearest))
            resolved = reach * self._slowness / (1.0 + nearest * self._slowness)
            work = greater(work, (0.5 / PEAK_STEP) * resolved)
        if self.has_bristle:
            towards = direction(at.velocity)
            openness = abs(1.0 - towards * at.bristle * self.inverse_limit)
            if self.n_slips:
                openness = SLOPE_BROKEN * self._sticking(at, towards)
            openness = select(speed <= reach, 2.0, openness)
            rushing = fastest * self.inverse_limit
            held = h * BREAKING_LOOSE * s.coulomb * self.inverse_mass  # no part of what turns it round
            bend = at.bristle * self.inverse_limit  # what turning round makes of friction grows with it
            turning = select(speed <= reach, bend * bend * abs(reach - held) * h * (1.0 / TURN_STEP), 0.0)
            turns = root(turning)
            work = greater(work, select(turns > MOST_TURN_STEPS, MOST_TURN_STEPS, turns))
            swing = push * self._compliance + speed * self._stuck_time
            part = swing * self.inverse_limit
            ring = greater(greater(swing * BRISTLE_RING, BRISTLE_BENT * part * part), BRISTLE_LEAST)
            ring = root(root(select(ring > 1.0, 1.0, ring)))
            work = greater(work, (h / BRISTLE_STEP) * ring * root(openness * (self._stuck_rate + rushing * rushing)))
        return work
