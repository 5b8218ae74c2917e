"""Whether an axis pushes against something instead of moving: at its force limit, or far behind where it should be."""

from typing import Final

PRESS_S: Final = 0.015  # that it lasts
BEHIND: Final = 0.3  # of limits.following_error
AT_LIMIT: Final = 0.98  # of the force it may have
STILL: Final = 0.25  # of the least speed of homing: slower is no motion


class PressWatch:
    """force: N that the axis may have. behind: m. speed: m/s, the least that it homes with."""

    def __init__(self, force: float, following_error: float, speed: float, period_s: float) -> None:
        self._force, self._behind = AT_LIMIT * force, BEHIND * following_error
        self._ticks = max(2, round(PRESS_S / period_s))
        self._still = STILL * speed * self._ticks * period_s
        self.restart()

    def restart(self) -> None:
        """It has another way to go."""
        self._for = 0
        self._from = 0.0

    def take(self, position: float, planned: float, velocity: float, force: float) -> bool:
        """One tick: measured and planned position, m, planned velocity, m/s, and force, N. Whether it is blocked."""
        late = (planned - position) * velocity > self._behind * abs(velocity)
        pushes = force * velocity >= self._force * abs(velocity) and velocity != 0.0
        if not self._for or not (late or pushes):
            self._from = position
            self._for = int(late or pushes)
            return False
        if abs(position - self._from) > self._still and not late:
            self._for, self._from = 1, position
            return False
        self._for += 1
        return self._for >= self._ticks
