"""What is drawn for each cell of a dish: presets, spread, anomalies, layers."""

import math
from typing import Any

import pytest

from sim_plant.cell_presets import PRESETS
from sim_plant.dish_config import DRAWN, PresetName
from sim_plant.physics.dish import Dish
from tests.support.gliding import ROW, dish_of, stabbed


def drawn(dish: Dish) -> list[tuple[Any, ...]]:
    return [(cell.anomaly, cell.top, tuple(state.layer for state in cell.model.layers)) for cell in dish.cells]


@pytest.mark.parametrize("preset", PRESETS)
def test_cells_of_every_preset_differ_and_a_cell_more_moves_no_other(preset: PresetName) -> None:
    three = drawn(dish_of(spread=True, preset=preset, anomaly_share=0.5))
    more = drawn(dish_of(spread=True, preset=preset, anomaly_share=0.5, positions=[*ROW, [0.1, 0.1]]))
    assert more[:3] == three
    assert len(set(more)) == 4
    other = drawn(dish_of(spread=True, preset=preset, anomaly_share=0.5, seed=2))
    assert not set(other) & set(three)


def test_an_anomaly_of_one_cell_moves_no_value_of_another_and_keeps_its_top() -> None:
    good = drawn(dish_of(spread=True))
    rolled = drawn(dish_of(spread=True, anomalies=["rolled"]))
    assert rolled[1:] == good[1:]
    assert rolled[0][1:] == good[0][1:]


def test_the_spread_of_the_reference_cell_is_what_it_is_stated_to_be() -> None:
    many = [[0.01 * number, 0.0] for number in range(2000)]
    dish = dish_of(spread=True, positions=many)
    layers = [cell.model.layers[0].layer for cell in dish.cells]
    for values, mean, deviation in (
        ([layer.force for layer in layers], 0.75e-3, 0.15e-3),
        ([math.sqrt(layer.force / layer.stiffness) for layer in layers], 180e-6, 27e-6),
        ([cell.top for cell in dish.cells], -1e-3, 15e-6),
    ):
        found = sum(values) / 2000
        assert found == pytest.approx(mean, abs=0.08 * deviation)
        assert math.sqrt(sum((v - found) ** 2 for v in values) / 2000) == pytest.approx(deviation, rel=0.06)
    tougher = [layer.stiffness for layer in layers if layer.force > 0.75e-3]
    softer = [layer.stiffness for layer in layers if layer.force < 0.75e-3]
    ratio = sum(tougher) / len(tougher) / (sum(softer) / len(softer))
    assert ratio == pytest.approx(0.87 / 0.63, rel=0.12), "as force over squared depth, one drawn apart from the other"


def test_prehatching_chorions_are_as_much_softer_as_was_measured() -> None:
    before, after = (PRESETS[f"zebrafish-{stage}"].layers[0] for stage in ("blastula", "prehatching"))
    assert before.force / after.force == pytest.approx(1.3)
    assert (before.stiffness or 0.0) / (after.stiffness or 1.0) == pytest.approx(1.66)


def test_a_share_of_anomalies_is_drawn_from_all_kinds_but_the_broken_pipette() -> None:
    many = [[0.01 * number, 0.0] for number in range(2000)]
    found = [cell.anomaly for cell in dish_of(positions=many, anomaly_share=0.4, anomalies=["", ""]).cells]
    assert found[:2] == ["", ""]
    assert 2000 - found.count("") == pytest.approx(800, abs=70)
    assert set(found) == {"", *DRAWN}
    assert min(found.count(word) for word in DRAWN) > 60


def test_a_blunt_tip_needs_as_much_more_force() -> None:
    for tip in (0.5, 1.0, 1.5):
        cell = stabbed(dish_of(tip=tip), 0.0, 0.0)
        assert cell is not None
        assert cell.puncture is not None
        assert cell.puncture.force == pytest.approx(tip * 0.75e-3, rel=1e-9)


def test_layers_and_spread_of_the_rig_file_stand_in_place_of_the_presets() -> None:
    layers = [{"force": 1e-4, "depth": 50e-6}, {"offset": 60e-6, "power": 3.0, "force": 2e-4, "stiffness": 1e9}]
    cell = stabbed(dish_of(layers=layers), 0.0, 0.0)
    assert cell is not None
    first, second = (state.puncture for state in cell.model.layers)
    assert first is not None
    assert second is not None
    assert first.depth == pytest.approx(50e-6, rel=1e-6)
    assert second.depth == pytest.approx(60e-6 + (2e-4 / 1e9) ** (1 / 3), rel=1e-6)
    assert cell.pierced_ns == second.at_ns, "open when all of its layers are"
    flat = dish_of(spread=True, top_spread=0.0)
    assert {cell.top for cell in flat.cells} == {-1e-3}


def test_the_depth_that_the_shaft_is_as_stiff_as_is_found_for_every_power() -> None:
    for power in (1.5, 2.0, 3.0):
        layers = [{"force": 1e-4, "power": power, "depth": 50e-6}]
        layer = dish_of(layers=layers).cells[0].model.layers[0].layer
        assert layer.stiffness * 50e-6**power == pytest.approx(1e-4, rel=1e-12)
        assert layer.shaft == pytest.approx(1e-4 / 50e-6, rel=1e-9)
