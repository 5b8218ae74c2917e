"""A plug-in's call that never returns is given up, whatever else uses the process' one timer."""

import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers import call_limit
from drivers.call_limit import TooLongError, Watch
from hil.operate.trace_file import read_trace


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watch]:
    """One of its own, with a short limit; the timer is free before and after."""
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.05)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    before = signal.signal(signal.SIGALRM, signal.SIG_DFL)
    yield Watch()
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)
    call_limit.watch.disarm()  # whose timer that may have been


def never_returns(watch: Watch) -> None:
    watch.begin()
    while True:
        pass


def test_a_call_that_never_returns_is_given_up(watch: Watch) -> None:
    with pytest.raises(TooLongError, match=r"no answer within 0\.05 s"):
        never_returns(watch)


def test_so_it_is_after_a_trace_was_read_which_limits_its_time_as_well(watch: Watch, tmp_path: Path) -> None:
    watch.begin()
    watch.within = False
    trace = tmp_path / "one.log"
    trace.write_text("(0.000000) can0 123#00\n")
    assert len(list(read_trace(trace))) == 1
    with pytest.raises(TooLongError):
        never_returns(watch)


def test_a_call_in_another_thread_leaves_the_timer_to_the_main_one(watch: Watch) -> None:
    thread = threading.Thread(target=watch.begin)
    thread.start()
    thread.join()
    watch.within = False
    with pytest.raises(TooLongError):
        never_returns(watch)
