"""The emulated drives of the stage layouts, written from the contract, against the layouts' own drives' side: the same
of every frame, and the same answer byte for byte.
"""

import math
import struct
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import EVERY_STATUS, Command, LayoutError, Reject, Sample
from drivers.protocols.checksum import IdentifiedCrc8
from sim_plant.drives.sides import drives_side

RATED = [3.0, 0.1, 70.0]
LAYOUTS = ("stage_fd", "stage_classic")
SEGMENTS = [{"channel": "can0", "axes": ["x"]}, {"channel": "can1", "axes": ["y", "z"]}]
forces = st.tuples(*(st.floats(-rated, rated) for rated in RATED)).map(list)
numbers = st.one_of(st.sampled_from([0.0, 3.0, 0.1, math.nan, math.inf, -math.inf]), st.floats(-4.0, 4.0, width=32))
fields = st.builds(
    lambda force, rest: struct.pack("<4f2H", *force, *rest),
    st.tuples(*[numbers] * 4), st.tuples(st.integers(0, 65535), st.integers(0, 32)),
)  # fmt: skip
commands = st.builds(Command, st.integers(0, 70_000), forces, st.integers(0, 7), st.booleans())


def sides(layout: str, n_axes: int = 3) -> tuple[Any, Any, Any]:
    """Host, the layout's drives, the emulated ones."""
    bus = BusConfig.model_validate({"protocol": layout, "host_id": 0x120, "feedback_id": 0x340})
    rated = RATED[:n_axes]
    return (
        host_protocol(bus, n_axes, rated, Path()),
        device_protocol(bus, n_axes, rated, Path()),
        drives_side(bus, n_axes, rated, Path()),
    )


def as_told(outcome: Command | Reject) -> Any:
    return outcome if isinstance(outcome, Reject) else (*outcome,)


@pytest.mark.parametrize("layout", LAYOUTS)
@given(command=commands)
def test_a_command_of_the_host_is_heard_alike(layout: str, command: Command) -> None:
    host, told, emulated = sides(layout)
    (frame,) = host.encode(command)
    heard = emulated.decode_command(frame)
    assert isinstance(heard, Command)
    assert as_told(heard) == as_told(told.decode_command(frame))
    assert heard.enable == command.enable
    assert heard.sequence == command.sequence % emulated.sequence_modulus


@pytest.mark.long
@pytest.mark.parametrize("layout", LAYOUTS)
@given(
    command=commands, flip=st.integers(0, 191), flags=st.sampled_from([0, FD]), cut=st.integers(0, 25),
    can_id=st.sampled_from([0x120, 0x121, 0x340, ERROR | 4, EXTENDED | 0x120, REMOTE | 0x120]), whole=st.booleans(),
)  # fmt: skip
def test_so_is_whatever_has_become_of_it(
    layout: str, command: Command, flip: int, flags: int, cut: int, can_id: int, whole: bool
) -> None:
    host, told, emulated = sides(layout)
    (frame,) = host.encode(command)
    data = bytearray(frame.data)
    data[flip // 8 % len(data)] ^= 1 << flip % 8
    changed = [Frame(0x120, bytes(data), frame.flags), Frame(can_id, frame.data if whole else bytes(data), flags)]
    changed.append(Frame(0x120, frame.data[:cut], frame.flags))
    for one in changed:
        assert as_told(emulated.decode_command(one)) == as_told(told.decode_command(one))
    assert emulated.decode_command(changed[0]) is Reject.BAD_CHECKSUM


@given(body=st.one_of(st.binary(min_size=20, max_size=20), fields))
def test_any_whole_frame_of_stage_fd_is_obeyed_or_refused_alike(body: bytes) -> None:
    _, told, emulated = sides("stage_fd")
    frame = Frame(0x120, body + crc32(body, 0x120).to_bytes(4, "little"), FD)
    assert as_told(emulated.decode_command(frame)) == as_told(told.decode_command(frame))


@pytest.mark.long
@given(body=st.binary(min_size=7, max_size=7), spare=st.booleans())
def test_any_whole_frame_of_stage_classic_is_obeyed_or_refused_alike(body: bytes, spare: bool) -> None:
    _, told, emulated = sides("stage_classic")
    if not spare:  # mostly two bits that have to be zero, and an axis that is not there
        body = (int.from_bytes(body, "little") & 0x3F_000F_FFFF_FFFF | 0x800 << 36).to_bytes(7, "little")
    frame = Frame(0x120, body + bytes([IdentifiedCrc8([0x120])(0x120, body + bytes(1))]), 0)
    outcome = emulated.decode_command(frame)
    assert as_told(outcome) == as_told(told.decode_command(frame))
    assert spare or isinstance(outcome, Command)


@pytest.mark.parametrize("layout", LAYOUTS)
@given(
    axis=st.integers(0, 2), position=st.integers(-(2**40), 2**40), status=st.integers(0, EVERY_STATUS),
    sequence=st.integers(0, 2**20), stamp_ns=st.integers(0, 2**50),
)  # fmt: skip
def test_an_answer_is_the_same_bytes(
    layout: str, axis: int, position: int, status: int, sequence: int, stamp_ns: int
) -> None:
    _, told, emulated = sides(layout)
    sample = Sample(axis, position, status, sequence, stamp_ns)
    assert emulated.encode_feedback(sample) == told.encode_feedback(sample)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_on_segments_each_part_hears_its_own(layout: str) -> None:
    bus = BusConfig.model_validate({"protocol": layout, "segments": SEGMENTS})
    host, emulated = host_protocol(bus, 3, RATED, Path()), drives_side(bus, 3, RATED, Path())
    heard = [emulated.decode_command(frame) for frame in host.encode(Command(1, [0.5, 0.05, -7.0], 0b101, True))]
    assert heard[0] is Reject.SERVICE
    assert isinstance(heard[1], Command)
    expected = [0.5, 0.05 if layout == "stage_fd" else 0.0, -7.0]
    for force, asked, rated in zip(heard[1].force, expected, RATED, strict=True):
        assert force == pytest.approx(asked, abs=rated / 2047)
    assert heard[1].enable == 0b101


@pytest.mark.parametrize("layout", LAYOUTS)
def test_more_axes_than_a_frame_carries_are_refused(layout: str) -> None:
    with pytest.raises(LayoutError, match="5 axes: the stage layouts carry 1 to 4"):
        drives_side(BusConfig.model_validate({"protocol": layout}), 5, [1.0] * 5, Path())
