"""The one guard around what users bring: what they raise is told with key, method, file and line, from any thread."""

import re
import threading
from typing import Any

import pytest

from drivers.base import call_limit, guard
from drivers.base.guard import BadAnswerError, Guard, Limited
from drivers.base.plugins import Kind
from tests.support.paths import ROOT

KIND = Kind("law", "laws", "law", "name", "hil.laws", {}, ("force",))


class Theirs:
    """What a laboratory wrote."""

    def force(self, answer: Any) -> Any:
        if isinstance(answer, BaseException):
            raise answer
        return answer


class OwnError(Exception):
    """What a caller wants to get."""


def theirs(raises: type[Exception] = ValueError) -> Guard:
    return Guard(KIND, "theirs", Theirs, raises)


def test_an_answer_comes_through() -> None:
    assert theirs().call("force", Theirs().force, 3) == 3


@pytest.mark.parametrize("error", [RuntimeError("no weights"), SystemExit(3), call_limit.TooLongError()])
def test_a_call_that_fails_is_told_with_key_method_and_line(error: BaseException) -> None:
    kind = type(error).__name__
    with pytest.raises(OwnError, match=rf"law\.name = 'theirs': force: .*test_guard\.py:\d+: {kind}: ") as told:
        theirs(OwnError).call("force", Theirs().force, error)
    assert told.value.__cause__ is error


def test_a_wrong_answer_is_told_with_the_file_alone() -> None:
    text = theirs().told("force", BadAnswerError("returned 'x', expected a number"))
    assert re.fullmatch(r"law\.name = 'theirs': force: \S+test_guard\.py: returned 'x', expected a number", text)


def test_calls_of_a_tick_leave_what_fails_to_who_keeps_it_and_the_tick_goes_on() -> None:
    kept: list[str] = []
    limited = theirs().limited("force", kept.append)
    for answer in (1, ZeroDivisionError("divided"), 2):
        with limited:
            Theirs().force(answer)
    assert len(kept) == 1
    assert re.fullmatch(r"law theirs: \S+test_guard\.py:\d+: ZeroDivisionError: divided", kept[0])


def test_without_who_keeps_it_a_failure_is_raised() -> None:
    with pytest.raises(OwnError, match=r"law theirs: .*: IndexError: far"), theirs(OwnError).limited("force"):
        Theirs().force(IndexError("far"))


def test_a_keyboard_s_interrupt_is_nobody_s_failure() -> None:
    kept: list[str] = []
    with pytest.raises(KeyboardInterrupt), theirs().limited("force", kept.append):
        Theirs().force(KeyboardInterrupt())
    assert kept == []


def test_the_time_limit_begins_with_the_block_and_ends_with_it_however_it_ends() -> None:
    watch = call_limit.watch
    for answer in (1, ValueError()):
        before = watch.calls
        with Limited(lambda error: None):
            assert (watch.within, watch.calls) == (True, before + 1)
            guard.next_call()
            assert (watch.within, watch.calls) == (True, before + 2)
            Theirs().force(answer)
        assert not watch.within


def test_a_call_that_does_not_return_is_given_up_in_whatever_thread_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.05)
    call_limit.watch.disarm()  # a timer of an earlier call would look in its own time
    kept: list[str] = []

    def endless() -> None:
        with theirs().limited("force", kept.append):
            while True:
                pass

    other = threading.Thread(target=endless, daemon=True)
    other.start()
    endless()
    other.join(10.0)
    assert len(kept) == 2
    assert all("TooLongError: no answer within 0.05 s" in text for text in kept)
    call_limit.watch.disarm()


def test_nobody_else_keeps_a_watch_of_their_own() -> None:
    sources = (path for package in ("hil", "drivers", "sim_plant") for path in (ROOT / package).rglob("*.py"))
    users = {path.relative_to(ROOT).as_posix() for path in sources if "base.call_limit import" in path.read_text()}
    assert users == {"drivers/base/guard.py"}
