"""Bus-off under the whole control loop: torque ends, and nothing arms it again but the operator's reset."""

from collections.abc import Iterator

import pytest

from drivers.bus.counters import BusState
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from tests.vm import links
from tests.vm.live import UNHURRIED, LiveRig, live_rig
from tests.vm.ports import port_on
from tests.vm.relay import RelayingAdapter

pytestmark = pytest.mark.controller

BITRATE = 1_000_000


@pytest.fixture
def adapter(vcan: str) -> Iterator[RelayingAdapter]:
    """Up at BITRATE, with `vcan` as its bus."""
    links.run("modprobe", "slcan")
    beyond = port_on(vcan, fd=False)
    adapter = RelayingAdapter(beyond)
    adapter.up(BITRATE)
    yield adapter
    adapter.close()
    beyond.close()


def controller_state(adapter: RelayingAdapter) -> str:
    return str(links.details(adapter.name)["linkinfo"]["info_data"]["state"])


def stays_in_fault(rig: LiveRig, ticks: int = 20) -> None:
    """Not a frame reaches the drives, no state but FAULT is seen, no drive applies any force."""
    before = rig.stage()["commands"]
    assert set(rig.wait_ticks(ticks)["state"]) == {State.FAULT}
    assert rig.stage()["commands"] == before
    assert rig.applied_forces() == [0.0, 0.0]


def trips(rig: LiveRig) -> int:
    """How often a drive's own watchdog has ended its torque."""
    return sum(len(axis["trips"]) for axis in rig.stage()["axes"].values())


def goes_off(rig: LiveRig, adapter: RelayingAdapter) -> None:
    """Bus-off while the rig is ACTIVE; the drives' own watchdogs end the torque."""
    rig.activate()
    before = trips(rig)
    adapter.state("b", 0, 256)
    rig.wait_for(State.FAULT)
    assert Fault(int(rig.newest()["fault"])) is Fault.BUS_OFF
    links.eventually(lambda: trips(rig) == before + len(rig.applied_forces()), "each drive has tripped")
    assert controller_state(adapter) == "BUS-OFF"
    stays_in_fault(rig)


def never_active_since(rig: LiveRig, tick: int) -> bool:
    return State.ACTIVE not in rig.records()["state"][tick:]


def test_bus_off_ends_torque_and_only_the_operator_arms_it_again(adapter: RelayingAdapter, vcan: str) -> None:
    with live_rig(adapter.name, "bus.protocol=stage_classic", *UNHURRIED, stage_channel=vcan) as rig:
        goes_off(rig, adapter)
        off = len(rig.records())

        # somebody restarts the controller: the bus is back, the rig is not
        adapter.down()
        adapter.up(BITRATE)
        links.eventually(lambda: rig.bus_state() is BusState.ERROR_ACTIVE, "the port sees the bus again")
        assert controller_state(adapter) == "ERROR-ACTIVE"
        stays_in_fault(rig)
        rig.order(CommandKind.ACTIVATE)
        stays_in_fault(rig)
        rig.to_ready()
        assert never_active_since(rig, off)

        # off once more: this time the operator's reset restarts the controller as well
        goes_off(rig, adapter)
        off = len(rig.records())
        rig.to_ready()
        assert controller_state(adapter) == "ERROR-ACTIVE"
        assert never_active_since(rig, off)
        rig.activate()
        assert rig.stop() == 0
