"""A real control process begins with what is kept of its rig, keeps it at its end, and `--fresh` begins without."""

import signal

import pytest

from hil.control.laws.presliding_kalman import KEPT
from hil.cycle.state_machine import State
from hil.live.kept_learnt import keep, kept_path
from tests.support.live_rig import Control, emulated, rig_with

pytestmark = pytest.mark.live

RIG = ("law.name=presliding-kalman", "law.gains={}")
STATE = [[0.0, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0] + [0.0] * (KEPT - 7)] * 2


def test_a_run_begins_with_what_is_kept_and_keeps_it_at_its_end() -> None:
    path = kept_path(rig_with(RIG))
    sets = [word for text in RIG for word in ("--set", text)]

    def said(*more: str) -> str:
        """Standard output of a run that begins and ends without its file."""
        with emulated(RIG), Control(*sets, *more) as control:
            control.wait_for(State.READY)
            path.unlink(missing_ok=True)
            control.process.send_signal(signal.SIGTERM)
            status, out, _ = control.finish()
        assert status == 0
        return out

    assert "learnt" not in said()
    assert not path.exists()  # it has not moved
    keep(rig_with(RIG), STATE)
    learnt = path.read_bytes()
    assert f"begins with what earlier runs have learnt of x, y ({path})" in said()
    assert path.read_bytes() == learnt
    assert "learnt" not in said("--fresh")
    assert not path.exists()
