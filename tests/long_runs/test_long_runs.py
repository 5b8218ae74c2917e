"""Slices of the long campaigns, and that each of them tells what is wrong. All of it: python -m tests.long_runs."""

import random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.long_runs.clocks import DRIFTS_PPM, LAYOUTS, WRAPS, around, day
from tests.long_runs.lives import Row, by_host, cut, cycles, kills_beside, kills_of_control, told
from tests.long_runs.loops import Loop, drawn, holds, said, ticked, verdicts


@pytest.mark.requirement(id="SR-5.5")
@pytest.mark.long
def test_random_loops_are_judged_as_their_ticks_judge_them() -> None:
    draw = random.Random(1)
    found = list(verdicts([drawn(draw, most_hz=100.0) for _ in range(8)]))
    assert {verdict.true for verdict in found} == {True, False}
    assert [verdict.loop for verdict in found if verdict.said != verdict.true] == []


@pytest.mark.long
def test_the_ticks_know_what_holds_and_what_drifts() -> None:
    """1 % is left after 4.6 kd / kp seconds; without stiffness, or with an integrator of the wrong sign, all of it."""
    plain = Loop("pd-feedforward", 100.0, 1.0, 0.0, 5.0, 0.0)
    back = [plain._replace(kp=4.6 * plain.kd / seconds) for seconds in (90.0, 540.0, 700.0)]
    wrong = plain._replace(law="pid", kp=20.0, ki=-1e-6)
    slow = wrong._replace(ki=-0.05)
    assert ticked([*back, plain, slow]) == [True, True, False, False, False]
    assert [said(loop) for loop in (*back, plain, slow)] == [True, True, False, False, False]


def test_the_rule_of_the_ticks_sees_growth_a_circle_and_an_offset() -> None:
    ticks = np.arange(800.0)[:, None]
    fades, circles, grows = 0.9**ticks, np.ones((800, 1)), 1.01**ticks
    for motion, kicked, expected in (
        (fades, fades, True),
        (circles, fades, False),
        (grows, fades, False),
        (fades, 0.02 + fades, False),
    ):
        assert holds(motion, kicked).tolist() == [expected]


@pytest.mark.requirement(id="SR-3.4")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_clock_that_drifts_refuses_no_sample_and_leads_no_filter_astray(layout: str) -> None:
    for ppm in DRIFTS_PPM:
        found = day(layout, ppm, 100.0, 0.03)
        assert found.held, (ppm, found)


@pytest.mark.replaces_methods
def test_a_clock_that_follows_no_drift_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.cycle.drive_clock.DRIFT", 100_000)
    assert not day("stage_fd", 500, 100.0, 0.03).held


@pytest.mark.requirement(id="SR-3.4")
@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_cycle_goes_over_every_wrap_on_a_clock_that_drifts(layout: str, wrap: str) -> None:
    found = around(layout, wrap, -500, 600)
    assert found.held, found


def test_what_is_not_explained_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(iter([Row("a"), Row("b", latched_s=0.001)]))
    assert not told(iter([Row("a"), Row("c", "it ended")]))
    assert "UNEXPLAINED c: it ended" in capsys.readouterr().out
    assert told(iter([Row("d", "", 0.009, by_host=True), Row("e", "", 0.008), Row("f", "", 0.001, by_host=True)]))
    assert "2 beyond 5 ms, 1 of them while this machine missed ticks" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("own", "host", "expected"),
    [((3, 3, 3), (7, 7, 8), True), ((3, 3, 4), (7, 7, 8), False), ((3, 3, 3), (7, 8, 8), False)],
)
def test_the_machine_is_blamed_for_what_it_missed_around_a_press(
    own: tuple[int, ...], host: tuple[int, ...], expected: bool
) -> None:
    """The first record is long before the press."""
    fields = [("now_ns", "<i8"), ("missed_own", "<u8"), ("missed_host", "<u8")]
    records = np.array(list(zip((0, 10**9, 10**9 + 10**6), own, host, strict=True)), dtype=fields)
    reader: Any = SimpleNamespace(read=lambda limit, fields: SimpleNamespace(records=records))
    assert by_host(reader, 10**9 + 1_000, 10**9 + 2_000) is expected
    assert not by_host(reader, 10**10, 10**10), "no tick is known"


@pytest.mark.requirement(id="SR-7.2")
@pytest.mark.live
def test_files_cut_under_a_live_rig_and_every_end_are_explained() -> None:
    rows = [*cut(1, seed=1, names=("stop", "ring", "mailbox")), *cycles(1, seed=1), *kills_of_control(1, seed=1)]
    assert [row for row in rows if row.why] == []


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.parametrize("victim", ["sidecar", "teller", "page", "emulator"])
def test_a_process_killed_beside_the_loop_is_explained(victim: str) -> None:
    assert [row for row in kills_beside(victim, 2, seed=1) if row.why] == []
