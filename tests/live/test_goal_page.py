"""The goal page: goals arrive once, in order, of one client; whatever its bytes, nothing in it raises."""

import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.cycle.goal import Goal, GoalKind, Refusal
from hil.live import goal_page
from hil.live.goal_page import FIRST_SLOT, GOAL_LIFE_NS, LEASE_NS, MOST_A_TICK, SIZE, SLOT_SIZE, GoalPage, GoalPageError

MOVE = Goal(
    7, GoalKind.MOVE, 0b11, 1, 5, -6, (1e-3, -2e-3, 0.25, float("inf")), (0.5, -0.0, 3.0, 4.0), 0.5
)  # fmt: skip


@pytest.fixture
def page(tmp_path: Path) -> Iterator[GoalPage]:
    with GoalPage.create(tmp_path / "goals") as page:
        yield page


def test_an_empty_page_holds_no_goal_and_is_private(page: GoalPage) -> None:
    assert page.poll(time.monotonic_ns()) == ()
    assert os.stat(page.path).st_mode & 0o777 == 0o600


def test_a_goal_arrives_once_and_whole(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        lease = client.take_lease()
        assert (lease.uid, lease.pid) == (os.getuid(), os.getpid())
        number = client.post(MOVE)
    assert page.poll(time.monotonic_ns()) == (MOVE._replace(number=number, lease=lease.number),)
    assert page.poll(time.monotonic_ns()) == ()


@pytest.mark.requirement(id="SR-5.3")
def test_one_client_holds_the_lease_and_another_may_take_it_by_force(page: GoalPage) -> None:
    with GoalPage(page.path) as one, GoalPage(page.path) as two:
        with pytest.raises(GoalPageError, match="lease has ended"):
            one.post(MOVE)
        one.take_lease()
        with pytest.raises(GoalPageError, match=f"process {os.getpid()} of user"):
            two.take_lease()
        one.post(MOVE)
        two.take_lease(by_force=True)
        with pytest.raises(GoalPageError, match="lease has ended"):
            one.post(MOVE)
        two.post(MOVE)
        one.give_back()  # no longer its own to give
        assert page.holder() is not None
        two.give_back()
        assert page.holder() is None
        one.take_lease()
    assert page.counts["foreign"] == 0
    page.poll(time.monotonic_ns())
    assert page.counts["foreign"] == 2  # of both ended leases


def test_a_lease_ends_by_itself_and_a_heartbeat_keeps_it(page: GoalPage, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10**12]
    monkeypatch.setattr(goal_page.time, "monotonic_ns", lambda: now[0])
    with GoalPage(page.path) as client:
        client.take_lease()
        for _ in range(3):
            now[0] += LEASE_NS
            client.beat()
        now[0] += LEASE_NS + 1
        assert page.holder() is None
        with pytest.raises(GoalPageError, match="lease has ended"):
            client.beat()


def test_of_a_flood_the_newest_arrive(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        client.take_lease()
        numbers = [client.post(MOVE) for _ in range(1_000)]
    assert [goal.number for goal in page.poll(time.monotonic_ns())] == numbers[-MOST_A_TICK:]
    assert page.counts == {"damaged": 0, "passed": 1_000 - MOST_A_TICK, "foreign": 0, "stale": 0}


def test_a_damaged_slot_is_dropped_and_counted(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        client.take_lease()
        client.post(MOVE)
        client.post(MOVE)
    with page.path.open("r+b") as file:
        file.seek(FIRST_SLOT + SLOT_SIZE + 40)
        byte = file.read(1)[0]
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([byte ^ 0x10]))
    assert len(page.poll(time.monotonic_ns())) == 1
    assert page.counts["damaged"] == 1


@pytest.mark.requirement(id="SR-7.2")
def test_no_bytes_raise_in_the_control_process(page: GoalPage) -> None:
    draw = np.random.default_rng(3)
    for _ in range(200):
        with page.path.open("r+b") as file:
            file.write(draw.bytes(SIZE))
            if draw.integers(2):
                file.seek(8 * 8)
                file.write(struct.pack("<Q", int(draw.integers(0, 1 << 63))))
        assert page.poll(time.monotonic_ns()) == ()
        page.mend()
    with GoalPage(page.path):
        pass


def test_what_is_no_page_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(GoalPageError, match="No such file"):
        GoalPage(tmp_path / "none")
    (tmp_path / "short").write_bytes(b"short")
    (tmp_path / "short").chmod(0o600)
    with pytest.raises(GoalPageError, match="not a goal page"):
        GoalPage(tmp_path / "short")


def test_each_goal_has_a_verdict_once_the_cycle_has_made_one(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        client.take_lease()
        numbers = [client.post(MOVE) for _ in range(2)]
        assert [client.verdict(number) for number in numbers] == [None, None]
        goals = page.poll(time.monotonic_ns())
        assert [client.verdict(number) for number in numbers] == [None, None]
        page.answer([(goals[0], Refusal.FENCE)])
        assert [client.verdict(number) for number in numbers] == [Refusal.FENCE, Refusal.SUPERSEDED]
        page.answer([(goals[1], Refusal.NONE)])
        assert client.verdict(numbers[1]) is Refusal.NONE
        assert client.verdict(numbers[1] + 1) is None


def test_a_goal_that_waited_too_long_is_refused(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        client.take_lease()
        number = client.post(MOVE)
        assert page.poll(time.monotonic_ns() + GOAL_LIFE_NS) == ()
        assert client.verdict(number) is Refusal.STALE
        assert page.counts["stale"] == 1


def test_the_tick_may_have_woken_before_the_goal_was_sent(page: GoalPage) -> None:
    woke = time.monotonic_ns()
    with GoalPage(page.path) as client:
        client.take_lease()
        client.post(MOVE)
    assert len(page.poll(woke)) == 1


def test_a_revoked_lease_sends_nothing_more_and_another_may_be_taken(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        client.take_lease()
        number = client.post(MOVE)
        page.revoke()
        assert page.poll(time.monotonic_ns()) == ()
        assert client.verdict(number) is Refusal.FOREIGN
        with pytest.raises(GoalPageError, match="lease has ended"):
            client.post(MOVE)
        client.take_lease()
        client.post(MOVE)
    assert len(page.poll(time.monotonic_ns())) == 1


def test_a_client_is_lost_that_neither_sends_nor_gives_back(page: GoalPage) -> None:
    late = time.monotonic_ns() + 2 * LEASE_NS
    with GoalPage(page.path) as client:
        assert not page.lost(late)
        client.take_lease()
        assert not page.lost(time.monotonic_ns())
        assert page.lost(late)
        client.give_back()
        assert not page.lost(late)
        client.take_lease()
        page.revoke()
        assert not page.lost(late)


def test_a_page_that_another_has_replaced_is_noticed(page: GoalPage) -> None:
    with GoalPage(page.path) as client:
        assert not client.replaced
        with GoalPage.create(page.path) as newer:
            assert client.replaced
            assert not newer.replaced
        page.path.unlink()
        assert client.replaced
