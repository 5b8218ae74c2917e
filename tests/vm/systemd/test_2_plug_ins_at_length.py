"""What of users' laws takes this guest ten minutes: tuned, judged and run live by the commands of the package.

Not of the lane: HIL_VM_MARKS=slow deploy/vm/test_systemd.sh tests/vm/systemd/test_2_plug_ins_at_length.py; and with all
else that is slow there, the whole story: HIL_VM_MARKS=systemd make test-systemd
"""

from pathlib import Path

import pytest

from tests.vm.systemd.brought import BRIEF, CLASSES, NETWORK, SIZES, bring_all
from tests.vm.systemd.service import EDIT, PACKAGES, edited, sh

pytestmark = [pytest.mark.vcan, pytest.mark.systemd, pytest.mark.slow]

PLACE = Path("/root/at-length")
RIG = PLACE / "rig.toml"


@pytest.fixture(scope="module", autouse=True)
def installed() -> None:
    """The package, and a rig file with the examples' classes beside it."""
    if not Path("/usr/bin/hil").exists():
        sh(f"apt install {PACKAGES}/hil_*.deb")
    bring_all(PLACE)
    sh(f"hil new {RIG} --axes x --layout stage_fd {SIZES}")


def test_a_law_of_ones_own_is_tuned():
    searched = "--population 5 --generations 1 --unseen 1 --trials task"
    sh(f"hil tune {RIG} --law {PLACE}/lqr.py:Lqr {searched} {BRIEF}")
    assert "lqr.py:Lqr" in RIG.read_text()


def test_a_law_of_ones_own_is_judged_by_check():
    told = sh(f"hil check {RIG} --set law.name={NETWORK} {BRIEF}")
    assert "stable" in told


def test_a_law_and_an_estimator_of_ones_own_are_shown_live():
    own = PLACE / "own.toml"
    own.write_text(edited(Path("/usr/share/hil/rigs/microscope.toml").read_text(), {**EDIT, **CLASSES}))
    told = sh(f"cd {PLACE} && hil demo {own} --seconds 5 --out {PLACE}/run")
    assert "ACTIVE" in told
