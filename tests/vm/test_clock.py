"""The machine's clock is set while the rig moves: the control process lives on the monotonic clock."""

import time
from pathlib import Path

import pytest

from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from tests.vm.live import HELD_UP, live_rig

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.skipif(
        "virtme" not in Path("/proc/cmdline").read_text(), reason="sets the clock: only in the guest of make test-vm"
    ),
]
HOUR = 3600.0


def test_setting_the_clock_forward_and_back_goes_unnoticed(vcan: str) -> None:
    with live_rig(vcan) as rig:
        rig.activate()
        for step in (HOUR, -2 * HOUR, HOUR):
            time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step)
            after = rig.wait_ticks(10)
            # What a guest looks like that the host does not let run is told apart by name.
            assert {Fault(int(fault)).name for fault in after["fault"]} <= {Fault.NONE.name, *HELD_UP}
            assert (after["now_ns"][1:] > after["now_ns"][:-1]).all()
            if State.ACTIVE not in after["state"]:
                rig.to_ready()
                rig.activate()
        assert rig.stop() == 0
        assert rig.applied_forces() == [0.0, 0.0]
