"""What of users' laws takes this guest ten minutes: tuned, judged and run live by the commands of the package.

Not of the lane: HIL_VM_MARKS=slow deploy/vm/test_systemd.sh tests/vm/systemd/test_2_plug_ins_at_length.py
"""

import shutil
from pathlib import Path

import pytest

from tests.vm.systemd.service import EDIT, EXAMPLES, PACKAGES, edited, sh

pytestmark = [pytest.mark.vcan, pytest.mark.systemd, pytest.mark.slow]

PLACE = Path("/root/at-length")
RIG = PLACE / "rig.toml"
BRIEF = "--set task.move_s=0.2 --set task.settle_s=0 --set task.approach_s=0.1"
SIZES = "--mass 1 --travel 0.05 --encoder 1e-7 --force 20 --friction 0.5 --watchdog 0.05 --rate 100"


@pytest.fixture(scope="module", autouse=True)
def installed() -> None:
    """The package, and a rig file with the examples' classes beside it."""
    if not Path("/usr/bin/hil").exists():
        sh(f"apt install {PACKAGES}/hil_*.deb")
    shutil.copytree(EXAMPLES / "laws", PLACE)
    shutil.copy(EXAMPLES / "estimators" / "luenberger.py", PLACE)
    sh(f"hil new {RIG} --axes x --layout stage_fd {SIZES}")


def test_a_law_of_ones_own_is_tuned():
    searched = "--population 5 --generations 1 --unseen 1 --trials task"
    sh(f"hil tune {RIG} --law {PLACE}/lqr.py:Lqr {searched} {BRIEF}")
    assert "lqr.py:Lqr" in RIG.read_text()


def test_a_law_of_ones_own_is_judged_by_check():
    told = sh(f"hil check {RIG} --set law.name=./network.py:Network {BRIEF}")
    assert "stable" in told


def test_a_law_and_an_estimator_of_ones_own_are_shown_live():
    own = PLACE / "own.toml"
    laws = {
        **EDIT,
        r'^name = "presliding-kalman"$': 'name = "./network.py:Network"',
        r"^\[estimator\]$": '[estimator]\nname = "./luenberger.py:Luenberger"\nparameters = { bandwidth_hz = 4.0 }',
    }
    own.write_text(edited(Path("/usr/share/hil/rigs/microscope.toml").read_text(), laws))
    told = sh(f"cd {PLACE} && hil demo {own} --seconds 5 --out {PLACE}/run")
    assert "ACTIVE" in told
