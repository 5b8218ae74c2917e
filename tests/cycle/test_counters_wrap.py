"""Counters that begin just below their end: the run goes over it, ACTIVE and without a fault."""

import pytest

from hil.cycle.state_machine import State
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

BELOW = 60  # ticks before the end, within which the rig becomes ACTIVE


@pytest.mark.parametrize("protocol", ["stage_fd", "stage_classic"])
@pytest.mark.parametrize("width", [16, 31, 32, 53, 63])
def test_a_command_sequence_number_goes_over_its_end(protocol: str, width: int) -> None:
    run = LockstepRun(load_rig(RIGS / "paper.toml", [f"bus.protocol={protocol}", "task.kind=hold"]), RIGS)
    run.cycle.sent_sequence = 2**width - BELOW
    states = [run.cycle.state for _ in range(3 * BELOW) if run.tick()]
    assert run.cycle.sent_sequence >= 2**width + BELOW
    assert states[-2 * BELOW :] == [State.ACTIVE] * 2 * BELOW
    assert not any(run.cycle.monitor.named_counts().values())
    assert [axis for axis, age in enumerate(run.cycle.inbox.age) if age > 1] == []


def test_a_drives_time_stamp_goes_over_its_end() -> None:
    """32 bits of nanoseconds: every 4.3 s."""
    run = LockstepRun(load_rig(RIGS / "paper.toml", ["task.kind=hold", "rate_hz=250", "law.name=pd-feedforward"]), RIGS)
    for _ in range(round(2**32 * 1e-9 * 250) + 50):
        run.tick()
    assert run.cycle.state is State.ACTIVE
    assert not any(run.cycle.monitor.named_counts().values())
