"""Drives of the MIT kind: bytes against the makers' documents, both sides against each other, what is refused."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus_load.schedulability import analyse
from drivers.config import BusConfig
from drivers.frame import ECHO, EXTENDED, FD, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, Sample, own_ids
from sim_plant.drives.mit import CubeMars, Damiao, MitDrive, Ranges, RobStride
from sim_plant.drives.servo import ServoDrive

MS = 1_000_000
RATED = [7.0, 5.0]
TABLE: dict[str, Any] = {"position": [12.5], "torque": [10.0, 5.0]}
KINDS = ["damiao", "cubemars", "robstride"]
MADE = {"damiao": Damiao, "cubemars": CubeMars, "robstride": RobStride}


def bus(kind: str, **table: Any) -> BusConfig:
    return BusConfig.model_validate({"protocol": "mit", "mit": {"kind": kind, **TABLE, **table}})


def host_of(kind: str, **table: Any) -> Any:
    return host_protocol(bus(kind, **table), 2, RATED, Path(), MS)


def drives_of(kind: str, turns: list[float]) -> list[MitDrive]:
    hosts = {"damiao": [0x11, 0x12], "cubemars": [1, 2], "robstride": [0xFD, 0xFD]}[kind]
    return [
        MADE[kind](
            axis + 1,
            ServoDrive(axis, RATED[axis], 1e-6, 50 * MS, False, 0),
            lambda axis=axis: turns[axis],
            0,
            Ranges(12.5, TABLE["torque"][axis], hosts[axis]),
        )
        for axis in range(2)
    ]


# bytes as the makers print them ---------------------------------------------------------------------------------------


def test_a_torque_as_damiao_packs_it() -> None:
    host = host_of("damiao")
    assert isinstance(host.decode(Frame(0x11, bytes.fromhex("11800080080001e1"), 0, MS)), Sample)
    host.encode(Command(0, [0.0, 0.0], 0b01, False))
    frame, other = host.encode(Command(0, [5.0, 0.0], 0b01, False))
    assert (frame.can_id, frame.data.hex()) == (0x001, "7fff7ff000000bff")  # 3/4 of 4095 in the last twelve bits
    assert (other.can_id, other.data.hex()) == (0x002, "fffffffffffffffd")


def test_a_torque_as_robstride_packs_it() -> None:
    host = host_of("robstride")
    running = EXTENDED | 0x02_80_01_FD
    assert host.decode(Frame(running, bytes.fromhex("80007fff7fff011d"), 0, MS)).status == DriveStatus.ENABLED
    frame, other = host.encode(Command(0, [5.0, 0.0], 0b01, False))
    assert (frame.can_id, frame.data.hex()) == (EXTENDED | 0x01_BFFF_01, "7fff7fff00000000")
    assert (other.can_id, other.data.hex()) == (EXTENDED | 0x04_00FD_02, "0000000000000000")


@pytest.mark.parametrize("kind", KINDS)
def test_orders(kind: str) -> None:
    host = host_of(kind)
    start, _ = host.encode(Command(0, [1.0, 1.0], 0b01, False))
    clear, _ = host.encode(Command(1, [0.0, 0.0], 0b00, True))
    told = {
        "damiao": ("ff" * 7 + "fc", "ff" * 7 + "fb"),
        "cubemars": ("ff" * 7 + "fc", "ff" * 7 + "fd"),
        "robstride": ("00" * 8, "01" + "00" * 7),
    }
    assert (start.data.hex(), clear.data.hex()) == told[kind]


@pytest.mark.parametrize(
    ("code", "status"),
    [
        (0x0, 0),
        (0x1, DriveStatus.ENABLED),
        (0x8, DriveStatus.FAULT),
        (0xD, DriveStatus.WATCHDOG),
        (0xE, DriveStatus.FAULT),
    ],
)
def test_what_damiao_says_of_itself(code: int, status: int) -> None:
    sample = host_of("damiao").decode(Frame(0x12, bytes((code << 4 | 2, 0, 1, 0, 0, 0, 25, 25)), 0, MS))
    assert sample == Sample(1, 1 - 32768, status, -1, sample.stamp_ns)


@pytest.mark.parametrize("code", [0x2, 0x7, 0xF])
def test_a_code_that_the_maker_has_not_is_no_sample(code: int) -> None:
    frame = Frame(0x12, bytes((code << 4 | 2, 0, 1, 0, 0, 0, 25, 25)), 0, MS)
    assert host_of("damiao").decode(frame) is Reject.INVALID_VALUE


def test_a_drive_that_speaks_for_another_is_not_believed() -> None:
    assert host_of("damiao").decode(Frame(0x11, bytes((0x12, 80, 0, 0, 0, 0, 25, 25)), 0, MS)) is Reject.INVALID_VALUE


# both ends ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@given(force=st.floats(-5.0, 5.0), turn=st.floats(-1.9, 1.9))
def test_a_torque_arrives_and_a_position_comes_back(kind: str, force: float, turn: float) -> None:
    host, turns = host_of(kind), [turn, -turn]
    drives = drives_of(kind, turns)
    now_ns, sample = 0, Reject.SERVICE
    for tick in range(4):
        now_ns += MS
        for axis, frame in enumerate(host.encode(Command(tick, [force, -force], 0b11, False))):
            (answer,) = drives[axis].on_frame(frame._replace(timestamp_ns=now_ns))
            sample = host.decode(answer._replace(timestamp_ns=now_ns))
            assert isinstance(sample, Sample)
            assert sample.position * 25.0 / 65535 == pytest.approx(turns[axis] * 6.283185307179586, abs=6e-4)
    assert sample.status == DriveStatus.ENABLED
    for drive, sign, most in zip(drives, (1, -1), TABLE["torque"], strict=True):
        assert drive.servo.force == pytest.approx(sign * force, abs=1.01 * most / 4095)


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_that_timed_out_applies_nothing_until_it_is_reset(kind: str) -> None:
    host, (drive, _) = host_of(kind), drives_of(kind, [0.0, 0.0])
    now_ns = 0

    def tick(enable: int, reset: bool = False) -> Any:
        nonlocal now_ns
        now_ns += MS
        frame = host.encode(Command(0, [3.0, 0.0], enable, reset))[0]
        (answer,) = drive.on_frame(frame._replace(timestamp_ns=now_ns))
        return host.decode(answer._replace(timestamp_ns=now_ns))

    assert [tick(0b01).status for _ in range(3)][-1] == DriveStatus.ENABLED
    assert drive.servo.force != 0.0
    now_ns += 60 * MS
    drive.servo.trip(now_ns)
    told = tick(0b01)
    assert drive.servo.force == 0.0
    assert told.status & ~DriveStatus.ENABLED or kind == "cubemars"  # which cannot say
    tick(0b00, reset=True)
    tick(0b00)
    assert [tick(0b01).status for _ in range(3)][-1] == DriveStatus.ENABLED
    assert drive.servo.force != 0.0


@pytest.mark.parametrize("kind", KINDS)
@given(can_id=st.integers(0, EXTENDED | 0x1FFFFFFF), data=st.binary(max_size=8), flags=st.sampled_from([0, FD, ECHO]))
def test_any_frame_is_a_value_or_refused(kind: str, can_id: int, data: bytes, flags: int) -> None:
    host, device = host_of(kind), device_protocol(bus(kind), 2, RATED, Path())
    for one in (can_id, *host.answer_ids, *host.command_ids):
        assert isinstance(host.decode(Frame(one, data, flags, MS)), (Sample, Reject))
        device.decode_command(Frame(one, data, flags, MS))
        for drive in drives_of(kind, [0.0, 0.0]):
            drive.on_frame(Frame(one, data, flags, MS))


@pytest.mark.parametrize("kind", KINDS)
@given(force=st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=2))
def test_the_listener_reads_what_the_host_says(kind: str, force: list[float]) -> None:
    host, device = host_of(kind), device_protocol(bus(kind), 2, RATED, Path())
    for axis in range(2):
        told = device.encode_feedback(Sample(axis, 100 * axis, int(DriveStatus.ENABLED), -1, 0))
        assert host.decode(told._replace(timestamp_ns=MS)).position == 100 * axis
    command: Any = None
    for tick in range(3):
        for frame in host.encode(Command(tick, force, 0b11, False)):
            command = device.decode_command(frame)
    assert command.enable == 0b11
    assert command.force == pytest.approx(force, abs=10.01 / 4095)


# what a rig may say ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "table", "words"),
    [
        ("damiao", {"nodes": [1]}, "bus.mit.nodes has 1 values for 2 axes"),
        ("damiao", {"nodes": [1, 1]}, "a value twice"),
        ("damiao", {"nodes": [1, 17]}, "lowest four bits"),
        ("damiao", {"answers": [2, 1]}, "number of another drive"),
        ("cubemars", {"answers": [7, 7]}, "a value twice"),
        ("robstride", {"torque": [4.0]}, "is to give 7"),
        ("robstride", {"position": [1.0, 2.0, 3.0]}, "bus.mit.position has 3 values for 2 axes"),
    ],
)
def test_a_binding_that_cannot_be_is_refused(kind: str, table: dict[str, Any], words: str) -> None:
    with pytest.raises(LayoutError, match=words):
        host_of(kind, **table)


def test_a_command_of_another_host_is_ours_whatever_it_asks_for() -> None:
    (own,) = own_ids(host_of("robstride"))
    assert all(EXTENDED | 0x01_0000_02 | torque << 8 in own for torque in (0, 0x1234, 0xFFFF))
    assert EXTENDED | 0x02_80_02_FD not in own


def test_an_answer_may_have_the_identifier_of_its_command() -> None:
    assert analyse(host_of("cubemars").messages(2 * MS), 1_000_000, 1_000_000).schedulable
    (own,) = own_ids(host_of("cubemars"))
    assert 1 not in own, "a command of another host cannot be told from an answer"


def test_an_echo_tells_when_the_last_command_was_out() -> None:
    host = host_of("robstride")
    sent = host.encode(Command(0, [0.0, 0.0], 0, False))[-1]
    assert host.decode(Frame(sent.can_id, sent.data, ECHO, 7 * MS)) is Reject.OWN_ECHO
    sample = host.decode(Frame(EXTENDED | 0x02_00_02_FD, bytes(8), 0, 8 * MS))
    assert sample.stamp_ns == 7 * MS


@pytest.mark.parametrize("code", range(1, 9))
def test_what_cubemars_says_of_itself(code: int) -> None:
    outcome = host_of("cubemars").decode(Frame(1, bytes((1, 128, 0, 0, 0, 0, 25, code)), 0, MS))
    if code == 8:
        assert outcome is Reject.INVALID_VALUE
    else:
        assert outcome.status == int(DriveStatus.FAULT) | (int(DriveStatus.ENCODER_FAULT) if code == 5 else 0)


def test_a_short_frame_is_told_by_its_length() -> None:
    assert host_of("damiao").decode(Frame(0x11, b"\x11", 0, MS)) is Reject.WRONG_LENGTH
