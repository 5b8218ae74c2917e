"""A plug-in's call that never returns is given up, whatever else uses the process' one timer."""

import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base import call_limit
from drivers.base.call_limit import TooLongError, Watch
from hil.runs.trace_file import read_trace


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
    watch.end()
    trace = tmp_path / "one.log"
    trace.write_text("(0.000000) can0 123#00\n")
    assert len(list(read_trace(trace))) == 1
    with pytest.raises(TooLongError):
        never_returns(watch)


def test_a_call_in_another_thread_is_given_up_there_and_nothing_else_is(watch: Watch) -> None:
    ended: list[BaseException] = []

    def call() -> None:
        try:
            never_returns(watch)
        except TooLongError as error:
            ended.append(error)
        finally:
            watch.end()

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    for _ in range(1000):  # the main thread's calls, each of which returns
        watch.begin()
        watch.end()
        thread.join(0.01)
        if not thread.is_alive():
            break
    assert [str(error) for error in ended] == ["no answer within 0.05 s"]


def test_a_thread_whose_calls_return_is_left_alone_and_so_is_the_main_one(watch: Watch) -> None:
    done = []

    def calls() -> None:
        for _ in range(30):
            watch.begin()
            pause.wait(0.01)
            watch.end()
        pause.wait(0.15)  # no call any more, for three looks
        done.append(True)

    pause = threading.Event()
    thread = threading.Thread(target=calls)
    thread.start()
    thread.join()
    assert done
    with pytest.raises(TooLongError):
        never_returns(watch)


@pytest.fixture
def patient(watch: Watch, monkeypatch: pytest.MonkeyPatch) -> Watch:
    """One whose timer does not end within a test, which looks itself."""
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 1000.0)
    return watch


def look(watch: Watch) -> None:
    watch._look(signal.SIGALRM, None)


def timer() -> tuple[float, float]:
    return signal.getitimer(signal.ITIMER_REAL)


def test_only_a_call_that_two_looks_find_is_given_up(patient: Watch) -> None:
    patient.begin()
    for _ in range(3):  # another call at every look, each of them under way
        look(patient)
        patient.begin()
    look(patient)
    with pytest.raises(TooLongError):
        look(patient)


def test_a_timer_that_finds_no_more_calls_stops_and_the_next_call_starts_it_again(patient: Watch) -> None:
    for _ in range(2):
        patient.begin()
        assert 900.0 < timer()[0] <= timer()[1] == 1000.0
        patient.end()
        look(patient)
        assert (patient.armed, timer()[1]) == (True, 1000.0)  # there has been one since the last look
        look(patient)
        assert (patient.armed, timer()) == (False, (0.0, 0.0))


def test_the_timer_of_somebody_else_is_left_alone(patient: Watch) -> None:
    signal.signal(signal.SIGALRM, signal.SIG_IGN)
    patient.begin()
    assert timer() == (0.0, 0.0)
    signal.setitimer(signal.ITIMER_REAL, 500.0)
    patient.rest()
    assert 400.0 < timer()[0] <= 500.0


def test_a_process_that_ends_has_no_timer_and_one_that_begins_none_either(patient: Watch) -> None:
    signal.signal(signal.SIGALRM, patient._look)
    signal.setitimer(signal.ITIMER_REAL, 500.0)
    patient.rest()  # it has set none
    assert timer()[0] > 400.0
    patient.begin()
    patient.rest()
    assert timer() == (0.0, 0.0)
    patient.disarm()
    assert (patient.armed, patient.within) == (False, False)
    patient.begin()
    assert timer()[1] == 1000.0
