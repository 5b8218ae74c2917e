"""A user's frame layout between live processes: the control process on one side, emulated drives on the other."""

import signal
import time
from pathlib import Path

import pytest

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.events.notes import read_problems
from hil.live.runtime_paths import runtime_paths
from tests.support.live_rig import PATIENCE_S, Control, emulated, order
from tests.support.wrong_layouts import MAKER, encode, write

pytestmark = pytest.mark.live

# In the 30th tick that enables the drives; in its trial there are 26.
WEARS_OUT = encode("self.on = getattr(self, 'on', 0) + bool(command.enable); 1 // (self.on < 30)")
TOLD = "ZeroDivisionError: integer division or modulo by zero; nothing is sent until a reset"


def test_a_live_rig_runs_over_a_users_layout_and_ends_at_zero_torque() -> None:
    made = f"bus.protocol={MAKER}:Maker"
    with emulated([made]) as emulator, Control("--set", made) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        control.process.send_signal(signal.SIGTERM)
        status, _, err = control.finish()
        assert (status, [line for line in err.splitlines() if not line.startswith("tick ")]) == (0, [])
        emulator.stop()
        assert emulator.stage.applied_force == [0.0, 0.0]
        assert emulator.stage.commands > 0
        assert {len(data) for _, data in emulator.commands} >= {1, 5}  # torques of five bytes each, and GO


def test_a_layout_that_raises_falls_silent_and_its_line_is_in_the_journal(tmp_path: Path) -> None:
    wrong = f"bus.protocol={write(tmp_path, WEARS_OUT)}:Wrong"
    with emulated([wrong]) as emulator, Control("--set", wrong) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.FAULT, reader)
        until = time.monotonic() + PATIENCE_S
        while not read_problems(runtime_paths("paper").notes) and time.monotonic() < until:
            time.sleep(0.005)  # it is written by and by
        control.process.send_signal(signal.SIGTERM)
        status, _, err = control.finish()
        emulator.stop()
        assert emulator.stage.applied_force == [0.0, 0.0]
    assert status == 0
    assert TOLD in err
    assert "wrong.py:" in err
