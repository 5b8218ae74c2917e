"""A dish of cells under an emulated stage: hit and miss, anomalies, pulses."""

import math
from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig
from drivers.frame import FD, Frame
from sim_plant.config import PlantConfig
from sim_plant.dish_config import DishConfig
from sim_plant.emulator import EmulatedStage
from sim_plant.nodes.output import NEVER_NS, OutputNode
from sim_plant.physics.dish import Dish
from tests.support.gliding import AXES, MS, ROW, Gliding, dish_of, stabbed

PLANT: dict[str, Any] = {
    "mass": [0.9, 0.6, 0.25],
    "coulomb": [0.0, 0.0, 0.0],
    "viscous": [0.0, 0.0, 0.0],
    "quadratic": [0.0, 0.0, 0.0],
    "gravity": [0.0, 0.0, 0.0],
    "encoder_resolution": 1e-9,
}


def test_a_tip_above_a_cell_meets_it_and_another_cell_is_left_alone() -> None:
    dish = dish_of()
    cell = stabbed(dish, 1.6e-3, 0.1e-3)
    assert cell is dish.cells[1]
    assert cell.contact == -1e-3
    assert cell.touched_ns == pytest.approx(100 * MS, abs=1)
    assert cell.puncture is not None
    assert cell.puncture.force == pytest.approx(0.75e-3, rel=1e-9)
    assert cell.peak_force == pytest.approx(0.75e-3, rel=1e-9)
    assert cell.deepest == pytest.approx(300e-6)
    assert cell.pierced_ns == pytest.approx(100 * MS + cell.puncture.depth / 1e-3 * 1e9, abs=2)
    assert (dish.entered, dish.force) == (None, 0.0)
    others = (dish.cells[0], dish.cells[2])
    assert [(other.contact, other.pierced_ns, other.deepest) for other in others] == [(None, None, -math.inf)] * 2


def test_a_tip_beside_a_cell_meets_nothing() -> None:
    dish = dish_of()
    assert stabbed(dish, 0.51e-3, 0.0) is None
    assert [cell.contact for cell in dish.cells] == [None] * 3
    stage = Gliding([0.7e-3, 0.0, -1.2e-3], [0.0, 0.0, 0.0])
    stage.to(dish, 0, 1000 * MS, [-1e-3, 0.0, 0.0])
    assert dish.cells[0].contact is None, "it is met from above alone"


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_force_pushes_the_tip_out_in_pieces_of_a_quarter_of_a_millisecond(direction: int) -> None:
    dish = dish_of(direction=direction, top=direction * 1e-3)
    stage = Gliding([0.0, 0.0, direction * 0.9e-3], [0.0, 0.0, 0.0])
    stage.to(dish, 0, 200 * MS, [0.0, 0.0, direction * 1e-3])
    assert len(stage.forces) > 600
    assert stage.forces[-1] * -direction > 0.0
    assert dish.force * -direction == pytest.approx(stage.forces[-1], rel=0.02)


def test_far_from_all_cells_there_are_no_pieces() -> None:
    dish = dish_of()
    stage = Gliding([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    stage.to(dish, 0, 500 * MS, [0.0, 0.0, -1e-3])
    assert len(stage.forces) == 500


def coasted(piece_ns: int) -> tuple[float, float, float]:
    """Contact, depth of the puncture and place after 0.3 s of a real axis that a motor pushes into a cell, m."""
    plant = PlantConfig(**PLANT, dish=DishConfig(positions=ROW, top=-0.5e-3, spread=False))
    stage = EmulatedStage(plant, BusConfig(), AXES, [5.0, 5.0, 5.0], Path())
    stage.dish = Dish(plant.dish or DishConfig(positions=ROW, top=0.0), AXES, piece_ns)
    stage.push(2, -0.25 * 20e-3)  # 20 mm/s^2
    for tick in range(1, 301):
        stage.advance(tick * MS)
        stage.push(2, -0.25 * 20e-3)
    cell = stage.dish.cells[0]
    assert cell.puncture is not None
    assert cell.touched_ns is not None
    return 0.5 * 20e-3 * (cell.touched_ns * 1e-9) ** 2, cell.puncture.depth, float(stage.position[2])


def test_half_the_piece_moves_neither_contact_nor_puncture_by_20_nm() -> None:
    whole, half = coasted(250_000), coasted(125_000)
    assert whole[0] == pytest.approx(0.5e-3, abs=20e-9)
    assert whole == pytest.approx(half, abs=5e-9)
    assert whole[2] > -0.5 * 20e-3 * 0.3**2 + 1e-6, "the cell has held it back"


def test_a_look_at_the_stage_changes_nothing_of_cell_or_tip() -> None:
    plant = PlantConfig(**PLANT, dish=DishConfig(positions=ROW, top=-0.05e-3, spread=False))

    def found(looks: bool) -> tuple[float, float]:
        stage = EmulatedStage(plant, BusConfig(), AXES, [5.0, 5.0, 5.0], Path())
        assert stage.dish is not None
        for tick in range(1, 131):
            stage.push(2, -0.25 * 20e-3)
            stage.advance(tick * MS)
            if looks:
                assert stage.position.shape == (3,)
        stage.push(2, 0.0)
        return stage.dish.force, float(stage.position[2])

    assert found(looks=True) == found(looks=False)
    assert found(looks=True)[0] > 0.1e-3


# anomalies ------------------------------------------------------------------------------------------------------------


def test_what_is_wrong_with_a_cell_shows_in_what_happens() -> None:
    words = ["no_cell", "rolled", "not_pierced", "double", "stuck"]
    places = [[2e-3 * number, 0.0] for number in range(5)]
    dish = dish_of(positions=places, anomalies=words)
    for x, _ in places:
        stabbed(dish, x, 0.0)
    none, rolled, tough, double, stuck = dish.cells
    assert none.contact is None
    assert rolled.moved > 12e-6
    assert rolled.pierced_ns is None
    assert tough.pierced_ns is None
    assert tough.peak_force > 1.4e-3
    assert double.pierced_ns is not None
    assert double.doubled_ns is not None
    assert double.doubled_ns > double.pierced_ns
    assert stuck.pierced_ns is not None
    assert stuck.peak_pull > 0.3e-3
    assert [cell.still_on_pipette for cell in dish.cells] == [False, False, False, False, True]


def test_a_broken_pipette_reaches_no_cell_from_then_on() -> None:
    dish = dish_of(anomalies=["", "broken"])
    assert (stabbed(dish, 0.0, 0.0), dish.tip_error) == (dish.cells[0], 0.0)
    assert stabbed(dish, 1.5e-3, 0.2e-3) is None
    assert dish.tip_error == 1e-3, "higher up"
    assert stabbed(dish, 3.0e-3, 0.4e-3) is None


# pulses ---------------------------------------------------------------------------------------------------------------


def pulsed(dish: Dish, depth: float) -> None:
    """A pulse of 0.1 s at that depth in the first cell."""
    stage = Gliding([0.0, 0.0, -0.9e-3], [0.0, 0.0, 0.0])
    now_ns = stage.to(dish, 0, round((depth + 0.1e-3) / 1e-3 * 1e3) * MS, [0.0, 0.0, -1e-3])
    dish.outputs(1, now_ns)
    now_ns = stage.to(dish, now_ns, 100 * MS, [0.0, 0.0, 0.0])
    dish.outputs(0, now_ns)
    assert dish.bolus == (dish.cells[0].pulses[-1].bolus if dish.under else 0.0)


@pytest.mark.parametrize(("anomaly", "bolus"), [("", 1.0), ("clogged", 0.25)])
def test_a_pulse_into_a_pierced_cell_leaves_a_bolus(anomaly: Any, bolus: float) -> None:
    dish = dish_of(anomalies=[anomaly])
    pulsed(dish, 300e-6)
    (pulse,) = dish.cells[0].pulses
    assert pulse.pierced
    assert pulse.bolus == pytest.approx(bolus)
    assert pulse.end_ns - pulse.begin_ns == 100 * MS


def test_a_pulse_elsewhere_is_told_as_one() -> None:
    dish = dish_of()
    pulsed(dish, 100e-6)
    assert dish.cells[0].pulses == [(200 * MS, 300 * MS, False, 0.0)]
    nowhere = dish_of(anomalies=["no_cell"], positions=[[0.0, 0.0]])
    pulsed(nowhere, 300e-6)
    assert not nowhere.cells[0].pulses[0].pierced
    beside = dish_of(positions=[[1.0, 0.0]])
    pulsed(beside, 300e-6)
    assert [pulse.pierced for pulse in beside.stray] == [False]


def test_a_pulse_that_begins_before_the_puncture_is_none_into_a_pierced_cell() -> None:
    dish = dish_of()
    stage = Gliding([0.0, 0.0, -0.9e-3], [0.0, 0.0, 0.0])
    now_ns = stage.to(dish, 0, 200 * MS, [0.0, 0.0, -1e-3])
    dish.outputs(1, now_ns)
    now_ns = stage.to(dish, now_ns, 200 * MS, [0.0, 0.0, -1e-3])
    dish.outputs(0, now_ns)
    assert dish.cells[0].pierced_ns is not None
    assert not dish.cells[0].pulses[0].pierced
    assert dish.cells[0].pulses[0].bolus > 0.1


# the output node ------------------------------------------------------------------------------------------------------

OUTPUT_ID = 0x3E0


def said(bits: int, sequence: int, at_ns: int, inverted: int | None = None, flags: int = 0) -> Frame:
    check = bits ^ 0xFF if inverted is None else inverted
    return Frame(OUTPUT_ID, bytes((bits, check, sequence)), flags, at_ns)


def test_an_output_stays_on_as_long_as_frames_come_and_10_ms_longer() -> None:
    node = OutputNode(OUTPUT_ID)
    plant = PlantConfig(**PLANT, dish=DishConfig(positions=ROW, top=-0.5e-3, spread=False))
    stage = EmulatedStage(plant, BusConfig(), AXES, [5.0, 5.0, 5.0], Path(), outputs=[node])
    assert stage.dish is not None
    assert node.bits == 0
    stage.advance(MS)
    for tick in range(1, 6):
        assert stage.on_frame(said(1, tick, tick * MS)) == []
        assert node.bits == 1
    stage.advance(14 * MS)
    assert node.bits == 1
    assert stage.deadline_ns == 15 * MS
    stage.advance(50 * MS)
    assert node.bits == 0
    (pulse,) = stage.dish.cells[0].pulses
    assert (pulse.begin_ns, pulse.end_ns) == (MS, 15 * MS)
    assert not any(stage.rejected.values())


@pytest.mark.parametrize(
    "frame",
    [
        said(1, 9, MS, inverted=0xFF),
        said(1, 7, MS),
        Frame(OUTPUT_ID, b"\x01\xfe", 0, MS),
        Frame(OUTPUT_ID, b"\x01\xfe\x09\x00", 0, MS),
        said(1, 9, MS, flags=FD),
    ],
    ids=["not inverted", "repeated", "short", "long", "FD"],
)
def test_a_frame_that_is_none_of_the_hosts_switches_nothing(frame: Frame) -> None:
    node = OutputNode(OUTPUT_ID)
    node.hear(said(0, 7, 0), 0)
    node.hear(frame, MS)
    assert (node.bits, node.deadline_ns, node.ignored) == (0, NEVER_NS, 1)


def test_a_pulse_that_goes_on_while_the_tip_leaves_is_none_into_a_pierced_cell() -> None:
    dish = dish_of()
    stage = Gliding([0.0, 0.0, -0.9e-3], [0.0, 0.0, 0.0])
    now_ns = stage.to(dish, 0, 400 * MS, [0.0, 0.0, -1e-3])
    dish.outputs(1, now_ns)
    now_ns = stage.to(dish, now_ns, 350 * MS, [0.0, 0.0, 1e-3])
    dish.outputs(0, now_ns)
    (pulse,) = dish.cells[0].pulses
    assert not pulse.pierced
    assert pulse.bolus == pytest.approx(3.0, abs=0.05), "as long as it was inside"


def test_of_two_cells_that_overlap_the_nearer_one_is_met() -> None:
    dish = dish_of(positions=[[0.0, 0.0], [0.4e-3, 0.0]])
    assert stabbed(dish, 0.3e-3, 0.0) is dish.cells[1]
    assert stabbed(dish, 0.1e-3, 0.0) is dish.cells[0]
    back = dish_of(positions=[[0.4e-3, 0.0], [0.0, 0.0]])
    assert stabbed(back, 0.3e-3, 0.0) is back.cells[0]


def test_the_valve_is_one_bit_of_the_outputs() -> None:
    dish = dish_of(valve=3)
    dish.outputs(0b0111, 0)
    dish.outputs(0, MS)
    assert not dish.stray
    dish.outputs(0b1000, 2 * MS)
    dish.outputs(0, 3 * MS)
    assert len(dish.stray) == 1


# the rig file ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"axes": ["x", "x", "z"]}, "none twice"),
        ({"direction": 0}, "allowed: -1, 1"),
        ({"positions": []}, "allowed: 1 to 100000"),
        ({"layers": [{"force": 1e-3, "depth": 1e-4}] * 9}, "at most 8"),
        ({"anomalies": [""] * 4}, "4 for 3 positions"),
        ({"layers": [{"force": 1e-3}]}, "one of depth and stiffness"),
        ({"layers": [{"force": 1e-3, "depth": 1e-4, "power": 2.5}]}, "allowed: 1.5, 2, 3"),
        ({"anomalies": ["lost"]}, "no_cell"),
    ],
)
def test_a_dish_that_cannot_be_is_refused_with_what_can(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        DishConfig(**({"positions": ROW, "top": 0.0} | changes))


def test_a_dish_on_an_axis_that_there_is_not_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="no axis 'w'; the axes are x, y, z"):
        dish_of(axes=["x", "y", "w"])


def test_what_needs_a_dish_says_so_and_two_kinds_of_cells_do_not_share_an_axis() -> None:
    with pytest.raises(ValueError, match=r"measures = 'tip_force' of 'force' needs \[plant.dish\]"):
        PlantConfig(**PLANT, sensors=[{"sensor": "force", "measures": "tip_force", "axis": "z"}])
    with pytest.raises(ValueError, match="expected cells = \\[\\] beside it"):
        PlantConfig(**PLANT, cells=[{"axis": "z", "surface": 0.0}], dish=DishConfig(positions=ROW, top=0.0))
