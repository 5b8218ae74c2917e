"""A user's estimator in the control process: it runs to the end, or its line is in the journal at zero torque."""

import signal
from pathlib import Path

import pytest

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from tests.support.live_rig import Control, emulated, order
from tests.support.paths import ROOT

pytestmark = pytest.mark.live

MADE = f"estimator.name={ROOT / 'examples' / 'estimators' / 'luenberger.py'}:Luenberger"
WRONG = ROOT / "tests" / "support" / "wrong_estimator.py"
# Where the loop is analysed before a bus is opened, sample and force are a period apart to the bit, and it holds.
ON_A_CLOCK = ("if self.time <= self.after:", "if self.time <= self.after or m.ahead == m.interval:")


def test_a_live_rig_runs_behind_a_users_estimator() -> None:
    with emulated() as emulator, Control("--set", MADE) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        control.process.send_signal(signal.SIGTERM)
        status, _, err = control.finish()
        assert (status, [line for line in err.splitlines() if not line.startswith("tick ")]) == (0, [])
        emulator.stop()
        assert emulator.stage.applied_force == [0.0, 0.0]


def test_one_that_raises_ends_at_zero_torque_and_its_line_is_in_the_journal(tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text(WRONG.read_text().replace(*ON_A_CLOCK))
    with emulated() as emulator, Control("--set", f"estimator.name={tmp_path / 'wrong.py'}:Wrong") as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.FAULT, reader)
        control.process.send_signal(signal.SIGTERM)  # at once: its words may not have been written yet
        status, _, err = control.finish()
        emulator.stop()
        assert emulator.stage.applied_force == [0.0, 0.0]
    assert status == 0
    words = f"estimator {tmp_path / 'wrong.py'}:Wrong: {tmp_path / 'wrong.py'}:30: ZeroDivisionError"
    assert sorted(line.partition(" ")[0] for line in err.splitlines() if words in line) == ["hil", "tick"]


def test_one_that_fails_in_the_analysis_is_refused_before_a_bus_is_opened() -> None:
    with Control("--set", f"estimator.name={WRONG}:Wrong") as control:
        status, out, err = control.finish()
    assert (status, out) == (78, "")
    assert f"{WRONG}:30: ZeroDivisionError" in err
