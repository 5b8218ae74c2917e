"""A user's law in a live control process: what it does wrong ends in zero torque, and is told to whoever is to know."""

import signal

import pytest

from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from tests.support.live_rig import Control, emulated, every_record, order
from tests.support.paths import MISBEHAVES

pytestmark = pytest.mark.live

LAW = f"law.name={MISBEHAVES}:Misbehaves"


@pytest.mark.parametrize("how", ["raises", "never returns"])
def test_a_law_that_fails_ends_in_zero_torque_and_its_line_is_told(how: str) -> None:
    gains = f"law.gains={{how='{how}', after=0.1}}"
    with emulated() as emulator, Control("--set", LAW, "--set", gains) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.FAULT, reader)
        assert not any(emulator.stage.applied_force)
        faults = set(every_record()["fault"].tolist()) - {0}
        assert int(Fault.NOT_FINITE) in faults or how == "never returns"
        control.process.send_signal(signal.SIGTERM)
        status, _, err = control.finish()
    assert status == 0
    assert "misbehaves.py:" in err
    assert ("ZeroDivisionError" if how == "raises" else "no answer within 5 s") in err
