"""Error counters, missing acknowledgement and bus-off through a real CAN driver, caused by an adapter that has them."""

from collections.abc import Iterator

import pytest

from drivers.bus.port import BusState
from drivers.frame import Frame
from tests.vm import links
from tests.vm.ports import drained_until, port_on, receive
from tests.vm.slcan import SerialAdapter

pytestmark = pytest.mark.controller


@pytest.fixture
def adapter() -> Iterator[SerialAdapter]:
    links.run("modprobe", "slcan")
    adapter = SerialAdapter()
    yield adapter
    adapter.close()


def test_the_driver_sets_the_adapter_to_the_configured_bit_rate(adapter: SerialAdapter) -> None:
    adapter.up(1_000_000)
    adapter.heard("S8")  # Lawicel: 1 Mbit/s
    adapter.heard("O")
    assert links.details(adapter.name)["linkinfo"]["info_data"]["bittiming_bitrate"] == 1_000_000


def test_frames_cross_the_controller_in_both_directions(adapter: SerialAdapter) -> None:
    adapter.up(500_000)
    host = port_on(adapter.name, fd=False)
    assert host.send(Frame(0x080, bytes.fromhex("0102030405060708")))
    adapter.heard("t08080102030405060708")
    adapter.say("t1002BEEF")
    assert receive(host, 1)[0][:2] == (0x100, b"\xbe\xef")
    host.close()


def test_error_counters_rise_through_warning_to_passive_and_fall_again(adapter: SerialAdapter) -> None:
    adapter.up(500_000)
    host = port_on(adapter.name, fd=False)
    seen = []
    for letter, errors in (("w", 100), ("p", 130), ("a", 10)):
        before = host.counters().errors
        adapter.state(letter, 0, errors)
        drained_until(host, lambda before=before: host.counters().errors > before, f"state {letter}")  # type: ignore[misc]
        seen.append((host.counters().state, links.details(adapter.name)["linkinfo"]["info_data"]["state"]))
    assert seen == [
        (BusState.ERROR_ACTIVE, "ERROR-WARNING"),
        (BusState.ERROR_PASSIVE, "ERROR-PASSIVE"),
        (BusState.ERROR_ACTIVE, "ERROR-ACTIVE"),
    ]
    host.close()


def test_a_missing_acknowledgement_is_counted(adapter: SerialAdapter) -> None:
    adapter.up(500_000)
    host = port_on(adapter.name, fd=False)
    adapter.say("e2ab")  # two errors: acknowledgement and bit 0
    drained_until(host, lambda: host.counters().no_ack, "the missing acknowledgement")
    assert host.counters().errors >= 1
    host.close()


def test_bus_off_is_seen_sends_nothing_and_stays_until_somebody_restarts_it(adapter: SerialAdapter) -> None:
    adapter.up(500_000)
    host = port_on(adapter.name, fd=False)
    adapter.state("b", 0, 256)
    drained_until(host, lambda: host.counters().bus_off, "bus-off")
    assert host.counters().state is BusState.BUS_OFF
    assert links.details(adapter.name)["linkinfo"]["info_data"]["state"] == "BUS-OFF"
    assert host.rebind() is False, "opening it anew does not restart the controller"
    assert host.counters().state is BusState.BUS_OFF
    host.send(Frame(0x080, b"torque"))
    adapter.down()
    adapter.up(500_000)
    assert host.rebind() is True
    assert host.send(Frame(0x081, b"\x01"))
    adapter.heard("t081101")
    host.close()


def test_what_was_queued_while_nothing_could_be_sent_is_not_sent_after_the_restart(adapter: SerialAdapter) -> None:
    adapter.up(500_000)
    adapter.heard("O")
    host = port_on(adapter.name, fd=False)
    adapter.state("b", 0, 256)
    drained_until(host, lambda: host.counters().bus_off, "bus-off")
    for _ in range(3):
        host.send(Frame(0x0AA, b"stale"))
    host.purge()
    assert host.rebind() is True, "taking the interface down and up restarts this controller"
    adapter.heard("O")
    assert host.send(Frame(0x0BB, b"\x02"))
    assert "t0AA" not in adapter.heard("t0BB102")
    host.close()


def test_a_transmit_queue_of_one_refuses_when_the_wire_does_not_move(adapter: SerialAdapter) -> None:
    adapter.up(10_000, queue=1)
    host = port_on(adapter.name, fd=False, transmit_queue=1)
    adapter.stall()  # the serial line fills up, then the driver stops, then the interface's queue is full
    for _ in range(2000):
        host.send(Frame(0x080, b"setpoint"))
    counters = host.counters()
    assert counters.refused > 0
    assert counters.sent + counters.refused == 2000
    host.close()


def test_an_adapter_pulled_out_is_seen_as_a_bus_that_is_down(adapter: SerialAdapter) -> None:
    adapter.up(500_000)
    host = port_on(adapter.name, fd=False)
    name = adapter.name
    adapter.close()
    drained_until(host, lambda: host.counters().state is BusState.DOWN, "the host sees it")
    links.eventually(lambda: not links.exists(name), "the interface is gone")
    assert host.send(Frame(0x080, b"torque")) is False
    assert host.rebind() is False
    host.close()
