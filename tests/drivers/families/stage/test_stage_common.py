"""What stage_fd and stage_classic share: which rigs they carry, what they say of themselves, and their traffic."""

import math
from typing import Any

import pytest
from pydantic import ValidationError

from drivers.config import BusConfig
from drivers.families import layouts, sides_of
from drivers.families.stage.common import cut
from drivers.frame import EXTENDED, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import EVERY_STATUS, OF_DRIVES, Command, Message, Reject, Sample
from tests.support.paths import RIGS

LAYOUTS = [  # sequence_modulus, wrap of the time stamp, bytes of the command, of an answer
    ("stage_fd", True, 1 << 16, 1 << 32, 24, 16, EVERY_STATUS),
    ("stage_classic", False, 32, 4_096_000, 8, 8, OF_DRIVES),
]
each_layout = pytest.mark.parametrize("protocol", [name for name, *_ in LAYOUTS])


def host(protocol: str, n_axes: int = 2, **bus: Any) -> Any:
    return host_protocol(BusConfig(protocol=protocol, **bus), n_axes, [1.0] * n_axes, RIGS)


def why_not(protocol: str, n_axes: int, rated: list[float], **bus: Any) -> str:
    """What a rig is refused with, on either side; empty: it is carried."""
    said = []
    for side in (host_protocol, device_protocol):
        try:
            side(BusConfig(protocol=protocol, **bus), n_axes, rated, RIGS)
            said.append("")
        except LayoutError as error:
            said.append(str(error))
    assert said[0] == said[1]
    return said[0]


@each_layout
def test_one_to_four_axes_are_carried(protocol: str) -> None:
    assert [why_not(protocol, n, [1.0] * n) for n in range(1, 5)] == [""] * 4
    for n in (0, 5):
        assert why_not(protocol, n, [1.0] * n) == f"{n} axes: the stage layouts carry 1 to 4"


@each_layout
def test_every_axis_has_a_rated_force_that_makes_sense(protocol: str) -> None:
    assert why_not(protocol, 2, [1.0]) == "1 rated forces for 2 axes"
    assert why_not(protocol, 1, [1.0, 1.0]) == "2 rated forces for 1 axes"
    assert why_not(protocol, 2, [1.0, 5e-324]) == ""
    for wrong in (0.0, -1.0, math.inf, math.nan):
        for rated in ([wrong, 1.0], [1.0, wrong]):
            assert why_not(protocol, 2, rated) == f"rated forces {rated}: each must be finite and above zero"


@each_layout
def test_the_command_has_no_answers_identifier(protocol: str) -> None:
    taken = [why_not(protocol, 3, [1.0] * 3, feedback_id=0x100, host_id=can_id) for can_id in range(0xFF, 0x104)]
    assert [bool(said) for said in taken] == [False, True, True, True, False]
    assert taken[1] == "bus.host_id = 0x100 is one of the feedback identifiers 0x100 to 0x102"


def test_identifiers_are_standard_ones_with_room_for_every_axis() -> None:
    assert (BusConfig().host_id, BusConfig().feedback_id) == (0x080, 0x100)  # type: ignore[attr-defined]
    for name, most in (("host_id", 0x7FF), ("feedback_id", 0x7F0)):
        for value in (0, most):
            assert getattr(BusConfig(**{name: value}), name) == value  # type: ignore[arg-type]
        for value in (-1, most + 1):
            with pytest.raises(ValidationError, match=name):
                BusConfig(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "fd", "modulus", "wrap", "command", "answer", "tells"), LAYOUTS)
def test_a_layout_says_what_it_carries(
    name: str, fd: bool, modulus: int, wrap: int, command: int, answer: int, tells: int
) -> None:
    layout = host(name, 3)
    assert (layout.name, layout.fd, layout.sequence_modulus, layout.tells) == (name, fd, modulus, tells)
    assert all(said is True for said in (layout.checksum, layout.states, layout.causes, layout.resets))
    assert (layout.n_axes, list(layout.problems), layout.echo_id, list(layout.acts_ns)) == (3, [], None, [])
    assert (layout.stamp_wraps_ns, layout.state_ns) == ([wrap] * 3, 0)
    assert layout.positions == [(-(2**31), 2**31 - 1)] * 3


@pytest.mark.parametrize(("name", "fd", "modulus", "wrap", "command", "answer", "tells"), LAYOUTS)
def test_each_drive_answers_the_one_command_within_the_period(
    name: str, fd: bool, modulus: int, wrap: int, command: int, answer: int, tells: int
) -> None:
    period = 400_000
    answers = [
        Message(f"feedback {k}", 0x300 + k, answer, fd, period, period, 0, f"axis {k}", "command") for k in range(3)
    ]
    told = host(name, 3, feedback_id=0x300, host_id=0x70).messages(period)
    assert told == [Message("command", 0x70, command, fd, period, period, 0, "host"), *answers]


def test_a_segment_has_the_answers_of_its_own_axes() -> None:
    own = cut(BusConfig(feedback_id=0x300), 4)  # type: ignore[call-arg]
    assert [own(axes) for axes in (range(4), range(1, 3), range(3, 4))] == [
        {"feedback_id": 0x300},
        {"feedback_id": 0x301},
        {"feedback_id": 0x303},
    ]


def test_a_rig_that_names_no_layout_gets_stage_fd_which_alone_of_the_two_is_plain() -> None:
    assert next(iter(layouts())) == "stage_fd" == BusConfig().protocol
    assert [sides_of(name).plain for name, *_ in LAYOUTS] == [True, False]  # type: ignore[union-attr]


@each_layout
def test_an_answer_beside_the_axes_identifiers_is_nobodys_however_sound(protocol: str) -> None:
    """Its drives are those of another rig, whose identifiers begin one lower, and go one further."""
    own, others = host(protocol, 2), device_protocol(BusConfig(protocol=protocol, feedback_id=0xFF), 4, [1.0] * 4, RIGS)  # type: ignore[call-arg]
    heard = [own.decode(others.encode_feedback(Sample(axis, 5, 0, 3, 9))) for axis in range(4)]
    assert [one.axis if isinstance(one, Sample) else one for one in heard] == [
        Reject.UNKNOWN_ID,
        0,
        1,
        Reject.UNKNOWN_ID,
    ]
    for can_id, why in ((0x100, Reject.WRONG_FORMAT), (0x101, Reject.WRONG_FORMAT), (0x102, Reject.UNKNOWN_ID)):
        assert own.decode(Frame(EXTENDED | can_id, bytes(8))) is why, "where ours is meant, its format is told"


def test_forces_of_too_few_or_too_many_axes_are_never_sent() -> None:
    layout = host("stage_fd", 3)
    for count in (0, 2, 4, 5):
        with pytest.raises(ValueError, match=f"^{count} forces for 3 axes"):
            layout.encode(Command(0, [0.0] * count, 0, False))


@each_layout
def test_a_drive_knows_its_command_by_its_identifier_and_no_frame_for_its_own(protocol: str) -> None:
    device = device_protocol(BusConfig(protocol=protocol), 2, [1.0, 1.0], RIGS)
    for can_id in (0, 1, 0x07F, 0x081, 0x100):
        assert device.decode_command(Frame(can_id, bytes(24))) is Reject.UNKNOWN_ID


def test_of_no_frames_no_answer_is_read_at_once() -> None:
    assert host("stage_fd").answers([]) == b""
