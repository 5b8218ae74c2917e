"""Every layout drives the same rig, to the same tracking within its quantisation."""

from collections.abc import Callable

import numpy as np
import pytest

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.conftest import RIGS

# Largest true following error, m, once on the circle. A radius of 20 mm at 0.5 Hz; encoders count 100 nm.
ALLOWED = {"stage_fd": 1.5e-6, "stage_classic": 2.5e-6, "cia402": 1.5e-6, "dbc": 2.5e-6}
OVERRIDES = ["task.radius=0.02", "task.approach_s=0.5", "task.settle_s=0.0"]


def rig_on(protocol: str) -> RigConfig:
    if protocol == "dbc":
        return load_rig(RIGS / "paper-dbc.toml", OVERRIDES)
    return load_rig(RIGS / "paper.toml", [*OVERRIDES, f"bus.protocol={protocol}"])


@pytest.mark.long
@pytest.mark.parametrize("protocol", ALLOWED)
def test_the_rig_tracks_the_same_under_every_layout(protocol: str, lockstep: Callable[..., LockstepRun]) -> None:
    run = lockstep(rig_on(protocol))
    errors = []
    for _ in range(2500):
        run.tick()
        if run.activated_at >= 0 and run.index > run.activated_at + 1000 and all(run.cycle.inbox.fresh):
            errors.append(np.abs(run.true_position - [x.sample.position for x in run.cycle.inputs]))
    assert len(errors) > 800
    assert run.cycle.monitor.named_counts() == {} or not any(run.cycle.monitor.named_counts().values())
    assert max(error.max() for error in errors) < ALLOWED[protocol]
