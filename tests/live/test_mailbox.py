"""The mailbox: commands arrive once, in order; damage is counted and never raises in the control process."""

import mmap
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.cycle.record import MAX_COMMANDS
from hil.cycle.tick import CommandKind, OperatorCommand
from hil.live.mailbox import SIZE, SLOTS, Mailbox, MailboxError


@pytest.fixture
def box(tmp_path: Path) -> Iterator[Mailbox]:
    with Mailbox.create(tmp_path / "mailbox") as box:
        yield box


def test_an_empty_mailbox_holds_no_command(box: Mailbox) -> None:
    assert box.poll() == ()


def test_commands_arrive_once_in_order_with_rising_sequence(box: Mailbox) -> None:
    with Mailbox(box.path) as sender:
        assert sender.post(CommandKind.RESET, 10) == 1
        assert sender.post(CommandKind.ACTIVATE, -5) == 2
    assert box.poll() == (OperatorCommand(CommandKind.RESET, 1, 10), OperatorCommand(CommandKind.ACTIVATE, 2, -5))
    assert box.poll() == ()


def test_two_senders_share_one_sequence(box: Mailbox) -> None:
    with Mailbox(box.path) as one, Mailbox(box.path) as two:
        sequences = [sender.post(CommandKind.HEARTBEAT, 0) for sender in (one, two, two, one)]
    assert sequences == [1, 2, 3, 4]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.one_of(st.sampled_from(list(CommandKind)), st.none()), max_size=200))
def test_any_interleaving_of_posts_and_polls_delivers_everything(
    tmp_path_factory: pytest.TempPathFactory, steps: list[CommandKind | None]
) -> None:
    box = Mailbox.create(tmp_path_factory.mktemp("box") / "mailbox")
    sent: list[CommandKind] = []
    got: list[OperatorCommand] = []
    for step in steps:
        if step is None:
            mail = box.poll()
            assert len(mail) <= MAX_COMMANDS
            got += mail
        elif len(sent) - len(got) < SLOTS:
            box.post(step, len(sent))
            sent.append(step)
    while mail := box.poll():
        got += mail
    assert got == [OperatorCommand(kind, index + 1, index) for index, kind in enumerate(sent)]
    box.close()


def test_what_became_of_a_tasks_file_is_known_once_it_is_answered_and_of_no_other(box: Mailbox) -> None:
    with Mailbox(box.path) as sender:
        assert box.task_posted == 0
        for number, ready in ((1, True), (2, False), (3, True), (4, False)):
            sender.post_task(number)
            assert box.task_posted == number
            assert sender.task_ready(number) is None
            box.answer_task(number, ready=ready)
            assert sender.task_ready(number) is ready
            assert sender.task_ready(number + 1) is None


def test_what_is_left_in_a_mailbox_by_either_end_does_not_touch_anything_else_in_it(box: Mailbox) -> None:
    with Mailbox(box.path) as sender:
        sender.beat_recorder(7)
        sender.post_task(3)
        assert [sender.post(CommandKind.STOP, 5), sender.post(CommandKind.RESET, 6)] == [1, 2]
        box.answer_task(2, ready=True)
        box.answer_task(3, ready=False)
        assert [command.expires_ns for command in box.poll()] == [5, 6]
        assert (box.task_posted, box.damaged, box.recorder_ok(7), box.recorder_ok(6)) == (3, 0, True, False)
        assert [sender.task_ready(number) for number in (1, 2, 3, 4)] == [None, True, False, None]
        assert [sender.post(CommandKind.STOP, 8), sender.damaged] == [3, 0]
    with Mailbox(box.path) as late:
        assert [command.sequence for command in late.poll()] == [3]


def test_a_mailbox_makes_its_folder_for_its_user_alone_and_closing_leaves_nothing_open(tmp_path: Path) -> None:
    made = Mailbox.create(tmp_path / "run" / "rig" / "mailbox")
    assert made.path.parent.stat().st_mode & 0o777 == 0o700
    descriptor, mapped = made._fd, made._map
    for _ in range(2):
        made.close()
        assert mapped.closed
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)


def test_a_full_mailbox_refuses_and_keeps_what_it_has(box: Mailbox) -> None:
    for _ in range(SLOTS):
        box.post(CommandKind.STOP, 0)
    with pytest.raises(MailboxError, match="does not take them"):
        box.post(CommandKind.ESTOP, 0)
    assert [command.sequence for command in box.poll()] == [1, 2, 3, 4]


@pytest.mark.parametrize("position", range(28))
def test_a_command_with_one_damaged_byte_is_dropped_and_counted(box: Mailbox, position: int) -> None:
    box.post(CommandKind.ACTIVATE, 1_000)
    box.post(CommandKind.STOP, 1_000)
    with open(box.path, "r+b") as file, mmap.mmap(file.fileno(), SIZE) as raw:
        raw[256 + position] ^= 0x10
    assert [command.kind for command in box.poll()] == [CommandKind.STOP]
    assert box.damaged == 1


@pytest.mark.requirement(id="SR-7.2")
@settings(max_examples=200, deadline=None)
@given(noise=st.lists(st.tuples(st.integers(8, SIZE - 1), st.binary(min_size=1, max_size=16)), min_size=1, max_size=8))
def test_no_content_of_the_file_can_raise_in_the_control_process(
    tmp_path_factory: pytest.TempPathFactory, noise: list[tuple[int, bytes]]
) -> None:
    box = Mailbox.create(tmp_path_factory.mktemp("box") / "mailbox")
    box.post(CommandKind.ACTIVATE, 0)
    with open(box.path, "r+b") as file, mmap.mmap(file.fileno(), SIZE) as raw:
        for offset, data in noise:
            end = min(offset + len(data), SIZE)
            raw[offset:end] = data[: end - offset]
    for _ in range(3):
        for command in box.poll():
            assert command.kind in CommandKind
        box.recorder_ok(1)
    box.close()


def test_after_damage_to_the_counts_later_commands_arrive_again(box: Mailbox) -> None:
    with open(box.path, "r+b") as file, mmap.mmap(file.fileno(), SIZE) as raw:
        raw[64:72] = (1 << 40).to_bytes(8, "little")
    assert box.poll() == ()
    assert box.damaged == 1
    with Mailbox(box.path) as sender:
        sequence = sender.post(CommandKind.STOP, 7)
    assert box.poll() == (OperatorCommand(CommandKind.STOP, sequence, 7),)


def test_a_new_mailbox_forgets_commands_meant_for_a_dead_process(box: Mailbox) -> None:
    box.post(CommandKind.ACTIVATE, 0)
    fresh = Mailbox.create(box.path)
    assert fresh.poll() == ()
    assert box.replaced
    assert not fresh.replaced


def test_the_recorder_counts_as_alive_for_one_second(box: Mailbox) -> None:
    now = 5_000_000_000
    assert not box.recorder_ok(now)
    box.beat_recorder(now)
    assert box.recorder_ok(now)
    assert box.recorder_ok(now + 999_999_999)
    assert not box.recorder_ok(now + 1_000_000_000)
    assert not box.recorder_ok(now - 1)


@pytest.mark.parametrize("content", [b"", b"\0" * SIZE, b"noise" * 20], ids=["empty", "zeros", "noise"])
def test_a_file_that_is_no_mailbox_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "mailbox").write_bytes(content)
    with pytest.raises(MailboxError, match="not a mailbox"):
        Mailbox(tmp_path / "mailbox")


def test_a_missing_mailbox_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(MailboxError, match="No such file"):
        Mailbox(tmp_path / "mailbox")
