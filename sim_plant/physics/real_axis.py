"""One axis of floats that deviates from the ideal one: what integrates it, what disturbs it, and how time passes."""

from collections.abc import Sequence

from sim_plant.physics.axis import Axis
from sim_plant.physics.disturbance import Disturbance
from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.encoder import KEPT, Point
from sim_plant.physics.events import advance_single
from sim_plant.physics.noise import Key
from sim_plant.physics.single_axis import SingleAxis
from sim_plant.physics.structure import Motion, rigid, with_walk


def disturbance_of(density: float, walk: float, seed: Key, axis: Key) -> Disturbance:
    """That of an axis of floats."""
    return Disturbance(density, walk, seed, axis)


def piece_times(begin: float, h: float, number: int) -> list[float]:
    """When pieces of h seconds from `begin` on begin, s."""
    return [begin + index * h for index in range(number)]


class RealAxis:
    """One axis that deviates. motion: its state. past: where its pieces began, oldest first. The others: as given."""

    def __init__(
        self, engine: Dynamics | Axis, motion: Motion, constant: float, disturbance: Disturbance | None
    ) -> None:
        """constant: N, gravity and bias."""
        self.motion = motion
        self.past: tuple[Point, ...] = ()
        self.engine = engine
        self.constant = constant
        self.disturbance = disturbance

    @property
    def state(self) -> tuple[Motion, tuple[Point, ...]]:
        """What `restore` takes."""
        return self.motion, self.past

    def restore(self, state: tuple[Motion, tuple[Point, ...]]) -> None:
        """Back to a state it had."""
        self.motion, self.past = state

    @property
    def position(self) -> float:
        """The tool's, m."""
        position: float = self.motion.played
        return position

    @property
    def velocity(self) -> float:
        """The load's, m/s."""
        velocity: float = self.motion.load_velocity
        return velocity

    @property
    def pierced(self) -> float:
        """1.0 or 0.0."""
        pierced: float = self.motion.pierced
        return pierced

    def advance(self, times: Sequence[float], h: float, command: float, count: int) -> None:
        """Advance by pieces of h seconds that begin at these times (s); `count`: pieces before."""
        for index, time in enumerate(times):
            external, motion = self.constant, self.motion
            self.past = (*self.past[1 - KEPT :], (time, motion.position, motion.velocity))
            disturbance = self.disturbance
            if disturbance is not None:
                force, walked = disturbance.draw(motion.walked, count + index, h)
                external, motion = external + force, with_walk(motion, walked)
            engine = self.engine
            if isinstance(engine, Dynamics):
                self.motion = advance_single(engine, motion, time, (external, command), h)
            else:
                alone = SingleAxis(engine, motion.position, motion.velocity, motion.pierced)
                alone.advance(1, h, command + external)
                self.motion = rigid(motion, alone.position, alone.velocity, alone.pierced)
