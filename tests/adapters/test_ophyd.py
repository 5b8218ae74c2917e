"""Bluesky's devices move an emulated rig: a scan, a stop on the way, a path flown, and the RunEngine itself."""

import asyncio

import pytest
from bluesky import RunEngine
from bluesky import plan_stubs as bps
from ophyd_async.core import init_devices

import hil
from hil.adapters.ophyd import PathInfo, RigStage
from hil.cycle.goal import MotionWord


async def connected(mover: hil.VirtualMover) -> RigStage:
    stage = RigStage(mover, name="stage")
    await stage.connect()
    return stage


def test_axes_are_set_together_and_read_where_their_encoders_are(mover: hil.VirtualMover) -> None:
    async def story() -> None:
        stage = await connected(mover)
        await asyncio.gather(stage.x.set(1e-4), stage.y.set(-5e-5))
        look = mover.status()
        assert look.setpoint[:2] == [1e-4, -5e-5]
        assert look.in_position
        located = await stage.x.locate()
        assert located["setpoint"] == 1e-4
        assert located["readback"] == pytest.approx(1e-4, abs=1e-5)
        reading = await stage.x.read()
        assert reading["stage-x"]["value"] == look.position[0]
        described = await stage.x.describe()
        assert described["stage-x"]["units"] == "m"
        assert (await stage.theta.describe())["stage-theta"]["units"] == "rad"

    asyncio.run(story())


def test_a_stop_ends_the_move_short_of_its_target_and_says_so(mover: hil.VirtualMover) -> None:
    async def story() -> None:
        stage = await connected(mover)
        moving = stage.x.set(5e-3)
        while mover.status().motion is not MotionWord.MOVE:
            await asyncio.sleep(0.001)
        await stage.x.stop()
        with pytest.raises(RuntimeError, match="stage-x was stopped"):
            await moving
        assert mover.wait().setpoint[0] < 5e-3

    asyncio.run(story())


def test_a_target_beyond_the_travel_is_refused_before_anything_moves(mover: hil.VirtualMover) -> None:
    async def story() -> None:
        stage = await connected(mover)
        with pytest.raises(ValueError, match=r"x = 9: from -0\.0"):
            await stage.x.set(9.0)
        assert mover.status().number == 0

    asyncio.run(story())


def test_a_path_is_flown_to_its_end(mover: hil.VirtualMover) -> None:
    async def story() -> None:
        flyer = (await connected(mover)).flyer
        with pytest.raises(RuntimeError, match="must be called before kickoff"):
            await flyer.kickoff()
        await flyer.prepare(PathInfo({"x": [1e-4, 3e-4, 3e-4], "y": [0.0, 0.0, 1e-4]}, speed=0.01, blend=1e-5))
        assert mover.status().setpoint[:2] == [1e-4, 0.0]
        await flyer.kickoff()
        assert mover.status().motion is MotionWord.PATH
        await flyer.complete()
        assert mover.status().setpoint[:2] == pytest.approx([3e-4, 1e-4], abs=1e-12)
        assert mover.status().motion is MotionWord.HOLD

    asyncio.run(story())


@pytest.mark.long
def test_a_run_engine_scans_with_it(mover: hil.VirtualMover) -> None:
    engine = RunEngine(call_returns_result=True)
    with init_devices():
        stage = RigStage(mover, name="stage")
    engine(bps.mv(stage.x, 2e-4, stage.z, -5e-5))
    assert mover.status().setpoint[:3] == [2e-4, 0.0, -5e-5]
    assert engine(bps.rd(stage.x)).plan_result == mover.status().position[0]
