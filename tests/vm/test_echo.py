"""The echo of the trigger on a real CAN stack: what cia402 and DBC drives' sampling instants are told from."""

import time

import pytest

from drivers.bus.port import open_port
from drivers.frame import BRS, ECHO, FD, Frame
from tests.vm.ports import bus_config, port_on, receive

pytestmark = pytest.mark.vcan

TRIGGER = Frame(0x080, b"\x01")
SLACK_NS = 200_000  # the two clocks are read one after the other, on a slow guest


def test_the_echo_that_was_asked_for_comes_back_stamped_with_when_it_was_out(vcan: str) -> None:
    host = open_port(bus_config(vcan), role="host", fd=True, echo_id=TRIGGER.can_id)
    device = port_on(vcan)
    for frame in (TRIGGER, Frame(0x080, bytes(24), FD | BRS)):
        before = time.monotonic_ns()
        assert host.send(Frame(0x201, b"torques"))
        assert host.send(frame)
        after = time.monotonic_ns()
        device.send(Frame(0x181, b"answer"))
        echo, answer = receive(host, 2)
        assert echo[:3] == (frame.can_id, frame.data, echo.flags)
        assert echo.flags & ECHO
        assert before - SLACK_NS <= echo.timestamp_ns <= after + SLACK_NS
        assert echo.timestamp_ns <= answer.timestamp_ns
        assert not answer.flags & ECHO
        _, trigger = receive(device, 2)
        assert abs(trigger.timestamp_ns - echo.timestamp_ns) <= SLACK_NS
    assert host.counters().echo == 4
    host.close()
    device.close()


def test_the_same_frame_of_another_program_is_no_echo(vcan: str) -> None:
    host = open_port(bus_config(vcan), role="host", fd=True, echo_id=TRIGGER.can_id)
    other = port_on(vcan)
    other.send(TRIGGER)
    (frame,) = receive(host, 1)
    assert not frame.flags & ECHO
    assert host.counters().echo == 0
    host.close()
    other.close()
