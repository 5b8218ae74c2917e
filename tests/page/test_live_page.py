"""The page as a process beside a live control process: E-STOP is quick, and who hangs is told."""

import signal
import time
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect
from websockets.typing import Origin

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.page.access import Role
from hil.page.frames import HEADER, Fate
from tests.support.live_rig import Control, emulated, every_record, order
from tests.support.page_process import PageProcess

MOVING = ("--set", "task.kind=circle", "--set", "task.radius=1e-3")
AT_MOST_S = 0.1  # from the request until the last torque that is not zero


def last_torque_ns() -> int:
    """When the last tick that asked for torque woke, monotonic ns."""
    records = every_record()
    assert np.any(records["force"]), "the stage never was under torque"
    return int(records["now_ns"][np.abs(records["force"]).max(axis=1) > 0.0].max())


@pytest.mark.live
def test_estop_takes_the_torque_away_within_a_tenth_of_a_second(tmp_path: Path) -> None:
    with emulated() as emulator, Control(*MOVING) as control, PageProcess(tmp_path / "state") as page:
        page.pair(Role.STOP, "Ana")
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        moving = reader.next + 250
        while reader.written < moving:  # a second of the approach
            assert control.process.poll() is None
            time.sleep(0.01)
        asked_ns = time.monotonic_ns()
        answer = page.ask("POST", "/rigs/paper/estop")
        control.wait_for(State.ESTOP, reader)
        assert answer["accepted"], answer
        assert "ESTOP in tick" in answer["said"]
        assert (last_torque_ns() - asked_ns) * 1e-9 < AT_MOST_S
        assert emulator.stage.applied_force == [0.0, 0.0]


@pytest.mark.live
def test_a_control_process_that_is_stopped_is_told_within_a_second(tmp_path: Path) -> None:
    with emulated(), Control() as control, PageProcess(tmp_path / "state") as page:
        page.pair(Role.WATCH, "Ana")
        control.wait_for(State.READY)
        headers = {"Cookie": page.cookie}
        address = f"ws://localhost:{page.port}/rigs/paper/feed"
        with connect(address, origin=Origin(page.url), additional_headers=headers, proxy=None) as feed:
            control.process.send_signal(signal.SIGSTOP)
            began = time.monotonic()
            age, fate = 0.0, Fate.NONE
            while not age > 0.5:
                message = feed.recv(5.0)
                if isinstance(message, bytes):
                    numbers = np.frombuffer(message, "<f8")[:HEADER]
                    age, fate = float(numbers[9]), Fate(int(numbers[10]))
            assert fate is Fate.ALIVE
            assert time.monotonic() - began < 1.0
            control.process.send_signal(signal.SIGCONT)
