"""A batch computes what the cycle computes."""

from pathlib import Path

from hil.rig.schema import RigConfig
from hil.virtual.batch import BatchRun
from hil.virtual.lockstep import LockstepRun
from sim_plant.physics.truth import Truth


def assert_batch_is_single(rig: RigConfig, folder: Path) -> None:
    """300 ticks from activation on, of two plants alike: the same forces to the last bit."""
    single = LockstepRun(rig, folder)
    truth = Truth.from_config(rig.plant, len(rig.axes), rig.axis_names)
    batch = BatchRun(rig, Truth.stack([truth, truth]))
    while single.activated_at < 0:
        single.tick()
    batch.tick()
    for _ in range(300):
        single.tick()
        batch.tick()
        assert batch.force.tolist() == [single.cycle.gate.force] * 2
