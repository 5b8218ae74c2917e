"""What the realistic stage costs: how many steps of how many pieces a tick of the microscope takes."""

import pytest

from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from sim_plant.native import library
from sim_plant.physics import native_axis
from sim_plant.physics.native_axis import NativeAxis
from sim_plant.physics.single_stage import real_pieces
from tests.support.paths import RIGS

TICKS = 14_400  # the whole plan
MOST_STEPS = 18.0  # a tick of four axes, on average


@pytest.mark.long
@pytest.mark.skipif(not library.kernel(), reason="the steps are counted by the native kernel")
def test_the_microscope_takes_few_steps_in_two_pieces_a_tick() -> None:
    run = LockstepRun(load_rig(RIGS / "microscope.toml"), RIGS)
    stage = run.stage._stage
    steps, pieces = 0.0, []
    for _ in range(TICKS):
        before = stage._count
        run.tick()
        pieces.append(stage._count - before)
        alone = stage._single  # another where a brake changed
        assert alone
        axes = [axis for axis in alone.axes if isinstance(axis, NativeAxis)]
        taken = [axis._words[axis._row + native_axis._STEPS] for axis in axes]
        assert len(taken) == 4
        assert min(taken) >= 0.0, "left to Python"
        steps += sum(taken)
    assert steps / TICKS <= MOST_STEPS
    assert pieces.count(2) > 0.99 * TICKS


@pytest.mark.parametrize(
    ("duration_ns", "pieces"),
    [(1, 1), (500_000, 1), (505_000, 1), (505_001, 2), (999_000, 2), (1_000_000, 2), (1_002_000, 2), (2_000_000, 4)],
)
def test_ticks_that_differ_by_a_thousandth_have_as_many_pieces(duration_ns: int, pieces: int) -> None:
    assert real_pieces(duration_ns) == pieces
