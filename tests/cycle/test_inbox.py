"""From frames to at most one trusted sample per axis and tick."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.frame import ECHO, Frame, on_segment
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command, Reject, Sample
from hil.cycle.inbox import Inbox
from hil.rig.file import load_rig
from hil.rig.layout import host_layout
from tests.support.paths import RIGS
from tests.support.two_segments import TWO_PAIRS

BUS = BusConfig()
HERE = Path()
DEVICE = device_protocol(BUS, 2, [5.0, 5.0], HERE)


def answer(axis: int, sequence: int, position: int = 100) -> Frame:
    frame = DEVICE.encode_feedback(Sample(axis, position, 0, sequence % 65536, 1_000))
    return frame._replace(timestamp_ns=1_000)


def make_inbox() -> Inbox:
    return Inbox(host_protocol(BUS, 2, [5.0, 5.0], HERE), leak_ticks=100)


def test_a_new_inbox_has_heard_nothing_and_accuses_nobody() -> None:
    inbox = make_inbox()
    assert (inbox.samples, inbox.fresh, inbox.heard) == ([None] * 2, [False] * 2, [False] * 2)
    assert (inbox.received_ns, inbox.age) == ([0, 0], [0, 0])
    assert (inbox.suspect_axis, inbox.foreign_id, inbox.differ_axis) == (-1, -1, -1)
    assert (inbox.bad_frames, inbox.late, inbox.lost, inbox.useless_now) == (0, 0, 0, 0)
    assert inbox.rejects == [0] * len(Reject)


def test_answers_to_the_latest_command_are_fresh_and_have_age_zero() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5, 11), answer(1, 5, 22)], sent_sequence=5)
    assert inbox.fresh == [True, True]
    assert inbox.age == [0, 0]
    assert [sample.position for sample in inbox.samples if sample] == [11, 22]


@pytest.mark.requirement(id="SR-3.1")
def test_a_missing_answer_makes_the_axis_older_and_counts_as_lost() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5), answer(1, 5)], 5)
    inbox.collect([answer(0, 6)], 6)
    assert inbox.fresh == [True, False]
    assert inbox.age == [0, 1]
    assert inbox.lost == 1


def test_before_the_first_command_nothing_is_missing() -> None:
    inbox = make_inbox()
    inbox.collect([], -1)
    assert inbox.age == [0, 0]
    inbox.collect([], 0)
    assert inbox.age == [1, 1]


@pytest.mark.requirement(id="SR-3.2")
def test_an_answer_to_a_command_never_sent_is_refused() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5)], -1)
    inbox.collect([answer(0, 9)], 5)
    assert inbox.rejects[Reject.STALE] == 2
    assert inbox.samples == [None, None]


def test_a_duplicate_is_discarded_and_suspicious() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5), answer(0, 5)], 5)
    assert inbox.rejects[Reject.DUPLICATE] == 1
    assert inbox.bad_frames == 1
    assert inbox.fresh[0]


def test_suspicious_answers_name_their_axis_where_all_of_them_were_one_axis() -> None:
    inbox = make_inbox()
    inbox.collect([answer(1, 5), answer(1, 5), answer(1, 4)], 5)
    assert inbox.suspect_axis == 1
    inbox.collect([answer(0, 6), answer(0, 6)], 6)
    assert inbox.suspect_axis == -1
    inbox.forget()
    damaged = answer(0, 0)._replace(data=bytes(16))
    inbox.collect([damaged, answer(1, 7), answer(1, 7)], 7)
    assert inbox.suspect_axis == -1, "whose the damaged one was, nobody knows"


def test_four_drives_that_boot_together_beside_our_own_sync_are_no_flood_and_one_that_goes_on_booting_is() -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml", ("bus.protocol=cia402",))
    inbox = Inbox(host_layout(rig, RIGS), leak_ticks=100)
    sync = Frame(0x80, b"\x02", ECHO)
    booting = [Frame(base + node, data) for node in (1, 2, 3, 4) for base, data in ((0x580, bytes(8)), (0x700, b"\0"))]
    inbox.collect([sync, sync, *booting], sent_sequence=-1)
    assert inbox.useless_now == 0
    inbox.collect([*booting, *[Frame(0x701, b"\0")] * 12], sent_sequence=-1)
    assert inbox.useless_now == 12


def test_a_reordered_older_answer_never_replaces_a_newer_one() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5, 55), answer(0, 4, 44)], 5)
    assert inbox.samples[0] is not None
    assert inbox.samples[0].position == 55
    assert inbox.rejects[Reject.STALE] == 1


def test_a_late_but_newer_answer_is_not_suspicious_and_not_fresh() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5), answer(1, 5)], 5)
    inbox.collect([answer(0, 6)], 7)
    assert inbox.fresh == [False, False]
    assert inbox.late == 1
    assert inbox.bad_frames == 0


def test_sequence_numbers_wrap_around() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 65535)], 65535)
    inbox.collect([answer(0, 65536)], 65536)
    assert inbox.fresh[0]
    assert sum(inbox.rejects) == 0


@pytest.mark.requirement(id="SR-3.2")
def test_the_leaky_bucket_forgives_one_bad_frame_per_hundred_ticks() -> None:
    inbox = make_inbox()
    damaged = answer(0, 0)._replace(data=bytes(16))
    inbox.collect([damaged] * 3, 0)
    assert inbox.bad_frames == 3
    for _ in range(100):
        inbox.collect([], 0)
    assert inbox.bad_frames == 2


def test_what_a_checksum_has_passed_is_never_forgiven_until_a_reset() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5)], 5)
    inbox.collect([answer(0, 6), answer(0, 4)], 6)
    for _ in range(200):
        inbox.collect([], 6)
    assert inbox.bad_frames == 1
    inbox.forget()
    inbox.collect([answer(0, 0)._replace(data=bytes(16))], 5)
    for _ in range(100):
        inbox.collect([], 5)
    assert inbox.bad_frames == 0, "noise behind the reset is forgiven again"


def test_a_repeated_answer_is_a_duplicate_whether_or_not_another_axis_has_answered() -> None:
    inbox = make_inbox()
    inbox.collect([answer(1, 5), answer(1, 5)], 5)
    assert inbox.rejects[Reject.DUPLICATE] == 1


def test_an_answer_has_the_time_at_which_it_came() -> None:
    inbox = make_inbox()
    inbox.collect([answer(0, 5)._replace(timestamp_ns=700), answer(1, 5)._replace(timestamp_ns=900)], 5)
    assert inbox.received_ns == [700, 900]


@pytest.mark.requirement(id="SR-3.2")
def test_a_command_of_ours_from_another_node_is_told_in_its_tick_alone() -> None:
    inbox = make_inbox()
    (command,) = host_protocol(BUS, 2, [5.0, 5.0], HERE).encode(Command(5, [0.0, 0.0], 0, False))
    inbox.collect([command], 5)
    assert inbox.foreign_id == command.can_id
    inbox.collect([], 6)
    assert inbox.foreign_id == -1
    inbox.collect([command._replace(flags=command.flags | ECHO)], 7)
    assert inbox.foreign_id == -1, "our own, as the kernel shows it"


@pytest.mark.requirement(id="SR-3.2")
def test_an_identifier_is_ours_on_its_segment_alone() -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml", ("bus.protocol=cia402", *TWO_PAIRS))
    inbox = Inbox(host_layout(rig, RIGS), leak_ticks=100)
    for segment, can_id, foreign in ((0, 0x201, 0x201), (1, 0x201, -1), (0, 0x203, -1), (1, 0x203, 0x203)):
        inbox.collect([on_segment(Frame(can_id, bytes(8)), segment)], sent_sequence=5)
        assert inbox.foreign_id == foreign, (segment, hex(can_id))


@pytest.mark.requirement(id="SR-3.2")
@given(st.binary(max_size=64), st.integers(0, 0x7FF), st.integers(0, 7))
def test_no_bytes_whatever_become_a_sample_without_their_checksum(data: bytes, can_id: int, flags: int) -> None:
    inbox = make_inbox()
    inbox.collect([Frame(can_id, data, flags, 1)], 0)
    assert inbox.samples == [None, None] or sum(inbox.rejects) == 0
    assert sum(inbox.rejects) + sum(inbox.fresh) == 1
