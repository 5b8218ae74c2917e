"""What a force sensor cannot do is told before a cell is touched, with its number, and a lockstep run agrees."""

import pytest

from hil.operate.check_sensor import Finding, check_sensor
from hil.rig.file import load_rig
from hil.studies.inject.batch import inject
from tests.support.cells import RIG, RIGS, equipped


def found(*changes: str) -> list[Finding]:
    return check_sensor(equipped(1, *changes))


def test_a_rig_without_cells_has_nothing_to_be_told() -> None:
    assert check_sensor(load_rig(RIG)) == []


def test_the_reference_sensor_is_good_for_the_reference_cell_and_the_figure_is_told() -> None:
    assert [(f.refused, "0.00075 N is 150.0 times the noise; at least 12" in f.text) for f in found()] == [
        (False, True)
    ]


@pytest.mark.parametrize(("noise", "refused"), [(6.2e-5, False), (6.3e-5, True)])
def test_a_puncture_of_less_than_12_times_the_noise_rules_the_cell_out(noise: float, refused: bool) -> None:
    assert [f.refused for f in found(f"sensors.force.noise={noise}")] == [refused]


def test_what_is_stated_of_the_puncture_counts_before_the_emulated_dish() -> None:
    stated = found("motion.parameters.puncture_force=5e-5")
    assert stated[0].refused
    assert "5e-05 N is 10.0 times" in stated[0].text


def test_a_mouse_cell_is_too_weak_for_the_reference_sensor() -> None:
    assert found("plant.dish.preset=mouse-mii")[0].refused


def test_where_no_puncture_force_is_known_the_least_one_is_told() -> None:
    made = equipped(1)
    rig = made.model_copy(update={"plant": made.plant.model_copy(update={"dish": None})})
    told = check_sensor(rig)
    assert not told[0].refused
    assert "from 6e-05 N on; state motion.parameters.puncture_force" in told[0].text


def test_a_force_limit_below_the_puncture_is_refused() -> None:
    assert any("no cell would be pierced" in f.text and f.refused for f in found("motion.parameters.force_limit=5e-4"))


@pytest.mark.parametrize("key", ["sensors.force.tool_mass", "plant.sensors"])
def test_a_mass_on_the_pipette_limits_the_acceleration(key: str) -> None:
    """60 mg and 5 uN: 0.75 of the noise is 0.0625 m/s^2."""
    value = "6e-5"
    if key == "plant.sensors":
        value = "[{sensor='force', measures='tip_force', axis='z', tool_mass=6e-5}]"
    fast, slow = found(f"{key}={value}"), found(f"{key}={value}", "axes.z.motion.acceleration=0.06")
    assert "above 0.0625 m/s^2" in fast[1].text
    assert "128 um to stop from press_speed = 0.004 m/s" in fast[1].text
    assert [fast[1].refused, slow[1].refused] == [True, False]


@pytest.mark.parametrize(("decay", "refused", "lost"), [(2.0, False, "4%"), (0.5, True, "15%")])
def test_a_reading_that_fades_rules_out_a_held_force_and_too_long_a_press(
    decay: float, refused: bool, lost: str
) -> None:
    told = found(f"sensors.force.decay={decay}")[1]
    assert "so none can be held" in told.text
    assert f"{lost} more than force_limit" in told.text
    assert told.refused is refused


@pytest.mark.long
@pytest.mark.parametrize(("acceleration", "right"), [("0.06", True), ("14.0", False)])
def test_the_limit_by_the_mass_is_the_one_that_a_batch_shows(acceleration: str, right: bool) -> None:
    """Within it a touch is one; far above it the tip's own braking and starting reads as a touch."""
    changes = [
        "plant.sensors=[{sensor='force', measures='tip_force', axis='z', tool_mass=6e-5}]", "motion.parameters.shift=",
        "motion.parameters.tip=", "motion.parameters.bolus=", f"axes.z.motion.acceleration={acceleration}",
        "motion.parameters.seek_speed=1e-3", "motion.parameters.press_speed=1e-3",
    ]  # fmt: skip
    batch = inject(equipped(1, *changes), RIGS)
    (cell,) = batch.cells
    assert (cell.found_depth < 60e-6) is right  # NaN where the touch was told before there was one
