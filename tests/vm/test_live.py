"""The whole loop, live over the kernel's CAN stack: control process, emulated stage, and what a bus does to them."""

import subprocess
from pathlib import Path

import pytest

from drivers.bus.counters import BusState
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from tests.vm import links
from tests.vm.live import LAYOUTS, RIGS, assert_closed_loop, live_rig

pytestmark = pytest.mark.vcan


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_closes_the_loop_live(vcan: str, layout: str) -> None:
    file, protocol = LAYOUTS[layout]
    with live_rig(vcan, f"bus.protocol={protocol}", rig=RIGS / file) as rig:
        assert_closed_loop(rig)
        assert rig.stop() == 0
        assert rig.applied_forces() == [0.0, 0.0]


def test_an_interface_that_goes_down_stops_the_rig_and_only_a_reset_brings_it_back(vcan: str) -> None:
    with live_rig(vcan) as rig:
        rig.activate()
        links.ip("link", "set", vcan, "down")
        rig.wait_for(State.FAULT)
        assert Fault(int(rig.newest()["fault"])) is Fault.INTERFACE_DOWN
        links.ip("link", "set", vcan, "up")
        # the port comes back by itself, the state does not
        links.eventually(lambda: rig.bus_state() is BusState.ERROR_ACTIVE, "the port is bound again")
        after = rig.wait_ticks(50)
        assert set(after["state"]) == {State.FAULT}
        assert rig.applied_forces() == [0.0, 0.0], "the drives' own watchdogs have acted"
        rig.to_ready()
        states = rig.records()["state"]
        last_fault = int((states == State.FAULT).nonzero()[0][-1])
        assert State.ACTIVE not in states[last_fault:]
        assert_closed_loop(rig)


def test_foreign_traffic_on_the_drives_identifiers_leads_to_zero_torque(vcan: str) -> None:
    with live_rig(vcan) as rig:
        rig.activate()
        # random bytes under the first drive's identifier, fifty to a tick, until the rig has had enough of it
        generator = ["cangen", vcan, "-g", "1", "-f", "-b", "-I", "100", "-L", "16", "-p", "100"]
        with subprocess.Popen(generator) as process:
            try:
                rig.wait_for(State.FAULT)
            finally:
                process.terminate()
        assert Fault(int(rig.newest()["fault"])) in (Fault.BAD_FRAMES, Fault.RECEIVE_FLOOD)
        after = rig.wait_ticks(20)
        assert set(after["state"]) == {State.FAULT}
        assert (after["force"] == 0.0).all()


def test_foreign_tools_watching_change_nothing(vcan: str, tmp_path: Path) -> None:
    with live_rig(vcan) as rig, links.candump(vcan) as dump:
        rig.active_for(50)
        dump.terminate()
        frames, _ = dump.communicate(timeout=links.PATIENCE_S)
    seen = {line.split()[2].partition("#")[0] for line in frames.splitlines() if line.count(" ") == 2}
    assert seen == {"080", "100", "101"}, "commands and both drives' answers, and nothing else"
