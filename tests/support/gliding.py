"""A dish of cells, and a stage without friction that glides over it."""

from typing import Any

from sim_plant.dish_config import DishConfig
from sim_plant.physics.dish import Dish, DishCell

MS = 1_000_000
AXES = ["x", "y", "z"]
ROW = [[0.0, 0.0], [1.5e-3, 0.2e-3], [3.0e-3, 0.4e-3]]


class Gliding:
    """A stage without friction whose tip moves at a given speed. It stands for the physics, and feels the forces."""

    def __init__(self, position: list[float], velocity: list[float]) -> None:
        self.positions, self.velocities = position, velocity
        self.forces: list[float] = []

    def advance(self, duration_ns: int, force: Any) -> None:
        self.forces.append(force[2])
        self.positions = [q + v * duration_ns * 1e-9 for q, v in zip(self.positions, self.velocities, strict=True)]

    def to(self, dish: Dish, now_ns: int, duration_ns: int, velocity: list[float]) -> int:
        self.velocities = velocity
        for begin_ns in range(now_ns, now_ns + duration_ns, MS):
            dish.advance(self, begin_ns, MS, [0.0, 0.0, 0.0])
        return now_ns + duration_ns


def dish_of(**changes: Any) -> Dish:
    return Dish(DishConfig(**({"positions": ROW, "top": -1e-3, "spread": False} | changes)), AXES)


def stabbed(dish: Dish, x: float, y: float, z: float = -0.9e-3) -> DishCell | None:
    """Lowered by 400 um there, and lifted again."""
    stage = Gliding([x, y, z], [0.0, 0.0, 0.0])
    now_ns = stage.to(dish, 0, 400 * MS, [0.0, 0.0, -1e-3])
    met = dish.entered
    stage.to(dish, now_ns, 500 * MS, [0.0, 0.0, 1e-3])
    return met
