"""The moteus layout, its frames read and written by the maker's own Python client, too."""

import contextlib
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from moteus import moteus as client
from moteus import multiplex

from drivers.bus_load.schedulability import analyse
from drivers.config import BusConfig
from drivers.families.moteus.registers import REPLY, STEPS, Register, Type, Value, padded, parse, read, step_of, write
from drivers.frame import BRS, ECHO, ERROR, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, Sample

MS = 1_000_000
RATED = [2.0, 1.0]
KINDS = st.sampled_from(list(Type))
FORMATS = {Type.INT8: "b", Type.INT16: "h", Type.INT32: "i", Type.FLOAT: "f"}
POSITION, STOPPED, FAULT, TIMEOUT = 10, 0, 1, 11


def bus(**table: Any) -> BusConfig:
    return BusConfig.model_validate({"protocol": "moteus", "moteus": table})


def ends(**table: Any) -> tuple[Any, Any]:
    host, device = host_protocol(bus(**table), 2, RATED, Path(), MS), device_protocol(bus(**table), 2, RATED, Path())
    prove(host, table.get("nodes", [1, 2]))
    return host, device


def prove(host: Any, nodes: Sequence[int]) -> None:
    """Tell it that its drives keep what every command says, and nothing else of them."""
    kept = struct.pack("<BBffBBfBBf", 0x2E, 0x23, 0.0, 0.0, 0x2D, 0x2B, 0.0, 0x2D, 0x27, 0.01)
    for _ in range(4):
        host.encode(Command(0, [0.0, 0.0], 0, False))
        for node in nodes:
            identifier = node << 8 if node < 8 else EXTENDED | node << 8
            assert host.decode(Frame(identifier, padded(kept), FD | BRS, MS)) is Reject.SERVICE


def answer(node: int, mode: int, turns: float, fault: int = 0) -> Frame:
    data = struct.pack("<BBbBBiBBb", 0x21, 0x00, mode, 0x29, 0x01, round(turns * 1e5), 0x21, 0x0F, fault)
    return Frame(node << 8, data, FD | BRS, MS)


# the register protocol ------------------------------------------------------------------------------------------------


@given(kind=KINDS, register=st.integers(0, 127), values=st.lists(st.integers(-127, 127), min_size=1, max_size=3))
def test_the_makers_client_reads_what_is_written(kind: Type, register: int, values: list[int]) -> None:
    data = padded(write(register, kind, *values) + read(register, kind, len(values)))
    assert len(data) in FD_LENGTHS
    registers = [f for f in multiplex.parse_frame(data) if isinstance(f, multiplex.RegisterSubframe)]
    written = [f for f in registers if f.type is multiplex.SubframeType.WRITE]
    assert [(f.register, f.resolution, f.value) for f in written] == [
        (register + number, int(kind), value) for number, value in enumerate(values)
    ]
    asked = [f for f in registers if f.type is multiplex.SubframeType.READ]
    assert [(f.register, f.resolution) for f in asked] == [(register + n, int(kind)) for n in range(len(values))]


@given(kind=KINDS, register=st.sampled_from(sorted(STEPS)), raw=st.integers(-128, 127))
def test_values_scale_as_the_makers_client_scales_them(kind: Type, register: int, raw: int) -> None:
    data = struct.pack("<BB" + FORMATS[kind], REPLY | kind << 2 | 1, register, raw)
    (value,) = parse(data)
    theirs = client.parse_registers(data).response[register]
    assert value.number == pytest.approx(theirs, nan_ok=True)


@given(data=st.binary(max_size=64))
def test_any_bytes_are_registers_or_refused(data: bytes) -> None:
    host, device = ends()
    with contextlib.suppress(ValueError):
        assert all(isinstance(value, Value) for value in parse(data))
    if len(data) in FD_LENGTHS:
        host.decode(Frame(0x100, data, FD, MS))
        device.decode_command(Frame(EXTENDED | 0x8001, data, FD, MS))


def test_a_frame_means_to_the_makers_client_what_it_should() -> None:
    host, _ = ends(nodes=[1, 9])
    first, second = host.encode(Command(0, [0.5, -0.25], 0b11, False))
    assert (first.can_id, second.can_id) == (EXTENDED | 0x8001, EXTENDED | 0x8009)
    told = client.parse_registers(second.data).command
    assert told[0x00] == POSITION
    assert next(iter(told)) == 0x00  # the mode has to come first
    assert math.isnan(told[0x20])
    assert (told[0x21], told[0x22], told[0x23], told[0x24], told[0x2B]) == (0, -0.25, 0, 0, 0)
    assert told[0x27] == pytest.approx(0.01)
    assert {register for register, _ in client.parse_registers(second.data).query} == {0x00, 0x01, 0x0F}
    assert len(first.data) == 32


# the host -------------------------------------------------------------------------------------------------------------


def modes(frames: list[Frame]) -> list[int | None]:
    return [client.parse_registers(frame.data).command.get(0) for frame in frames]


@pytest.mark.parametrize("kind", Type)
def test_what_counts_nothing_counts_in_ones(kind: Type) -> None:
    assert step_of(Register.MODE, kind) == step_of(Register.FAULT, kind) == 1.0


def test_a_start_stops_nothing_and_clears_nothing() -> None:
    host, _ = ends()
    idle = Command(0, [0.0, 0.0], 0, False)
    for mode in (None, STOPPED, FAULT, TIMEOUT):
        if mode is not None:
            host.decode(answer(1, mode, 0.0))
        assert modes(host.encode(idle)) == [None, None]
    host.decode(answer(1, 12, 0.0))  # somebody else's, or of the process before
    assert modes(host.encode(idle)) == [STOPPED, None]
    assert modes(host.encode(idle._replace(reset=True))) == [STOPPED, STOPPED]


def test_a_drive_that_was_enabled_is_stopped_until_it_says_so() -> None:
    host, _ = ends()
    idle = Command(0, [0.0, 0.0], 0, False)
    assert modes(host.encode(Command(0, [1.0, 0.0], 0b01, False))) == [POSITION, None]
    host.decode(answer(1, STOPPED, 0.0))  # of the tick before
    assert modes(host.encode(idle)) == [STOPPED, None]
    host.decode(answer(1, POSITION, 0.0))
    assert modes(host.encode(idle)) == [STOPPED, None]
    for _ in range(2):
        assert modes(host.encode(idle)) == [STOPPED, None]  # its answers are lost
    host.decode(answer(1, STOPPED, 0.0))
    assert modes(host.encode(idle)) == [None, None]


@pytest.mark.parametrize(
    ("mode", "fault", "enabled", "status"),
    [
        (POSITION, 0, True, DriveStatus.ENABLED),
        (POSITION, 99, True, DriveStatus.ENABLED | DriveStatus.TORQUE_LIMITED),
        (STOPPED, 0, True, DriveStatus(0)),
        (2, 0, True, DriveStatus(0)),
        (12, 0, True, DriveStatus(0)),  # with power, and not as it was told
        (12, 0, False, DriveStatus.ENABLED),
        (FAULT, 33, True, DriveStatus.FAULT),
        (FAULT, 35, False, DriveStatus.FAULT | DriveStatus.ENCODER_FAULT),
        (TIMEOUT, 0, False, DriveStatus.WATCHDOG),
    ],
)
def test_modes_and_codes_mean(mode: int, fault: int, enabled: bool, status: DriveStatus) -> None:
    host, _ = ends()
    host.encode(Command(0, [0.0, 0.0], 0b11 if enabled else 0, False))
    sample = host.decode(answer(2, mode, -1.25, fault))
    assert isinstance(sample, Sample)
    assert (sample.axis, sample.position, sample.status) == (1, -125_000, status)


@pytest.mark.parametrize("node", [1, 2])
def test_a_drive_that_has_power_before_anything_was_said_is_enabled(node: int) -> None:
    sample = ends()[0].decode(answer(node, 12, 0.0))
    assert isinstance(sample, Sample)
    assert sample.status == DriveStatus.ENABLED


def test_what_is_no_sample_is_told_apart() -> None:
    host, _ = ends()
    good = answer(1, POSITION, 0.5)
    cases = {
        Reject.UNKNOWN_ID: good._replace(can_id=0x300),
        Reject.OWN_ECHO: Frame(EXTENDED | 0x8001, b"", FD),
        Reject.ERROR_FRAME: Frame(ERROR | 4, bytes(8)),
        Reject.WRONG_LENGTH: good._replace(data=good.data[:6]),
        Reject.SERVICE: good._replace(data=good.data[:3]),
    }
    for reason, frame in cases.items():
        assert host.decode(frame) is reason
    for frame in (good._replace(flags=0), good._replace(can_id=REMOTE | 0x100), good._replace(can_id=EXTENDED | 0x100)):
        assert host.decode(frame) is Reject.WRONG_FORMAT
    nowhere = struct.pack("<BBbBBi", 0x21, 0x00, POSITION, 0x29, 0x01, -(2**31)) + b"\x50" * 3
    assert host.decode(good._replace(data=nowhere)) is Reject.INVALID_VALUE
    refused = good._replace(data=bytes((0x30, 0x2B, 1)) + good.data + b"\x50")
    assert isinstance(host.decode(refused), Sample)
    assert host.problems == ["axis 0: write of register 02Bh refused, error 1"]


@given(turns=st.floats(-3.2, 3.2), kind=st.sampled_from(["int16", "int32", "float"]), node=st.integers(1, 127))
def test_a_position_arrives_in_any_type(turns: float, kind: str, node: int) -> None:
    host, device = ends(position=kind, nodes=[node, 128 - node if node != 64 else 1])
    sample = Sample(0, round(turns * 1e5), int(DriveStatus.ENABLED), -1, 0)
    heard = host.decode(device.encode_feedback(sample))
    assert isinstance(heard, Sample)
    assert heard.status == sample.status
    assert abs(heard.position - sample.position) <= (5 if kind == "int16" else 0)


@given(share=st.lists(st.floats(-1, 1), min_size=2, max_size=2), kind=st.sampled_from(["int16", "int32", "float"]))
def test_a_torque_arrives_in_any_type(share: list[float], kind: str) -> None:
    host, device = ends(torque=kind)
    force = [part * rated for part, rated in zip(share, RATED, strict=True)]
    first, last = host.encode(Command(0, force, 0b11, False))
    assert device.decode_command(first) is Reject.SERVICE
    command = device.decode_command(last)
    assert isinstance(command, Command)
    assert command.enable == 0b11
    assert command.force == pytest.approx(force, abs=device.force_resolution * min(RATED) * 1.001 + 1e-6)


@pytest.mark.parametrize(
    ("told", "heard"),
    [
        (DriveStatus(0), DriveStatus(0)),
        (DriveStatus.ENABLED, DriveStatus.ENABLED),
        (DriveStatus.WATCHDOG, DriveStatus.WATCHDOG),
        (DriveStatus.ENABLED | DriveStatus.FAULT, DriveStatus.FAULT),
        (DriveStatus.ENCODER_FAULT, DriveStatus.ENCODER_FAULT | DriveStatus.FAULT),
    ],
)
def test_a_status_arrives_as_it_was_meant(told: DriveStatus, heard: DriveStatus) -> None:
    host, device = ends()
    if told & DriveStatus.ENABLED:
        host.encode(Command(0, [0.0, 0.0], 0b11, False))
    sample = host.decode(device.encode_feedback(Sample(1, 5, int(told), -1, 0)))
    assert isinstance(sample, Sample)
    assert sample.status == heard


def test_the_answers_of_nodes_from_8_on_have_extended_identifiers() -> None:
    for node, can_id in ((7, 0x700), (8, EXTENDED | 0x800), (127, EXTENDED | 0x7F00)):
        host, device = ends(nodes=[1, node])
        frame = device.encode_feedback(Sample(1, 5, 0, -1, 0))
        assert frame.can_id == can_id
        assert isinstance(host.decode(frame), Sample)


def test_each_drive_samples_when_it_has_its_own_frame() -> None:
    host, _ = ends()
    frames = host.encode(Command(0, [0.0, 0.0], 0b11, False))
    out_ns = 10**9
    host.decode(frames[1]._replace(flags=FD | BRS | ECHO, timestamp_ns=out_ns))
    first, second = (host.decode(answer(node, POSITION, 0.0)._replace(timestamp_ns=out_ns + 99_000)) for node in (1, 2))
    assert second.stamp_ns == out_ns
    assert 100_000 < out_ns - first.stamp_ns < 140_000  # a frame of 32 bytes


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"nodes": [1]}, "1 numbers for 2 axes"),
        ({"nodes": [3, 3]}, "a number twice"),
        ({"nodes": [0, 1]}, "greater than or equal to 1"),
        ({"torque": "int8"}, "int16"),
        ({"watchdog": 1}, "watchdog"),
    ],
)
def test_a_table_that_cannot_be_is_refused(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        ends(**table)


def test_a_torque_that_its_type_does_not_reach_is_refused() -> None:
    with pytest.raises(LayoutError, match=r"reaches 327.67 N m; axis 1 has 400"):
        host_protocol(bus(torque="int16"), 2, [2.0, 400.0], Path())


def test_the_messages_announced_are_the_frames_sent() -> None:
    host, device = ends()
    announced = {message.can_id: message for message in host.messages(MS)}
    frames = host.encode(Command(0, [0.0, 0.0], 0b11, False))
    for frame in [*frames, *(device.encode_feedback(Sample(axis, 0, 0, -1, 0)) for axis in (0, 1))]:
        assert announced[frame.can_id].length == len(frame.data)
        assert announced[frame.can_id].fd
    assert len(announced) == 4
    assert analyse(host.messages(MS), 1_000_000, 5_000_000).schedulable
