"""Drives mounted the other way round, geared and with an offset: the axis knows nothing of it, under any layout."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.families.stage.stage_fd import StageFdHost
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command, Sample
from drivers.protocols.mounting import STRAIGHT, Mounting
from hil.cycle.state_machine import State
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import ROOT

RIGS = ROOT / "deploy" / "rigs"
MOUNTED = ("axes.x.direction=-1", "axes.x.gear=2.5", "axes.y.offset=0.0013")

mountings = st.builds(Mounting, st.sampled_from((1, -1)), st.floats(1e-3, 1e3), st.integers(-(10**6), 10**6))


@given(mountings, st.integers(-(2**31), 2**31), st.floats(-1e3, 1e3))
def test_there_and_back_is_where_one_was(mounting: Mounting, count: int, force: float) -> None:
    assert mounting.count_at_axis(mounting.count_at_drive(count)) == count
    assert mounting.force_at_axis(mounting.force_at_drive(force)) == pytest.approx(force, rel=1e-12)
    # a force along a motion at the axis is one along the motion at the drive
    forward = mounting.count_at_drive(1) - mounting.count_at_drive(0)
    assert mounting.force_at_drive(abs(force)) * forward >= 0


@pytest.mark.parametrize("layout", ["stage_fd", "stage_classic"])
def test_the_frames_are_in_the_terms_of_the_drive(layout: str) -> None:
    bus = BusConfig(protocol=layout)
    mounted = [Mounting(-1, 2.0, 500), STRAIGHT]
    host = host_protocol(bus, 2, [4.0, 4.0], RIGS, mountings=mounted)
    at_axis = device_protocol(bus, 2, [4.0, 4.0], RIGS, mounted)
    at_drive = device_protocol(bus, 2, [2.0, 4.0], RIGS)
    (frame,) = host.encode(Command(1, [3.0, 1.0], 0b11, False))
    for seen, force in ((at_drive, -1.5), (at_axis, 3.0)):
        command = seen.decode_command(frame)
        assert isinstance(command, Command)
        assert command.force == pytest.approx([force, 1.0], rel=1e-3)
    for device, position in ((at_drive, 1200), (at_axis, 500 - 1200)):
        sample = host.decode(device.encode_feedback(Sample(0, position, 1, 1, 0)))
        assert isinstance(sample, Sample)
        assert sample.position == 500 - 1200


def test_a_straight_rig_pays_nothing() -> None:
    host = host_protocol(BusConfig(), 2, [4.0, 4.0], RIGS, mountings=[STRAIGHT, STRAIGHT])
    assert type(host) is StageFdHost


@pytest.mark.long
@pytest.mark.parametrize("layout", ["stage_fd", "stage_classic", "cia402"])
def test_a_rig_with_mounted_drives_does_its_task_as_a_straight_one(layout: str) -> None:
    def worst(*overrides: str) -> tuple[float, float]:
        run = LockstepRun(load_rig(RIGS / "paper.toml", [f"bus.protocol={layout}", *overrides]), RIGS)
        error, moved, start = 0.0, 0.0, run.true_position.copy()
        for _ in range(3000):
            result = run.tick()
            if run.cycle.state is State.ACTIVE:
                error = max(error, float(abs(result.record["following_error"]).max()))
            moved = max(moved, float(abs(run.true_position - start).max()))
        assert run.cycle.state is State.ACTIVE
        return error, moved

    straight, mounted = worst(), worst(*MOUNTED)
    assert mounted[1] == pytest.approx(straight[1], rel=0.01)
    assert mounted[0] < 2 * straight[0] + 1e-6
