"""What a side of a user's layout may say of itself and return: both ends of every range are taken, and no step more."""

from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig, Wiring
from drivers.frame import FD, Frame
from drivers.protocols.base import EVERY_STATUS, Command, LayoutError, Reject, Sample
from drivers.protocols.user_sides import Maker, UserDrives, UserHost

INT32_MAX = 2**31 - 1
SAYS = """
from hil import DriveSide, FrameLayout, HostSide, Message

class Says(FrameLayout):
    def host(self):
        return Host()
    def drives(self):
        return Drives()

class Host(HostSide):
    said, message = None, {{}}
    {host}
    def encode(self, command):
        return self.said
    def decode(self, frame):
        return self.said
    def messages(self, period_ns):
        fields = dict(name="a", can_id=0x10, length=8, fd=False, period_ns=5, deadline_ns=5, jitter_ns=0, sender="host")
        return [Message(**fields)._replace(**self.message)]

class Drives(DriveSide):
    said = None
    {drives}
    def decode_command(self, frame):
        return self.said
    def encode_feedback(self, sample):
        return self.said
"""
FRAME = Frame(0x20, b"", 0, 1000)


def sides(host: str = "pass", drives: str = "pass") -> tuple[UserHost, UserDrives]:
    bus = BusConfig(protocol="./says.py:Says", source=SAYS.format(host=host, drives=drives))
    return Maker(Wiring(bus, 2, [5.0, 2.0], 1_000_000, Path())).sides()


HOST_RANGES = [
    ("sequence_modulus", [0, 2**62], [-1, 2**62 + 1]),
    ("state_ns", [0, 2**62], [-1, 2**62 + 1]),
    ("echo_id", [None, 0, 2**32 - 1], [-1, 2**32]),
    ("acts_ns", [[], [0, 10**9]], [[0], [-1, 0], [0, 10**9 + 1], 5]),
    ("positions", [[(-(2.0**53), 2.0**53), (0, 1)]], [[(0, 2**53 + 2), (0, 1)], [(1, 1), (0, 1)], [(0, 1)]]),
]


@pytest.mark.parametrize(("name", "good", "bad"), HOST_RANGES, ids=[name for name, _, _ in HOST_RANGES])
def test_a_host_says_of_itself_what_is_in_range(name: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        host, _ = sides(f"{name} = {value!r}")
        assert getattr(host, name) == value
    for value in bad:
        with pytest.raises(LayoutError, match=f"{name} = "):
            sides(f"{name} = {value!r}")


def test_a_resolution_of_torques_is_a_share_of_the_rated_one() -> None:
    assert [sides(drives=f"force_resolution = {share}")[1].force_resolution for share in (0.0, 1.0)] == [0.0, 1.0]
    for share in (-1e-9, 1.0 + 1e-9):
        with pytest.raises(LayoutError, match="force_resolution = "):
            sides(drives=f"force_resolution = {share}")


@pytest.mark.parametrize("field", ["can_id", "length", "period_ns", "deadline_ns", "jitter_ns"])
def test_a_message_has_no_negative_number_and_a_period(field: str) -> None:
    least = int(field == "period_ns")
    sides(f"message = {{{field!r}: {least}}}")
    with pytest.raises(LayoutError, match=r"host\(\)\.messages: Message"):
        sides(f"message = {{{field!r}: {least - 1}}}")


@pytest.mark.parametrize(("modulus", "sequences", "wrong"), [(0, (-1,), (-2, 0, 1)), (8, (0, 7), (-1, 8))])
def test_a_sample_has_a_sequence_number_of_its_layouts(
    modulus: int, sequences: tuple[int, ...], wrong: tuple[int, ...]
) -> None:
    host, _ = sides(f"sequence_modulus = {modulus}")
    for sequence in (*sequences, *wrong):
        host._side.said = Sample(0, 0, 0, sequence, 5)
        assert (host.decode(FRAME) == host._side.said) is (sequence in sequences)


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        ("axis", (0, 1), (-1, 2)),
        ("position", (-INT32_MAX - 1, INT32_MAX), (-INT32_MAX - 2, INT32_MAX + 1)),
        ("status", (0, EVERY_STATUS), (-1, EVERY_STATUS + 1)),
        ("stamp_ns", (0, 2**62), (-2, 2**62 + 1)),
    ],
)
def test_a_sample_is_taken_within_its_ranges(field: str, good: tuple[int, ...], bad: tuple[int, ...]) -> None:
    host, _ = sides()
    for value in (*good, *bad):
        host._side.said = Sample(
            **{"axis": 1, "position": 3, "status": 0, "sequence": -1, "stamp_ns": 5} | {field: value}
        )
        assert host.decode(FRAME) == (host._side.said if value in good else Reject.INVALID_VALUE)


def test_a_refusal_is_handed_on_as_it_is() -> None:
    host, drives = sides()
    for reason in Reject:
        host._side.said = drives._side.said = reason
        assert host.decode(FRAME) is drives.decode_command(FRAME) is reason


def test_a_command_is_one_for_all_axes() -> None:
    _, drives = sides()
    for enable, taken in ((0, True), (0b11, True), (-1, False), (0b100, False)):
        drives._side.said = Command(7, [0.5, -0.5], enable, False)
        if taken:
            assert drives.decode_command(FRAME) == drives._side.said
        else:
            with pytest.raises(LayoutError, match="which is none for 2 axes"):
                drives.decode_command(FRAME)


def test_a_frame_is_one_that_a_bus_can_carry() -> None:
    _, drives = sides()
    good = [Frame(0, b""), Frame(2**32 - 1, bytes(8)), Frame(1, b"", 0x7F), Frame(1, bytes(64), FD)]
    bad = [Frame(-1, b""), Frame(2**32, b""), Frame(1, bytes(9)), Frame(1, b"", 0x80), Frame(1, b"", -1)]
    bad += [Frame(1, bytes(9), FD), Frame(1, bytes(65), FD)]
    sample = Sample(0, 0, 0, -1, 0)
    for frame in good:
        drives._side.said = frame
        assert drives.frames_of(sample) == [frame]
    for frame in bad:
        drives._side.said = frame
        with pytest.raises(LayoutError, match=r"encode_feedback: \./says\.py"):
            drives.frames_of(sample)
