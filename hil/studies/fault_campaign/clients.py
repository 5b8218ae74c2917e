"""Who asks a rig for motion while the campaign looks at it: one client for each motion word.

A client goes on asking after the injection, as nobody has told it: what it asks for then must have no effect.
"""

from collections.abc import Callable, Sequence

from hil.control.plans.axis_plan import AxisPlan
from hil.control.plans.together import moves
from hil.cycle.goal import Goal, GoalKind, Values
from hil.cycle.limits import motion_limits
from hil.rig.schema import RigConfig

JOG_S = 0.1  # of which the next jog comes in the middle
KNOT_S, AHEAD_S = 0.01, 0.02  # of a stream
Client = Callable[[int], list[Goal]]  # by ticks since the rig began to hold


def _values(values: Sequence[float]) -> Values:
    one, two, three, four = (*values, 0.0, 0.0, 0.0, 0.0)[:4]
    return one, two, three, four


def way_into_the_fence(rig: RigConfig, start: Sequence[float]) -> list[AxisPlan]:
    """All axes from rest at `start` to their upper fence, begun and ended together."""
    limits = motion_limits(rig)
    return moves([(place, 0.0, 0.0) for place in start], [li.high for li in limits], limits)


class _Clients:
    """What asks a rig for motion that rests at `start`, m by axis."""

    def __init__(self, rig: RigConfig, start: Sequence[float]) -> None:
        self._period = rig.period_ns * 1e-9
        self._way = way_into_the_fence(rig, start)
        self._fence = _values([li.high for li in motion_limits(rig)])
        self._ticks = round(self._way[0].ends / self._period)

    def _every(self, seconds: float, k: int) -> bool:
        return k % round(seconds / self._period) == 0

    def hold(self, k: int) -> list[Goal]:
        return []

    def move(self, k: int) -> list[Goal]:
        return [Goal(k + 1, GoalKind.MOVE, position=self._fence)] if k == 0 else []

    def jog(self, k: int) -> list[Goal]:
        """A key that stays pressed."""
        speeds = _values([(plan.target - plan.at(0.0)[0]) / plan.ends for plan in self._way])
        asks = self._every(0.5 * JOG_S, k)
        return [Goal(k + 1, GoalKind.JOG, velocity=speeds, valid_ns=round(JOG_S * 1e9))] if asks else []

    def stream(self, k: int) -> list[Goal]:
        """The way into the fence as knots, and then its end for ever."""
        if not self._every(KNOT_S, k):
            return []
        found = [plan.at(k * self._period + AHEAD_S) for plan in self._way]
        place, speed = _values([p for p, _, _ in found]), _values([v for _, v, _ in found])
        return [Goal(k + 1, GoalKind.KNOT, due_ns=round(AHEAD_S * 1e9), position=place, velocity=speed)]

    def halt(self, k: int) -> list[Goal]:
        """In the middle of a move."""
        return [Goal(k + 1, GoalKind.HALT)] if k == self._ticks // 2 else self.move(k)

    def path(self, k: int) -> list[Goal]:
        return [Goal(k + 1, GoalKind.PATH)] if k == 0 else []


def _paused(clients: _Clients, at: int) -> Client:
    """The path is paused at tick `at`."""
    return lambda k: [Goal(k + 1, GoalKind.RATE, speed=0.0)] if k == at else clients.path(k)


def client(rig: RigConfig, start: Sequence[float], motion: str) -> Client:
    """What asks for a motion of `motion_points`, of a rig at rest at `start`, m by axis."""
    clients = _Clients(rig, start)
    word, _, at = motion.partition(" ")
    return _paused(clients, int(at)) if at else getattr(clients, word)
