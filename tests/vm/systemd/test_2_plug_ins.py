"""What users bring, in the commands of the installed package: laws, an estimator and tasks beside a rig file of theirs.

Simulated, for little more than a second. The same classes as a service: section 4 of the page; tuned, judged and shown
live: test_2_plug_ins_at_length.py.
"""

from pathlib import Path

import pytest

from tests.vm.systemd.brought import BRIEF, NETWORK, SIZES, bring_all
from tests.vm.systemd.service import console

pytestmark = [pytest.mark.vcan, pytest.mark.systemd]

PLACE = Path("/root/mine")
RIG = PLACE / "mine.toml"
ESTIMATOR = "--set estimator.name=./luenberger.py:Luenberger --set estimator.parameters={bandwidth_hz=20}"
EXIT_FAULT = 3


def hil(words: str, status: int = 0) -> str:
    """Output of a command that ends with `status`."""
    ended, output = console(words)
    assert ended == status, output
    return output


def test_a_rig_file_of_ones_own_begins_with_hil_new():
    bring_all(PLACE)
    hil(f"new {RIG} --axes x,y --layout stage_fd {SIZES}")


@pytest.mark.parametrize("law", ["lqr.py:Lqr", "lqg.py:Lqg", "mpc.py:PreviewMpc", "network.py:Network"])
def test_a_law_of_ones_own_runs(law):
    assert "faults: none; ended ACTIVE" in hil(f"sim {RIG} --seconds 1.2 --set law.name=./{law}")


def test_a_law_that_raises_ends_in_zero_torque_and_its_line_is_told():
    law = "--set law.name=./misbehaves.py:Misbehaves --set law.gains={how='raises',after=0.1}"
    output = hil(f"sim {RIG} --seconds 1.2 {law}", EXIT_FAULT)
    assert "not_finite x1; ended FAULT" in output
    assert "misbehaves.py:31: ZeroDivisionError" in output


@pytest.mark.parametrize(
    "task",
    [
        "task.kind=spiral task.radius=0.002 task.move_s=0.8",
        "task.kind=waypoints task.waypoints=[[0.0,0.0],[0.001,0.0],[0.001,0.001]]",
        "task.kind=path task.file=line.csv",
        "task.kind=./rose.py:Rose",
    ],
)
def test_a_task_of_ones_own_is_followed(task):
    (PLACE / "line.csv").write_text("time_s,x,y\n0,0,0\n0.3,0.0002,0.0002\n0.6,0.0006,0.0004\n1,0.0008,0.0005\n")
    chosen = " ".join(f"--set {key}" for key in task.split())
    assert "faults: none; ended ACTIVE" in hil(f"sim {RIG} --seconds 1.2 {chosen}")


def test_a_recording_of_both_is_replayed_without_the_files():
    recording = PLACE / "run.mcap"
    hil(f"sim {RIG} --seconds 0.6 --record {recording} --set law.name={NETWORK} {ESTIMATOR}")
    for source in ("network.py", "luenberger.py"):
        (PLACE / source).rename(PLACE / f"{source}.away")
    assert "every torque frame is the same" in hil(f"replay {recording} --run-its-code")
    for source in ("network.py", "luenberger.py"):
        (PLACE / f"{source}.away").rename(PLACE / source)


@pytest.mark.slow  # two minutes in this guest; tests/studies does the same from the sources
def test_both_are_compared_swept_and_tried_on_faults():
    brief = f"{BRIEF} {ESTIMATOR}"
    assert NETWORK in hil(f"compare {RIG} --laws {NETWORK} --seconds 1 --workers 1 {brief}")
    swept = f"sweep {RIG} --plants 2 --seconds 1 --workers 1 --output {PLACE} --set law.name={NETWORK}"
    assert hil(f"{swept} {brief}").count("reproduced singly, bit for bit") == 2
    assert "1 of 1 cells passed" in hil(f"faults {RIG} --stride 500 --jobs 1 --set law.name={NETWORK} {brief}")
