"""A stage that users bring in place of our physics: how its axes move under forces. Interpreted in every build."""

import contextlib
import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.base import plugins
from drivers.base.guard import BadAnswerError, Guard
from sim_plant.config import STAGE_KIND, PlantConfig, PlantError
from sim_plant.physics.stage import Stage, Truth

Array = NDArray[np.float64]
PIECE_S = 250e-6  # of the base class' integration


class Plant:
    """A stage of your own. Arrays are (n_axes,), SI; what is here integrates `acceleration`, so that it is often enough
    to write that one method. What has states of its own overrides `advance`, too.

        class Spring(hil.Plant):
            def __init__(self, truth, stiffness=100.0):
                super().__init__(truth)
                self.stiffness = stiffness

            def acceleration(self, position, velocity, force):
                return (force - self.stiffness * position) / self.truth.mass

    truth: what [plant] says, its scales applied: mass, coulomb, viscous, quadratic, gravity and others; the fault
    campaign and sweeps change it. Parameters are those of [plant.parameters]. position, velocity: now; `begin` sets
    them. time: s since the beginning.
    """

    def __init__(self, truth: Truth, **parameters: Any) -> None:
        self.truth = truth
        self.time = 0.0
        self.position = self.velocity = np.zeros(0)

    def begin(self, position: Array) -> None:
        """At rest at `position`, m."""
        self.position, self.velocity = position.copy(), np.zeros(position.shape)

    def reading(self) -> Array:
        """What the encoders show, m: the position, unless your class says otherwise."""
        return self.position

    def acceleration(self, position: Array, velocity: Array, force: Array) -> Array:
        """m/s^2 under the drives' `force` (N)."""
        raise NotImplementedError

    def advance(self, seconds: float, force: Array, held: Array) -> None:
        """Let time pass under a constant `force` (N). held: dry friction of brakes and jams beyond the stage's own, N.

        The classical Runge-Kutta step; an axis that is held stops within a piece, and stays while less pulls at it.
        """
        pieces = max(1, round(seconds / PIECE_S))
        h = seconds / pieces
        for _ in range(pieces):
            self._step(h, force, held / self.truth.mass)
            self.time += h

    def _step(self, h: float, force: Array, grip: Array) -> None:
        q, v = self.position, self.velocity
        free = np.asarray(self.acceleration(q, v, force), dtype=np.float64)
        drag = grip * np.where(v != 0.0, np.sign(v), np.sign(free))
        stops = (grip > 0.0) & (np.abs(free) <= grip) & (v * (v + h * (free - drag)) <= 0.0)

        def slope(x: Array, u: Array) -> Array:
            return np.asarray(self.acceleration(x, u, force), dtype=np.float64) - drag

        a1 = free - drag
        a2 = slope(q + 0.5 * h * v, v + 0.5 * h * a1)
        a3 = slope(q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2)
        a4 = slope(q + h * v + 0.5 * h * h * a2, v + h * a3)
        self.position = np.where(stops, q + 0.5 * h * v, q + h * v + h * h / 6.0 * (a1 + a2 + a3))
        self.velocity = np.where(stops, 0.0, v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4))


def stage_of(plant: PlantConfig, truth: Truth, position: ArrayLike) -> Stage:
    """The rig's stage, or a batch of them, at rest at `position` (m). Raises ValueError where a user's is none."""
    return Stage(truth, position) if plant.stage in STAGE_KIND.ours else UserStage(plant, truth, position)


def stage_problems(plant: PlantConfig, axis_names: Sequence[str]) -> list[str]:
    """Why a stage that users bring is none: it is made, and lives for a tenth of a second without force."""
    if plant.stage in STAGE_KIND.ours:
        return []
    try:
        truth = Truth.from_config(plant, len(axis_names), axis_names)
        stage = stage_of(plant, truth, plant.initial_position)
        for _ in range(100):
            stage.advance(1_000_000, [0.0] * len(axis_names))
    except (ValueError, PlantError) as error:
        return [str(error)]
    return []


class UserStage(Stage):
    """One stage or a batch (..., n_axes) of stages that users bring: an object each, with its own encoders.

    Whatever it raises, or returns that is no position, is a PlantError that names the file and the line.
    """

    def __init__(self, plant: PlantConfig, truth: Truth, position: ArrayLike) -> None:
        self.truth = truth
        made = plugins.find(STAGE_KIND, plant.stage, plant.source)
        self._guard = Guard(STAGE_KIND, plant.stage, made, PlantError)
        self._places = list(np.ndindex(truth.shape[:-1]))
        self._held = np.zeros(truth.shape)
        start = np.array(np.broadcast_to(np.asarray(position, dtype=np.float64), truth.shape))
        making = Guard(STAGE_KIND, plant.stage, made)
        self._plants = [
            making.call("it cannot be made", made, _part(truth, place), **plant.parameters) for place in self._places
        ]
        for each, place in zip(self._plants, self._places, strict=True):
            self._guard.call("", each.begin, start[place])
        self._look()

    def _look(self) -> None:
        """Take over where every plant is, and what its encoders show."""
        self._q, self._v, self._shown = (np.empty(self.truth.shape) for _ in range(3))
        for each, place in zip(self._plants, self._places, strict=True):
            shows = getattr(each, "reading", None)  # a class that is no hil.Plant may have none
            shown = each.position if shows is None else self._guard.call("", shows)
            told = (
                ("position", getattr(each, "position", None), self._q),
                ("velocity", getattr(each, "velocity", None), self._v),
                ("reading", shown, self._shown),
            )
            for name, said, target in told:
                value = np.asarray(said, dtype=np.float64)
                if value.shape != target[place].shape or not np.isfinite(value).all():
                    bad = f"its {name} is {value.tolist()}, expected {target.shape[-1]} finite numbers"
                    raise PlantError(self._guard.told("", BadAnswerError(bad)))
                target[place] = value

    def clamp(self, force: ArrayLike) -> None:
        """See Stage."""
        self._held = np.array(np.broadcast_to(np.asarray(force, dtype=np.float64), self.truth.shape))

    def stand(self, force: ArrayLike) -> None:
        """See Stage; no lag of ours is in it."""

    def change(self, truth: Truth) -> None:
        """See Stage."""
        self.truth = truth
        for each, place in zip(self._plants, self._places, strict=True):
            each.truth = _part(truth, place)

    def advance(self, duration_ns: int, force: Sequence[float] | Array) -> None:
        """See Stage."""
        if duration_ns <= 0:
            return
        forces = np.broadcast_to(np.asarray(force, dtype=np.float64), self.truth.shape)
        for each, place in zip(self._plants, self._places, strict=True):
            self._guard.call("", each.advance, duration_ns * 1e-9, forces[place].copy(), self._held[place].copy())
        self._look()

    @property
    def position(self) -> Array:
        """See Stage."""
        return self._q

    @property
    def velocity(self) -> Array:
        """See Stage."""
        return self._v

    @property
    def pierced(self) -> Array:
        """See Stage; a user's stage has no cells of ours."""
        return np.zeros(self.truth.shape)

    @property
    def positions(self) -> list[float]:
        """See Stage."""
        found: list[float] = self._q.tolist()
        return found

    @property
    def velocities(self) -> list[float]:
        """See Stage."""
        found: list[float] = self._v.tolist()
        return found

    def readings(self) -> list[float]:
        """See Stage."""
        found: list[float] = self._shown.tolist()
        return found

    def reading(self, index: int) -> float:
        """See Stage."""
        return float(self._shown[index])

    def read(self) -> Array:
        """See Stage."""
        return self._shown

    def peek(self, duration_ns: int, force: Sequence[float] | Array) -> tuple[Array, Array, Array]:
        """See Stage."""
        with self._ahead(duration_ns, force):
            return self._q.copy(), self._v.copy(), self.pierced

    def peek_reading(self, duration_ns: int, force: Sequence[float], index: int) -> float:
        """See Stage."""
        with self._ahead(duration_ns, force):
            return float(self._shown[index])

    @contextlib.contextmanager
    def _ahead(self, duration_ns: int, force: Sequence[float] | Array) -> Iterator[None]:
        """As it will be; afterwards it is as it was."""
        before = self._plants, self._q, self._v, self._shown
        if duration_ns > 0:
            self._plants = [copy.deepcopy(each) for each in self._plants]
        try:
            self.advance(duration_ns, force)
            yield
        finally:
            self._plants, self._q, self._v, self._shown = before


def _part(truth: Truth, place: tuple[int, ...]) -> Truth:
    """The truth of one stage of a batch."""
    parts: Mapping[str, Any] = {name: getattr(truth, name)[place].copy() for name in Truth.__dataclass_fields__}
    return Truth(**parts)
