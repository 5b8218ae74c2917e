"""The emulated moteus controller, spoken to by the maker's own Python client."""

import math
import struct
from typing import Any

import pytest
from moteus import Controller, QueryResolution
from moteus import moteus as client

from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame
from sim_plant.drives.moteus import Moteus
from sim_plant.drives.servo import NEVER_NS, ServoDrive

MS = 1_000_000
STOPPED, FAULT, PREPARING, POSITION, TIMEOUT = 0, 1, 2, 10, 11
TORQUE = {"position": math.nan, "velocity": 0.0, "kp_scale": 0.0, "kd_scale": 0.0}


class Bench:
    """One controller with id 3, a motor of 2 N m and a default timeout of 100 ms, at -0.5 turns."""

    def __init__(self, **more: int) -> None:
        self.servo = ServoDrive(0, 2.0, 1e-7, 100 * MS, False, 0)
        self.drive = Moteus(3, self.servo, lambda: -0.5, 0, **more)
        resolution = QueryResolution()
        resolution.velocity = resolution.torque = resolution.temperature = client.mp.INT16
        self.client = Controller(id=3, transport=object(), query_resolution=resolution)
        self.now = 0

    def raw(self, data: bytes, can_id: int = EXTENDED | 0x8003, flags: int = FD | BRS) -> list[Frame]:
        self.now += MS
        padded = data + b"\x50" * (next(n for n in FD_LENGTHS if n >= len(data)) - len(data))
        return self.drive.on_frame(Frame(can_id, padded, flags, self.now))

    def send(self, command: Any) -> dict[int, float]:
        """What it says after a command."""
        self.raw(command.data)
        (frame,) = self.raw(self.client.make_query().data)
        assert frame.can_id == 0x300
        assert frame.flags == FD | BRS
        return dict(client.parse_registers(frame.data).response)

    def torque(self, torque: float, **more: float) -> dict[int, float]:
        return self.send(self.client.make_position(**(TORQUE | {"feedforward_torque": torque} | more), query=True))

    def stop(self) -> dict[int, float]:
        return self.send(self.client.make_stop(query=True))


@pytest.mark.parametrize(("node", "can_id"), [(7, 0x700), (8, EXTENDED | 0x800), (127, EXTENDED | 0x7F00)])
def test_answers_that_fit_no_standard_identifier_are_extended(node: int, can_id: int) -> None:
    drive = Moteus(node, ServoDrive(0, 2.0, 1e-7, 100 * MS, False, 0), lambda: -0.5, 0)
    (answer,) = drive.on_frame(Frame(EXTENDED | 0x8000 | node, b"\x11\x00\x50\x50", FD | BRS, MS))
    assert answer.can_id == can_id


@pytest.mark.parametrize(("kind", "least"), [(0, "80"), (1, "00 80"), (2, "00 00 00 80"), (3, "00 00 c0 7f")])
def test_a_number_that_is_none_is_the_least_integer_of_its_type(kind: int, least: str) -> None:
    bench = Bench()
    bench.torque(0.5)
    (frame,) = bench.raw(bytes((0x10 | kind << 2 | 1, 0x20)))  # the position that is commanded: none
    head = bytes((0x20 | kind << 2 | 1, 0x20))
    assert frame.data.rstrip(b"\x50") == head + bytes.fromhex(least)
    assert math.isnan(client.parse_registers(frame.data).response[0x20])


STEPS = {  # of int8, int16, int32: the maker's table, "Mappable values"
    0x20: (0.01, 0.0001, 0.00001), 0x21: (0.1, 0.00025, 0.00001), 0x22: (0.5, 0.01, 0.001),
    0x23: (1 / 127, 1 / 32767, 1 / 2147483647), 0x24: (1 / 127, 1 / 32767, 1 / 2147483647), 0x25: (0.5, 0.01, 0.001),
    0x27: (0.01, 0.001, 0.000001), 0x2B: (1 / 127, 1 / 32767, 1 / 2147483647),
}  # fmt: skip


@pytest.mark.parametrize("register", STEPS)
@pytest.mark.parametrize("kind", range(3))
def test_an_integer_is_written_and_read_in_the_steps_of_its_register(kind: int, register: int) -> None:
    bench, value = Bench(), struct.pack(f"<{'bhi'[kind]}", 77)
    write, padding = bytes((kind << 2 | 1, register)) + value, b"\x50"
    (answer,) = bench.raw(write + padding + bytes((0x1D, register, 0x11 | kind << 2, register)))
    assert answer.data[:2] == bytes((0x2D, register))
    assert struct.unpack("<f", answer.data[2:6])[0] == pytest.approx(77 * STEPS[register][kind], rel=1e-6)
    assert answer.data[6:].startswith(bytes((0x21 | kind << 2, register)) + value)


def test_torque_is_the_feedforward_of_position_mode_without_a_loop() -> None:
    bench = Bench()
    told = bench.torque(0.5)
    assert bench.servo.force == 0.5
    assert (told[0x00], told[0x0F]) == (POSITION, 0)
    assert told[0x01] == pytest.approx(-0.5)
    bench.torque(0.5, kp_scale=1.0)
    assert bench.servo.force == 0.0  # a loop of its own
    bench.torque(0.5, kd_scale=1.0)
    assert bench.servo.force == 0.5  # limited to the scale of kp
    assert bench.torque(-5.0)[0x0F] == 99
    assert bench.servo.force == -2.0
    assert bench.torque(1.0, maximum_torque=0.25)[0x0F] == 102
    assert bench.servo.force == 0.25
    bench.torque(0.5)
    assert bench.stop()[0x00] == STOPPED
    assert bench.servo.force == 0.0


def test_a_frame_that_writes_the_mode_begins_from_defaults() -> None:
    bench = Bench()
    bench.torque(0.5)
    bench.raw(bytes((0x01, 0x00, POSITION)))
    assert bench.servo.force == 0.0  # no feedforward, and a loop of its own
    bench.torque(0.5)
    bench.raw(b"\x0d\x22" + b"\x00\x00\x80\x3e")  # a register alone
    assert bench.servo.force == 0.25


@pytest.mark.parametrize("timeout", [0.01, 0.0, math.nan])
def test_its_watchdog_is_what_the_command_says(timeout: float) -> None:
    bench = Bench()
    bench.torque(0.5, watchdog_timeout=timeout)
    heard = bench.now - MS
    due = {0.01: heard + 10 * MS, 0.0: heard + 100 * MS}.get(timeout, heard + NEVER_NS)
    assert bench.servo.deadline_ns == due
    bench.stop()
    assert bench.servo.deadline_ns == NEVER_NS  # stopped, it waits for nobody


def test_it_leaves_timeout_and_fault_by_a_stop_alone() -> None:
    bench = Bench()
    bench.torque(0.5)
    bench.servo.trip(bench.now)
    assert bench.torque(0.5)[0x00] == TIMEOUT
    assert bench.servo.force == 0.0
    assert bench.stop()[0x00] == STOPPED
    bench.torque(0.5)
    bench.servo.fail()
    told = bench.torque(0.5)
    assert (told[0x00], told[0x0F], bench.servo.force) == (FAULT, 33, 0.0)
    bench.stop()
    assert bench.torque(0.5)[0x00] == POSITION


def test_it_takes_its_time_to_enable() -> None:
    bench = Bench(enable_delay_ns=2 * MS)
    assert bench.torque(0.5)[0x00] == PREPARING
    assert bench.servo.force == 0.0
    assert bench.torque(0.5)[0x00] == POSITION
    assert bench.servo.force == 0.5


def test_it_hears_its_own_id_alone_and_answers_when_asked() -> None:
    bench = Bench()
    data = bench.client.make_position(**TORQUE, feedforward_torque=0.5).data
    assert bench.raw(data, EXTENDED | 0x8004) == []
    assert bench.raw(data, 0x003, flags=0) == []  # classic
    assert bench.servo.force == 0.0
    assert bench.raw(data, 0x003) == []  # no answer wanted
    assert bench.servo.force == 0.5
    (frame,) = bench.raw(b"\x11\x00", EXTENDED | 0xA503)
    assert frame.can_id == 0x325


def test_what_is_damaged_is_lost_and_what_it_has_not_is_refused() -> None:
    bench = Bench()
    (frame,) = bench.raw(b"\x11\x00\x0c\xff\x01\x22\x00")  # 255 values that are not there
    assert client.parse_registers(frame.data).response == {0: STOPPED}
    (frame,) = bench.raw(b"\x11\xf0\x07\x01\x01\x01\x11\x00")  # an unknown register to read, position to write
    errors = client.parse_registers(frame.data)
    assert errors.errors == [(0x3F0, 1), (0x01, 2)]
    assert errors.response[0] == STOPPED
