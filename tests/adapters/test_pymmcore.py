"""A script of Micro-Manager moves an emulated rig through pymmcore-plus, and `busy()` tells the truth."""

from collections.abc import Iterator

import pytest
from pymmcore_plus.experimental.unicore import UniMMCore

import hil
from hil.adapters.pymmcore import RigStage, RigXYStage, load_stages
from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from tests.adapters.night import spend


@pytest.fixture
def stage(mover: hil.VirtualMover) -> hil.VirtualMover:
    return mover


@pytest.fixture
def core(stage: hil.VirtualMover) -> Iterator[UniMMCore]:
    core = UniMMCore()
    load_stages(core, stage)
    yield core
    core.reset()


def test_a_script_finds_its_xy_stage_its_focus_and_one_more_axis(core: UniMMCore, stage: hil.VirtualMover) -> None:
    assert (core.getXYStageDevice(), core.getFocusDevice()) == ("XY", "Z")
    assert set(core.getLoadedDevices()) >= {"XY", "Z", "theta"}
    core.setXYPosition(100.0, -50.0)
    core.setPosition(-20.0)
    core.setPosition("theta", 1000.0)
    assert core.systemBusy()
    for label in ("XY", "Z", "theta"):
        core.waitForDevice(label)
    assert core.getXYPosition() == pytest.approx((100.0, -50.0), abs=10.0)
    assert core.getPosition() == pytest.approx(-20.0, abs=10.0)
    assert stage.true_position == pytest.approx([1e-4, -5e-5, -2e-5, 1e-3], abs=1e-5)
    assert stage.status().setpoint == [1e-4, -5e-5, -2e-5, 1e-3]
    assert not core.systemBusy()


def test_relative_steps_add_up_from_the_target_in_force(core: UniMMCore, stage: hil.VirtualMover) -> None:
    for _ in range(3):
        core.setRelativePosition(5.0)
        core.setRelativeXYPosition(1.0, -1.0)
    core.waitForSystem()
    assert stage.status().setpoint[:3] == pytest.approx([3e-6, -3e-6, 15e-6], abs=1e-15)


def test_stop_halts_short_of_the_target_and_is_busy_until_the_rest(core: UniMMCore, stage: hil.VirtualMover) -> None:
    core.setXYPosition(5000.0, 0.0)
    stage.sleep(0.05)
    core.stop("XY")
    assert core.deviceBusy("XY")
    core.waitForDevice("XY")
    assert stage.status().motion is MotionWord.HOLD
    assert 0.0 < stage.status().setpoint[0] < 5e-3


def test_an_origin_moves_the_numbers_and_not_the_stage(core: UniMMCore, stage: hil.VirtualMover) -> None:
    core.setXYPosition(100.0, 40.0)
    core.setPosition(30.0)
    core.waitForSystem()
    before = stage.status().setpoint
    core.setOrigin("Z")
    core.setOriginXY("XY")
    assert core.getXYPosition() == pytest.approx((0.0, 0.0), abs=10.0)
    assert stage.status().setpoint == before
    core.home("Z")
    core.setXYPosition(-100.0, -40.0)
    core.waitForSystem()
    assert stage.status().setpoint == pytest.approx([0.0, 0.0, 3e-5, 0.0], abs=1e-15)


def test_what_no_goal_can_be_is_refused_with_its_reason(core: UniMMCore, stage: hil.VirtualMover) -> None:
    with pytest.raises(hil.GoalRefusedError, match=r"x = 9: from .* to .* \(axes\.x\.limits\.position"):
        core.setXYPosition(9e6, 0.0)
    assert not core.deviceBusy("XY")
    with pytest.raises(ValueError, match="no axis 'w': the rig has x, y, z, theta"):
        RigXYStage(stage, ("x", "w"))
    with pytest.raises(ValueError, match="no axis 'w'"):
        RigStage(stage, "w")


def test_a_move_that_is_cut_short_by_another_program_does_not_end_in_silence(
    core: UniMMCore, stage: hil.VirtualMover
) -> None:
    core.setPosition(500.0)
    stage.halt()
    with pytest.raises(hil.MotionError, match=r"z rests at .* cut short"):
        core.waitForDevice("Z")
    assert not core.deviceBusy("Z")  # told once


@pytest.mark.long
def test_an_hour_of_the_night_is_quiet() -> None:
    night = spend(45, seed=7)
    assert (night.early, night.fault) == (0, Fault.NONE)
    assert not any(night.left.values())
    assert night.drift < 1e-6
