"""The loop's chores, tick by tick with neither clock nor bus: what systemd hears when, how often an interface that is
gone is looked for, how long a stop may take, and whose time a record holds.
"""

import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from drivers.bus.counters import BusState, PortCounters
from drivers.frame import Frame
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CycleResult, OperatorCommand, Tick
from hil.live.goal_page import LEASE_NS, GoalPage
from hil.live.loop import CHORE_INTERVAL_S, STOP_GRACE_S, ControlLoop, TimedCycle
from hil.live.stop_page import INDEX
from hil.live.timing_record import METRICS
from hil.rig.file import load_rig
from tests.live.test_loop import NO_ACK, UnpoweredDrives, loop_beside
from tests.support.paths import RIGS
from tests.support.records import bare_tick

pytestmark = pytest.mark.replaces_methods
PERIOD = 1_000_000
ROUND = round(CHORE_INTERVAL_S * 1e9) // PERIOD  # ticks in which every chore is done once


class Told:
    """systemd, as far as a loop knows it: what it was told in which tick."""

    def __init__(self, watchdog_s: float = 0.0) -> None:
        self.watchdog_s = watchdog_s
        self.heard: list[tuple[str, ...]] = []

    def send(self, *lines: str) -> bool:
        self.heard.append(lines)
        return True

    def close(self) -> None: ...


class Quiet:
    """Clock, bus and mailbox of a loop to which nothing ever comes. state: of the bus. rebound: ticks in which the
    loop looked for the interface anew.
    """

    skipped = overrun = sleeps = task_posted = mended = 0
    period_ns = PERIOD

    def mend(self) -> None:
        """Nobody cuts this mailbox short."""

    def __init__(self) -> None:
        self.index, self.state = -1, BusState.ERROR_ACTIVE
        self.rebound: list[int] = []
        self.purged: list[int] = []

    @property
    def members(self) -> "tuple[Quiet]":
        return (self,)

    def start(self) -> None: ...

    def wait(self) -> None:
        self.index += 1
        self.scheduled_ns = self.now_ns = 10**9 + self.index * PERIOD

    def drain(self, now_ns: int) -> list[Frame]:
        return []

    def send(self, frame: Frame) -> None: ...

    def counters(self) -> PortCounters:
        return PortCounters(state=self.state)

    def poll(self) -> tuple[OperatorCommand, ...]:
        return ()

    def recorder_ok(self, now_ns: int) -> bool:
        return True

    def purge(self) -> bool:
        self.purged.append(self.index)
        return True

    def rebind(self) -> None:
        self.rebound.append(self.index)


Made = tuple[ControlLoop, Quiet, Told]


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Made]:
    with loop_beside(UnpoweredDrives(NO_ACK, []), tmp_path, monkeypatch) as loop:
        quiet, told = Quiet(), Told()
        loop.pacer = loop._port = loop._mailbox = quiet  # type: ignore[assignment]
        tell(loop, told)
        yield loop, quiet, told
        loop.parts.ring.close()


def tell(loop: ControlLoop, told: Told) -> None:
    """Chores as for that systemd."""
    loop.parts = loop.parts._replace(notifier=told)  # type: ignore[arg-type]
    loop._plan_chores(PERIOD)


def tick(loop: ControlLoop, times: int) -> None:
    for _ in range(times):
        loop._tick()
        loop.ticks += 1


def test_systemd_is_told_that_it_is_ready_once_and_then_in_every_round_that_ticks_are_run(made: Made) -> None:
    loop, quiet, told = made
    loop._realtime_ok = True
    first = ROUND // len(loop._chores) - 1
    tick(loop, first)
    assert told.heard == []
    tick(loop, 1)
    assert told.heard == [("WATCHDOG=1", "STATUS=CONNECTED", "READY=1")]
    tick(loop, ROUND - 1)
    assert len(told.heard) == 1
    tick(loop, 1 + 2 * ROUND)
    assert told.heard[1:] == [("WATCHDOG=1",)] * 3
    assert loop._stop_line._words[INDEX] == quiet.index, "and so is the stop page"


def test_a_change_of_state_or_of_what_there_is_to_say_is_told_with_it(made: Made) -> None:
    loop, _, told = made
    loop._realtime_ok = False
    tick(loop, ROUND)
    loop.stop = True
    tick(loop, ROUND)
    assert [lines[:2] for lines in told.heard] == [
        ("WATCHDOG=1", "STATUS=CONNECTED, real time degraded"),
        ("WATCHDOG=1", "STATUS=SHUTDOWN, real time degraded"),
    ]
    assert [len(lines) for lines in told.heard] == [3, 2], "READY=1 is said once"


class Written:
    """Where the loop's notes go. ticks: in which it had them written."""

    told: tuple[()] = ()

    def __init__(self) -> None:
        self.ticks: list[int] = []

    def write(self, speaker: object, tick: int, now_ns: int) -> None:
        self.ticks.append(tick)


@pytest.mark.parametrize(("state", "rounds"), [(State.CONNECTED, 2), (State.ACTIVE, 0)])
def test_what_there_is_to_say_is_written_down_while_nothing_moves(
    made: Made, monkeypatch: pytest.MonkeyPatch, state: State, rounds: int
) -> None:
    loop, _, _ = made
    written = Written()
    loop.parts = loop.parts._replace(notes=written)  # type: ignore[arg-type]
    tick(loop, 1)
    monkeypatch.setattr(loop._cycle.supervisor.machine, "state", state)
    for _ in range(2):
        loop._tell_alive()
    assert len(written.ticks) == rounds


def test_signs_of_life_come_three_times_as_often_as_systemd_asks_for(made: Made) -> None:
    loop, _, _ = made
    for watchdog_s, ticks in ((0.0, 250), (3.0, 250), (0.3, 100), (0.003, 5)):
        told = Told(watchdog_s)
        tell(loop, told)
        assert (loop._chore_ticks, len(loop._chores)) == (ticks, 5)
        assert set(loop._chores) <= set(range(ticks)), "each of them has its tick in every round"
        tick(loop, 3 * ticks)
        assert len(told.heard) == 3


def test_an_interface_that_is_gone_is_looked_for_once_a_second_and_nothing_is_sent_for_it(made: Made) -> None:
    loop, quiet, _ = made
    tick(loop, 10)
    quiet.state = BusState.DOWN
    tick(loop, 3500)
    gaps = [after - before for before, after in zip(quiet.rebound, quiet.rebound[1:], strict=False)]
    assert gaps == [1000, 1000, 1000]
    assert quiet.rebound[0] < 10 + ROUND
    assert quiet.purged == [], "an interface that is down holds nothing"
    quiet.state = BusState.ERROR_ACTIVE
    tick(loop, 2500)
    assert len(quiet.rebound) == 4


def test_asked_to_stop_the_loop_waits_for_the_cycle_as_long_as_a_stop_may_take_and_no_longer(
    made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, _, _ = made
    allowed = round((loop.parts.cycle.rig.safety.stop_s + STOP_GRACE_S) * 1e3)
    monkeypatch.setattr(loop, "_tick", lambda: None)  # a cycle that stays in BOOT
    loop.run(max_ticks=5)
    assert (loop.overstayed, loop.ticks) == (True, 5 + allowed + 1)
    assert STOP_GRACE_S == 1.0


def test_a_stop_that_succeeds_is_no_overstay(made: Made) -> None:
    loop, _, _ = made
    loop.run(max_ticks=7)
    assert loop._cycle.state is State.SHUTDOWN
    assert not loop.overstayed
    assert loop.ticks == 8


def test_a_tick_notes_when_each_of_its_stages_began() -> None:
    instants = itertools.count(100)
    cycle = TimedCycle(load_rig(RIGS / "paper.toml"), RIGS, lambda: next(instants))
    for index in range(3):
        cycle.step(bare_tick(index, index * PERIOD), [])
        assert cycle.stamps == [100 + 4 * index + stage for stage in range(4)]


def test_stages_follow_one_another_and_an_age_counts_only_where_every_axis_answered(made: Made) -> None:
    loop, _, _ = made
    rows: list[list[int]] = []
    spent: list[tuple[int, ...]] = []

    class Timing:
        def note(self, row: list[int]) -> None:
            rows.append(list(row))

    class Records:
        def spent(self, *stages: int) -> None:
            spent.append(stages)

    loop._timing, loop._records = Timing(), Records()  # type: ignore[assignment]
    loop.pacer.now_ns, loop.pacer.scheduled_ns = 1_000_007, 1_000_000  # type: ignore[misc]
    loop._cpu_ns = 4321
    cycle = loop.parts.cycle
    cycle.stamps[:] = [110, 130, 170, 250]
    for instant, fresh in (((900, 400), (True, True)), ((400, 900), (True, True)), ((400, 900), (True, False))):
        cycle.sampling.instants[:] = instant
        cycle.inbox.fresh[:] = fresh
        loop._measure(100, 250, 410, 2000)
    assert spent == [(10, 20, 40, 80, 160)] * 3
    assert METRICS.index("lateness") == 0
    assert [row[:7] for row in rows] == [[7, 10, 20, 40, 80, 160, 4321]] * 3
    assert [row[7] for row in rows] == [1600, 1600, -1], "the oldest sample; none where an axis did not answer"


def test_outside_active_nobody_moves_the_rig(made: Made) -> None:
    loop, _, _ = made
    with GoalPage(loop.parts.goals.path) as client:
        client.take_lease()
        tick(loop, ROUND)
        assert client.holder() is None


def test_a_path_whose_client_is_gone_pauses_in_the_next_tick(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    loop, quiet, _ = made
    desk, machine = loop._cycle.supervisor.goals, loop._cycle.supervisor.machine
    taken: list[tuple[Goal, ...]] = []
    step = loop._cycle.step

    def stepped(tick: Tick, frames: Sequence[Frame]) -> CycleResult:
        taken.append(tick.goals)
        return step(tick, frames)

    monkeypatch.setattr(loop._cycle, "step", stepped)
    with GoalPage(loop.parts.goals.path) as client:
        client.take_lease()
        tick(loop, 1)
        machine.state, desk.word = State.ACTIVE, MotionWord.PATH
        quiet.now_ns = time.monotonic_ns()
        loop._look_at_lease()
        assert loop._pause == ()
        quiet.now_ns += LEASE_NS + 1
        loop._look_at_lease()
        tick(loop, 2)
    assert taken[-2:] == [(Goal(0, GoalKind.RATE, speed=0.0),), ()]
