"""The campaign on a stage with guides: a step of every effect that [plant] has."""

import pytest

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.matrix import Cell, displaced, plan_chunks, run_chunk
from tests.support.paths import RIGS


def guided() -> RigConfig:
    """The microscope on crossed-roller guides, under the law for them, which knows their lag and mode."""
    told = {"torque_lag": 1.5e-4, "mode_frequency_hz": 200, "mode_damping": 0.02, "mode_load": 0.3}
    sets = [f"axes.{axis}.model.{key}={value}" for axis in ("x", "y", "z", "theta") for key, value in told.items()]
    rig = load_rig(RIGS / "microscope.toml", ["plant.stage=crossed-roller", "law.name=presliding-kalman", *sets])
    return displaced(rig)


STAGED = [index for index, trial in enumerate(TRIALS) if trial.staged]


def test_steps_of_a_stage_are_tried_where_there_is_one_at_rest_and_in_motion() -> None:
    assert len(STAGED) == 17
    ideal = [chunk.cells for chunk in plan_chunks(displaced(load_rig(RIGS / "microscope-ideal.toml")), RIGS)]
    assert not [index for cells in ideal for index, _ in cells if index in STAGED]
    real = plan_chunks(guided(), RIGS)
    assert [tuple(cell for cell in chunk.cells if cell[0] not in STAGED) for chunk in real] == ideal
    tried = {chunk.point.name: [index for index, _ in chunk.cells if index in STAGED] for chunk in real}
    assert {name: found for name, found in tried.items() if found} == {"READY": STAGED, "ACTIVE home": STAGED}


def staged(every: int = 1) -> list[Cell]:
    """The cells of the steps, or every so manyth."""
    cells: list[Cell] = []
    for chunk in plan_chunks(guided(), RIGS, stride=every, only="plant steps"):
        cells += run_chunk(chunk) if chunk.cells else []
    return cells


def test_a_step_of_the_stage_stops_the_rig_by_the_fault_it_may_cause_or_not_at_all() -> None:
    cells = staged(8)
    assert [f"{cell.checkpoint} / {cell.trial}: {cell.why}" for cell in cells if not cell.passed] == []
    assert {cell.checkpoint for cell in cells} == {"READY", "ACTIVE home"}


@pytest.mark.slow
def test_every_step_of_the_stage_at_rest_and_in_motion() -> None:
    cells = staged()
    assert [f"{cell.checkpoint} / {cell.trial}: {cell.why}" for cell in cells if not cell.passed] == []
    assert len(cells) == 2 * len(STAGED)
