"""One ideal axis of floats in motion: substeps as long as accuracy allows, and every event located to rounding.

A lockstep run and the live emulator spend their time here, one axis at a time, where an array of one costs more than
the arithmetic. Events are stops, breakaways and punctures: integration restarts at each, so that nothing chatters at
zero speed.
"""

from typing import Final

from sim_plant.physics.axis import ACCURACY, MAX_SUBSTEPS, Axis, AxisValues, State

MAX_EVENTS: Final = 8  # of one substep; more cannot happen under a constant force
MAX_ITERATIONS: Final = 60


def axis_of(values: AxisValues) -> Axis:
    """The axis of floats that has these values (floats)."""
    return Axis(values)


class SingleAxis:
    """An axis in motion. position: m. velocity: m/s. pierced: 1.0 or 0.0."""

    def __init__(self, axis: Axis, position: float, velocity: float, pierced: float) -> None:
        self.axis = axis
        self.position = position
        self.velocity = velocity
        self.pierced = pierced

    @property
    def state(self) -> State:
        """Position, velocity, pierced."""
        return State(self.position, self.velocity, self.pierced)

    def restore(self, state: State) -> None:
        """Back to a state it had."""
        self.position, self.velocity, self.pierced = state

    def advance(self, pieces: int, h: float, drive: float) -> None:
        """Advance by `pieces` of h seconds each, `drive` (N, gravity included) held."""
        axis = self.axis
        if self.velocity == 0.0 and breakaway_sign(axis, self.position, self.pierced, drive) == 0.0:
            return  # friction holds it, and nothing changes until the force does
        for _ in range(pieces):
            work, count = axis.effort(self.velocity, drive, h), 1
            while count * ACCURACY < work and count < MAX_SUBSTEPS:
                count *= 2
            short = h / count
            for _ in range(count):
                self.advance_substep(drive, short)

    def advance_substep(self, drive: float, h: float) -> None:
        """Advance by h seconds, through every stop, breakaway and puncture on the way."""
        axis, velocity = self.axis, self.velocity
        if velocity != 0.0:
            sign = 1.0 if velocity > 0.0 else -1.0
            position, end = axis.step(self.position, velocity, self.pierced, drive, sign, h)
            if end * sign > 0.0 and not (axis.has_cell and axis.membrane.transition(position, self.pierced) >= 0.0):
                self.position, self.velocity = position, end
                return
        self._advance_through_events(drive, h)

    def _advance_through_events(self, drive: float, h: float) -> None:
        axis, remaining = self.axis, h
        for _ in range(MAX_EVENTS):
            velocity, pierced = self.velocity, self.pierced
            sign = 1.0 if velocity > 0.0 else -1.0 if velocity < 0.0 else 0.0
            if sign == 0.0:
                sign = breakaway_sign(axis, self.position, pierced, drive)
                if sign == 0.0:
                    return
            position, end = axis.step(self.position, velocity, pierced, drive, sign, remaining)
            stops = end * sign <= 0.0
            if stops and velocity == 0.0:
                return  # net force and friction differ by less than rounding: it stays
            tau = remaining
            if stops:
                guess = remaining * velocity / (velocity - end)
                tau, position, _ = self._first_instant(drive, sign, remaining, guess, True)
                end = 0.0
            if axis.has_cell and axis.membrane.transition(position, pierced) >= 0.0:
                tau, position, end = self._first_instant(drive, sign, tau, 0.5 * tau, False)
                self.pierced = 1.0 - pierced
            self.position, self.velocity = position, end
            remaining -= tau
            if remaining <= 0.0:
                return

    def _first_instant(
        self, drive: float, sign: float, h: float, guess: float, stops: bool
    ) -> tuple[float, float, float]:
        """(time, position, velocity) of the event within (0, h]: velocity zero, or else the membrane's transition.

        Newton's method, kept inside a bracket by bisection; the function is the Runge-Kutta step itself as a function
        of its length.
        """
        axis, pierced = self.axis, self.pierced
        low, high, tau = 0.0, h, guess
        position, velocity = self.position, self.velocity
        for _ in range(MAX_ITERATIONS):
            position, velocity = axis.step(self.position, self.velocity, pierced, drive, sign, tau)
            if stops:
                value = -sign * velocity
                slope = -sign * axis.acceleration(position, velocity, pierced, drive, sign)
            else:
                value = axis.membrane.transition(position, pierced)
                slope = axis.membrane.direction * velocity * (1.0 - 2.0 * pierced)
            if value > 0.0:
                high = tau
            else:
                low = tau
            following = tau - value / slope if slope > 0.0 else 0.5 * (low + high)
            if abs(following - tau) <= 1e-15 * h:
                break
            tau = following if low < following < high else 0.5 * (low + high)
        return tau, position, velocity


def breakaway_sign(axis: Axis, position: float, pierced: float, drive: float) -> float:
    """Direction in which an axis at rest starts to slide; 0.0: friction holds it."""
    net = axis.net_force(position, 0.0, pierced, drive)
    return 1.0 if net > axis.hold else -1.0 if net < -axis.hold else 0.0
