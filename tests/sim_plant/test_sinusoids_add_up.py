"""Cogging and the floor's motion: as many lines as an axis may have act, each with all of its amplitude."""

import pytest

from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth

MS = 1_000_000


def way(**effects: object) -> list[float]:
    """Positions of a free axis that nothing pushes, m, a millisecond apart."""
    plant = PlantConfig(mass=[0.5], coulomb=[0.0], viscous=[1.0], quadratic=[0.0], initial_position=[1e-3], **effects)
    stage, found = Stage(Truth.from_config(plant, 1, ["x"])), []
    for _ in range(30):
        stage.advance(MS, [0.0])
        found.append(stage.positions[0])
    return found


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_lines_of_the_floor_add_up(count: int) -> None:
    def line(acceleration: float) -> dict[str, object]:
        return {"axis": "x", "acceleration": acceleration, "frequency_hz": 31.0, "phase": 0.5}

    one = way(vibration=[line(0.25 * count)])
    assert max(abs(place - 1e-3) for place in one) > 1e-6
    assert way(vibration=[line(0.25)] * count) == pytest.approx(one, rel=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_harmonics_of_the_motor_add_up(count: int) -> None:
    def line(amplitude: float) -> dict[str, object]:
        return {"axis": "x", "amplitude": amplitude, "period": 0.004, "phase": 0.5}

    one = way(cogging=[line(0.02 * count)])
    assert max(abs(place - 1e-3) for place in one) > 1e-6
    assert way(cogging=[line(0.02)] * count) == pytest.approx(one, rel=1e-9)
