"""Down along z until a sensor shows a force, then up again by a stated way."""

from collections.abc import Sequence

import hil


class UntilForce(hil.Motion):
    """Speed in m/s, force in N, acceleration in m/s^2; up: m to go back; safe: height to which the rig leads the tip
    before it stops, m.
    """

    def __init__(
        self,
        rig: hil.Surroundings,
        speed: float = 2e-4,
        force: float = 1e-4,
        up: float = 1e-4,
        bend: float = 1.0,
        safe: float = 0.0,
    ) -> None:
        if "z" not in rig.axes:
            raise ValueError(f"axes = {list(rig.axes)}: it needs a z")
        self.z, self.period, self.speed, self.force = rig.axes.index("z"), rig.period, speed, force
        self.up, self.bend = up, bend
        self.retreat = hil.Retreat("z", safe, -1)

    def begin(self, position: Sequence[float]) -> None:
        self.place, self.moving, self.touched = list(position), 0.0, False

    def step(self, seen: hil.Observation) -> hil.References:
        reading = seen.readings[0]
        if not self.touched and reading.valid and reading.value > self.force:
            self.touched, self.back_at = True, self.place[self.z] + self.up
        wanted = -self.speed
        if self.touched:
            wanted = self.speed if self.place[self.z] < self.back_at else 0.0
        change = max(-self.bend * self.period, min(self.bend * self.period, wanted - self.moving))
        self.place[self.z] += (self.moving + 0.5 * change) * self.period
        self.moving += change
        still = [0.0] * len(self.place)
        velocity, acceleration = list(still), list(still)
        velocity[self.z], acceleration[self.z] = self.moving, change / self.period
        over = self.touched and self.moving == 0.0 and wanted == 0.0
        return hil.References(list(self.place), velocity, acceleration, phase=int(self.touched), done=over)
