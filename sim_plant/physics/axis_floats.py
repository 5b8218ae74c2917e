"""One axis of floats: the formulas of axis.py with parameters bound and absent terms left out.

It costs two thirds of the general ones where friction is all that acts, a third with ripple and a Stribeck peak.

A lockstep run and the live emulator spend their time here, one axis at a time, where an array of one costs more than
the arithmetic. Every operation comes in the order it has in axis.py, friction.py and membrane.py, so that the bits are
the same (tests/sim_plant/test_stage.py compares them with the batch); events, which are rare, are left to
`advance_piece` there.
"""

from collections.abc import Callable

from sim_plant.physics.axis import ACCURACY, MAX_SUBSTEPS, STRIBECK_WEIGHT, Axis, State, advance_piece
from sim_plant.physics.exact_trigonometry import sin_turns
from sim_plant.physics.friction import breakaway

NetForce = Callable[[float, float, float, float], float]  # of position, velocity, pierced, drive
Step = Callable[[float, float, float, float, float, float], tuple[float, float]]  # the same, sign, h


class SingleAxis:
    """An axis in motion. position: m. velocity: m/s. pierced: 1.0 or 0.0."""

    __slots__ = ("_effort", "_hold", "_is_due", "_net_force", "_step", "axis", "pierced", "position", "velocity")

    def __init__(self, axis: Axis, position: float, velocity: float, pierced: float) -> None:
        self.axis = axis
        self.position = position
        self.velocity = velocity
        self.pierced = pierced
        self._hold = breakaway(axis.friction)
        self._net_force = net_force_of(axis)
        self._step = smooth_step_of(axis) if axis.has_ripple or axis.has_cell else friction_step_of(axis)
        self._effort = effort_of(axis)
        self._is_due = transition_of(axis) if axis.has_cell else None

    @property
    def state(self) -> State:
        """Position, velocity, pierced."""
        return State(self.position, self.velocity, self.pierced)

    def restore(self, state: State) -> None:
        """Back to a state it had."""
        self.position, self.velocity, self.pierced = state

    def advance(self, pieces: int, h: float, drive: float) -> None:
        """Advance by `pieces` of h seconds each, `drive` (N, gravity included) held."""
        if self.velocity == 0.0 and self._is_held(drive):
            return  # and nothing changes until the force does
        for _ in range(pieces):
            work, count = self._effort(self.velocity, drive, h), 1
            while count * ACCURACY < work and count < MAX_SUBSTEPS:
                count *= 2
            short = h / count
            for _ in range(count):
                self._advance_substep(drive, short)

    def _is_held(self, drive: float) -> bool:
        net = self._net_force(self.position, self.velocity, self.pierced, drive)
        return not abs(net) > self._hold

    def _advance_substep(self, drive: float, h: float) -> None:
        """As `advance_piece`, which takes over where something happens on the way."""
        velocity = self.velocity
        if velocity != 0.0:
            sign = 1.0 if velocity > 0.0 else -1.0
            position, end = self._step(self.position, velocity, self.pierced, drive, sign, h)
            if end * sign > 0.0 and not (self._is_due and self._is_due(position, self.pierced)):
                self.position, self.velocity = position, end
                return
        self.position, self.velocity, self.pierced = advance_piece(self.axis, self.state, drive, h)


def net_force_of(axis: Axis) -> NetForce:
    """`axis.net_force` of this axis."""
    amplitude, wavenumber = float(axis.ripple_amplitude), float(axis.ripple_wavenumber)
    surface, direction, stiffness, _, drag = map(float, axis.membrane)
    has_ripple = axis.has_ripple

    def free(_position: float, _velocity: float, _pierced: float, drive: float) -> float:
        return drive

    def on_ripple(position: float, _velocity: float, _pierced: float, drive: float) -> float:
        return drive + amplitude * sin_turns(position * wavenumber)

    def at_cell(position: float, velocity: float, pierced: float, drive: float) -> float:
        force = drive + amplitude * sin_turns(position * wavenumber) if has_ripple else drive
        inside = (position - surface) * direction
        if inside <= 0.0 and not pierced:
            return force  # the rest would be zero
        indentation = 0.5 * (inside + abs(inside))
        elastic = stiffness * indentation * indentation * indentation
        return force - ((1.0 - pierced) * direction * elastic + pierced * drag * velocity)

    if axis.has_cell:
        return at_cell
    return on_ripple if has_ripple else free


def smooth_step_of(axis: Axis) -> Step:
    """`axis.runge_kutta` of an axis whose force depends on position."""
    net_force = net_force_of(axis)
    amplitude, wavenumber = float(axis.ripple_amplitude), float(axis.ripple_wavenumber)
    coulomb, stribeck, slowness, viscous, quadratic = map(float, axis.friction)
    inverse_mass = float(axis.inverse_mass)

    def on_ripple(position: float, velocity: float, _pierced: float, drive: float, sign: float) -> float:
        force = drive + amplitude * sin_turns(position * wavenumber)
        ratio = velocity * slowness
        dry = coulomb + stribeck / (1.0 + ratio * ratio) + quadratic * velocity * velocity
        return (force - (sign * dry + viscous * velocity)) * inverse_mass

    def at_cell(position: float, velocity: float, pierced: float, drive: float, sign: float) -> float:
        force = net_force(position, velocity, pierced, drive)
        ratio = velocity * slowness
        dry = coulomb + stribeck / (1.0 + ratio * ratio) + quadratic * velocity * velocity
        return (force - (sign * dry + viscous * velocity)) * inverse_mass

    slope = at_cell if axis.has_cell else on_ripple

    def step(
        position: float, velocity: float, pierced: float, drive: float, sign: float, h: float
    ) -> tuple[float, float]:
        half, sixth = 0.5 * h, h * (1.0 / 6.0)
        a1 = slope(position, velocity, pierced, drive, sign)
        v2 = velocity + half * a1
        a2 = slope(position + half * velocity, v2, pierced, drive, sign)
        v3 = velocity + half * a2
        a3 = slope(position + half * v2, v3, pierced, drive, sign)
        v4 = velocity + h * a3
        a4 = slope(position + h * v3, v4, pierced, drive, sign)
        return (
            position + sixth * (velocity + 2.0 * (v2 + v3) + v4),
            velocity + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        )

    return step


def friction_step_of(axis: Axis) -> Step:
    """`axis.runge_kutta` of an axis on which only friction acts: nothing depends on position."""
    coulomb, stribeck, slowness, viscous, quadratic = map(float, axis.friction)
    inverse_mass = float(axis.inverse_mass)

    def plain(velocity: float, drive: float, sign: float) -> float:
        dry = coulomb + quadratic * velocity * velocity
        return (drive - (sign * dry + viscous * velocity)) * inverse_mass

    def with_stribeck(velocity: float, drive: float, sign: float) -> float:
        ratio = velocity * slowness
        dry = coulomb + stribeck / (1.0 + ratio * ratio) + quadratic * velocity * velocity
        return (drive - (sign * dry + viscous * velocity)) * inverse_mass

    slope = with_stribeck if axis.has_stribeck else plain

    def step(
        position: float, velocity: float, _pierced: float, drive: float, sign: float, h: float
    ) -> tuple[float, float]:
        half, sixth = 0.5 * h, h * (1.0 / 6.0)
        a1 = slope(velocity, drive, sign)
        v2 = velocity + half * a1
        a2 = slope(v2, drive, sign)
        v3 = velocity + half * a2
        a3 = slope(v3, drive, sign)
        v4 = velocity + h * a3
        a4 = slope(v4, drive, sign)
        return (
            position + sixth * (velocity + 2.0 * (v2 + v3) + v4),
            velocity + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        )

    return step


def effort_of(axis: Axis) -> Callable[[float, float, float], float]:
    """`axis.effort` of this axis, by velocity, drive and h."""
    rate, speed_rate, inverse_mass = float(axis.rate), float(axis.speed_rate), float(axis.inverse_mass)
    coulomb, stribeck, slowness, _, _ = map(float, axis.friction)
    slowness *= stribeck > 0

    def plain(velocity: float, drive: float, h: float) -> float:
        return h * (rate + abs(velocity) * speed_rate)

    def with_stribeck(velocity: float, drive: float, h: float) -> float:
        speed = abs(velocity)
        dry = coulomb if velocity >= 0.0 else -coulomb
        reach = h * (abs(drive - dry) + stribeck) * inverse_mass
        nearest = speed - reach
        nearest = 0.5 * (nearest + abs(nearest))
        resolved = STRIBECK_WEIGHT * (reach * slowness / (1.0 + nearest * slowness))
        return h * (rate + speed * speed_rate) + resolved

    return with_stribeck if axis.has_stribeck else plain


def transition_of(axis: Axis) -> Callable[[float, float], bool]:
    """Whether `membrane.transition` of this axis is due, by position and pierced."""
    surface, direction, _, puncture_depth, _ = map(float, axis.membrane)

    def is_due(position: float, pierced: float) -> bool:
        inside = (position - surface) * direction
        distance = inside - puncture_depth - pierced * (2.0 * inside - puncture_depth)
        return distance >= 0.0

    return is_due
