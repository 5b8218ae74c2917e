"""`hil sweep`: the same numbers however plants are dealt out, and the worst of them again, one by one."""

from pathlib import Path

import numpy as np
import pytest

from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.studies.crew import crew
from hil.studies.sweep.plants import Job, beyond_baseline, jobs, plant_rig, reproduce, run_chunk, save_worst
from tests.support.paths import RIGS

PAPER, MICROSCOPE = RIGS / "paper.toml", RIGS / "microscope-ideal.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1", "plant.modelling_error=0.1"]


@pytest.mark.long
def test_a_sweep_gives_the_same_numbers_however_plants_are_dealt_out() -> None:
    rig = load_rig(PAPER, [*QUICK, "law.name=structured-kalman"])
    document = rig.model_dump_json()
    whole = run_chunk(Job(document, 5, 0, 6, 500, 320, True))
    with crew(2) as found:
        parts = list(
            found.run(run_chunk, [Job(document, 5, 0, 4, 500, 320, True), Job(document, 5, 4, 2, 500, 320, True)])
        )
    for together, first, second in zip(whole, *parts, strict=True):
        assert np.array_equal(together, np.concatenate([first, second]))


def test_the_worst_plants_reproduce_singly_bit_for_bit(tmp_path: Path) -> None:
    rig = load_rig(PAPER, [*QUICK, "law.name=structured-kalman"])
    work = jobs(rig, RIGS, 3, 0.7, seed=9)
    figures = run_chunk(work[0])
    (saved,) = save_worst(PAPER, rig, 9, False, [2], tmp_path)
    assert reproduce(saved, 0.7, figures.max_error[2])
    assert not reproduce(saved, 0.7, figures.max_error[1])
    assert load_rig(saved).plant == plant_rig(rig, 9, 2, False).plant
    assert "# The stage of Xu" in saved.read_text()


def test_plants_beyond_the_rigs_baseline_are_counted_by_axis() -> None:
    rig = load_rig(PAPER, [*QUICK, "law.name=structured-kalman"])
    figures = run_chunk(jobs(rig, RIGS, 3, 0.7, seed=9)[0])
    middle = sorted(figures.rms_error[:, 0])[1]
    kept = {"steady": {"x": 0.5 * middle * 0.999}}
    assert beyond_baseline(rig, figures, kept) == {"x": 2}


def test_a_saved_plant_is_the_rig_that_was_swept_whatever_was_set_for_it(tmp_path: Path) -> None:
    said = [
        "drives.watchdog_s=0.02",
        "axes.x.limits.speed=4.5",
        "safety.stop_s=0.4",
        "description=another",
        "rate_hz=500",
    ]
    rig = load_rig(PAPER, [*QUICK, "law.name=pid", "law.gains={kp=900.0}", *said])
    (saved,) = save_worst(PAPER, rig, 9, False, [2], tmp_path)
    assert load_rig(saved) == plant_rig(rig, 9, 2, False)
    assert "# The stage of Xu" in saved.read_text()
    assert "# zero torque when no valid command" in saved.read_text(), "comments beside what was set stay"


def test_a_sweep_without_a_steady_window_is_refused() -> None:
    with pytest.raises(RigError, match="steady window begins"):
        jobs(load_rig(PAPER), RIGS, 10, 3.0, seed=1)
    with pytest.raises(RigError, match="stage_fd"):
        jobs(load_rig(PAPER, ["wire.jitter=1e-5"]), RIGS, 10, 20.0, seed=1)
