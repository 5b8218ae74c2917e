"""WITHDRAW: which way out a motion may declare, and that it holds whatever the motion does later."""

import pytest

import hil
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS
from tests.support.tip import INSIDE, RIG, TipRun, down


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ('{axis="w"}', "retreat.axis = 'w'; the axes are x, y, z, theta"),
        ("{direction=0}", "retreat.direction = 0; allowed: -1 or 1"),
        ("{position=0.1}", "retreat.position = 0.1; allowed: from -0.00"),
        ("{position=nan}", "retreat.position = nan; allowed"),
    ],
)
def test_a_way_out_that_cannot_be_is_refused_by_its_name(parameters: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LockstepRun(load_rig(RIG, ("task.kind=hold", INSIDE, f"motion.parameters={parameters}")), RIGS)


def test_a_way_out_is_read_once_and_nothing_that_the_motion_does_later_changes_it() -> None:
    rig = TipRun().to(-0.0015)
    rig.motion.retreat = hil.Retreat("z", -0.005, -1)
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert rig.is_out()


@pytest.mark.parametrize("declared", [("z", 0.0, -1), "z", 0])
def test_a_way_out_that_is_none_is_refused(declared: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hil.Motion, "retreat", declared)
    with pytest.raises(ValueError, match=r"retreat = .*, expected hil.Retreat"):
        LockstepRun(load_rig(RIG, ("task.kind=hold", INSIDE.replace(":Inside", ":ToAndFro"))), RIGS)


def test_the_stop_of_a_slow_axis_is_given_the_time_that_its_way_out_takes() -> None:
    quick = TipRun().run.cycle.supervisor.longest_stop_s
    slow = TipRun(down, "axes.z.motion.speed=0.002").run.cycle.supervisor.longest_stop_s
    assert quick < 0.5
    assert 2.0 < slow < 3.0
