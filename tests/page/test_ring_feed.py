"""The page follows a control process, says when it hangs, ends or is killed, and follows the next."""

import math
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.cycle.state_machine import State
from hil.page.frames import Fate
from hil.page.ring_feed import MOST, RingFeed, running_rigs
from tests.page.conftest import Told
from tests.support.paths import ROOT


def test_only_what_is_new_is_read_at_the_instants_of_the_run(told: Told) -> None:
    told.tick(1)
    with RingFeed("paper") as feed:
        feed.turn()
        told.tick(5, force=2.0)
        told.tick(7, force=4.0)
        block = feed.turn()
        assert block is not None
        assert block.instants.tolist() == pytest.approx([0.005, 0.007])  # a missed tick is a gap
        assert block.values[feed_row(feed, "force")].tolist() == [2.0, 4.0]
        assert feed.turn() is None


def feed_row(feed: RingFeed, quantity: str) -> int:
    return next(number for number, signal in enumerate(feed.signals) if signal.quantity == quantity)


def test_who_opens_the_page_begins_with_the_newest_tick(told: Told) -> None:
    for index in range(20):
        told.tick(index)
    with RingFeed("paper") as feed:
        block = feed.turn()
    assert block is not None
    assert block.instants.tolist() == pytest.approx([0.019])
    assert block.lost == 0


def test_what_came_while_nobody_watched_is_left_out(told: Told) -> None:
    with RingFeed("paper") as feed:
        for index in range(20):
            told.tick(index)
        feed.turn()
        for index in range(20, 40):
            told.tick(index)
        feed.skip()
        assert feed.turn() is None


def test_ticks_that_were_overwritten_are_counted_as_lost(told: Told) -> None:
    told.tick(0)
    with RingFeed("paper") as feed:
        feed.turn()
        for index in range(1, 400):  # the ring holds 256
            told.tick(index)
        block = feed.turn()
        assert block is not None
        assert len(block.instants) + block.lost == 399
        assert 0 < block.lost < MOST


def test_who_fell_far_behind_goes_on_with_the_newest_ticks(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.page.ring_feed.MOST", 10)
    told.tick(0)
    with RingFeed("paper") as feed:
        feed.turn()
        for index in range(1, 31):
            told.tick(index)
        block = feed.turn()
    assert block is not None
    assert block.instants.tolist() == pytest.approx([index * 1e-3 for index in range(21, 31)])
    assert block.lost == 20


def test_a_ring_is_let_go_of_when_it_is_not_wanted_any_more(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.page.ring_feed.SEARCH_NS", 0)
    with RingFeed("paper") as feed:
        feed.turn()
        held = open_files()
        told.ring.close()
        told.ring = Told().ring
        feed.turn()  # the successor's
        assert open_files() == held
        told.ring.close()
        held = open_files()
        for _ in range(3):
            feed.turn()
        assert open_files() == held
        feed.close()
        assert open_files() < held
        assert feed.pulse(0.0).fate is Fate.NONE


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_state_and_age_are_of_the_newest_tick(told: Told) -> None:
    told.tick(1, now_ns=time.monotonic_ns() - 700_000_000, state=State.FAULT, fault=3)
    with RingFeed("paper") as feed:
        feed.turn()
        pulse = feed.pulse(0.25)
    assert (pulse.state, pulse.fault, pulse.fate, pulse.word_age) == (State.FAULT, 3, Fate.ALIVE, 0.25)
    assert 0.7 <= pulse.tick_age < 5.0


def test_an_ended_process_is_said_to_have_ended_and_its_successor_is_followed(told: Told) -> None:
    told.tick(1, state=State.SHUTDOWN)
    with RingFeed("paper") as feed:
        feed.turn()
        first = feed.run_id
        told.ring.close()
        assert feed.pulse(0.0).fate is Fate.ENDED
        told.ring = Told().ring
        told.tick(1, state=State.READY)
        until = time.monotonic() + 5.0
        while feed.run_id == first and time.monotonic() < until:
            feed.turn()
        assert feed.run_id != first
        pulse = feed.pulse(0.0)
        assert (pulse.fate, pulse.state) == (Fate.ALIVE, State.READY)


def test_without_any_ring_nothing_is_claimed() -> None:
    with RingFeed("paper") as feed:
        assert feed.turn() is None
        pulse = feed.pulse(float("nan"))
        assert (feed.run_id, feed.metadata, feed.signals) == (0, {}, [])
    assert (pulse.fate, *pulse[:3]) == (Fate.NONE, -1, -1, -1)
    assert pulse.tick_age != pulse.tick_age
    assert running_rigs() == []


def test_rigs_that_run_here_are_found(told: Told) -> None:
    assert running_rigs() == ["paper"]


def test_a_new_process_that_has_not_ticked_shows_nothing_of_the_one_before(told: Told) -> None:
    told.tick(1, state=State.ACTIVE, fault=2, motion=1)
    with RingFeed("paper") as feed:
        feed.turn()
        assert feed.pulse(0.0)[:3] == (State.ACTIVE, 2, 1)
        told.ring.close()
        first, told.ring = feed.run_id, Told().ring
        until = time.monotonic() + 5.0
        while feed.run_id == first and time.monotonic() < until:
            feed.turn()
        pulse = feed.pulse(0.0)
        assert pulse[:3] == (-1, -1, -1)
        assert math.isnan(pulse.tick_age)


@pytest.mark.long
def test_a_killed_process_is_said_to_have_been_killed(told: Told) -> None:
    code = (
        "import os, signal; from tests.page.conftest import Told; told = Told(); told.tick(1)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    told.ring.close()
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    with RingFeed("paper") as feed:
        feed.turn()
        assert feed.pulse(0.0).fate is Fate.KILLED
