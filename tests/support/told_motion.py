"""Motions for tests: one that does what it is told, one that goes to and fro by itself."""

from collections.abc import Callable, Sequence
from typing import Any

import hil


class Told(hil.Motion):
    """told: its step, put there by the test."""

    def __init__(self, rig: hil.Surroundings) -> None:
        self.told: Callable[[hil.Observation], Any] | None = None

    def begin(self, position: Sequence[float]) -> None:
        self.place = list(position)

    def step(self, seen: hil.Observation) -> Any:
        assert self.told is not None
        return self.told(seen)


class ToAndFro(hil.Motion):
    """Along x by the way that constant acceleration makes, with a pulse at every turn."""

    def __init__(self, rig: hil.Surroundings, acceleration: float = 0.2) -> None:
        self.n, self.period, self.bend = len(rig.axes), rig.period, acceleration

    def begin(self, position: Sequence[float]) -> None:
        self.place, self.speed = list(position), 0.0

    def step(self, seen: hil.Observation) -> hil.References:
        bend = self.bend if seen.tick % 200 < 100 else -self.bend
        before = self.speed
        self.speed += bend * self.period
        self.place[0] += 0.5 * (before + self.speed) * self.period
        rest = [0.0] * (self.n - 1)
        return hil.References(
            list(self.place), [self.speed, *rest], [bend, *rest], outputs=int(seen.tick % 200 == 0), phase=1
        )


class Inside(Told):
    """As it is told, with a way out: along `axis` to `position`, m."""

    def __init__(self, rig: hil.Surroundings, axis: str = "z", position: float = -0.001, direction: int = -1) -> None:
        super().__init__(rig)
        self.retreat = hil.Retreat(axis, position, direction)


class DownAndFail(hil.Motion):
    """Down along z, and a failure 1.5 mm below where it began; its way out leads to 1 mm below."""

    def __init__(self, rig: hil.Surroundings) -> None:
        self.retreat = hil.Retreat("z", -0.001, -1)
        self.period = rig.period

    def begin(self, position: Sequence[float]) -> None:
        self.place, self.speed = list(position), 0.0

    def step(self, seen: hil.Observation) -> hil.References:
        self.speed = max(self.speed - 2e-5, -0.01)
        self.place[2] += self.speed * self.period
        if self.place[2] < -0.0015:
            raise RuntimeError("as the test wants it")
        return hil.References(list(self.place), [0.0, 0.0, self.speed, 0.0], phase=3)
