"""How far a long command is, in a log: a line now and then, with the time left, and none of what is soon over."""

import io

import pytest
from rich.console import Console

from hil.cli import progress
from hil.cli.progress import Steps, duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, to be moved on by hand."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_a_log_gets_a_line_now_and_then(clock: list[float]) -> None:
    out = io.StringIO()
    with Steps("work", 20, Console(file=out, width=120)) as steps:
        for number in range(20):
            clock[0] += 20.0
            steps.advance(text=f"part [{number}]")
    assert out.getvalue().splitlines()[:2] == [
        "part [1]; 2 of 20 done, about 6 min left",
        "part [3]; 4 of 20 done, about 5 min left",
    ]
    assert len(out.getvalue().splitlines()) == 9


def test_of_what_is_soon_over_a_log_says_nothing(clock: list[float]) -> None:
    out = io.StringIO()
    with Steps("work", 2, Console(file=out)) as steps:
        clock[0] += 20.0
        steps.advance()
        clock[0] += 20.0
        steps.advance()
    assert out.getvalue() == ""


def test_a_terminal_has_a_bar_that_goes_away(clock: list[float]) -> None:
    out = io.StringIO()
    with Steps("work", 100, Console(file=out, force_terminal=True, width=100)) as steps:
        clock[0] += 40.0
        steps.advance(2, "half [x]")
        steps._bar.refresh()
    shown = out.getvalue()
    assert "half [x]" in shown
    assert "2/100" in shown
    assert "left" not in shown
    assert shown.rstrip("\n").endswith("\x1b[2K")


@pytest.mark.parametrize(("seconds", "text"), [(4.4, "4 s"), (89.0, "89 s"), (90.0, "2 min"), (5400.0, "1.5 h")])
def test_times_are_told_in_the_unit_people_would_use(seconds: float, text: str) -> None:
    assert duration(seconds) == text
