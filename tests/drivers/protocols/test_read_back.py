"""Questions to a drive: their order, their time, and what comes of answers that are wrong, late or none."""

import math

import pytest

from drivers.protocols.read_back import ANSWER_TICKS, MOST_ASKED, RETRY_TICKS, WATCH_TICKS, Question, ReadBack

QUESTIONS = (Question("mode", 1.0, 1.0), Question("limit", 0.5, 2.0))


def asked(proof: ReadBack, first: int, last: int) -> list[tuple[int, int]]:
    """Ticks and numbers of the questions in these ticks, none of which is answered."""
    found = ((tick, proof.ask(tick)) for tick in range(first, last))
    return [(tick, number) for tick, number in found if number is not None]


def prove(proof: ReadBack, tick: int = 0) -> int:
    """Answer rightly until all is told; the tick then."""
    while not proof.proved:
        number = proof.ask(tick)
        if number is not None:
            proof.answer(number, 1.0, tick)
        tick += 1
    return tick


def test_without_questions_a_drive_is_taken_at_its_word() -> None:
    proof = ReadBack("axis 0", ())
    assert proof.proved
    assert asked(proof, 0, 1000) == []


def test_it_is_proved_by_the_last_right_answer_and_not_before() -> None:
    proof = ReadBack("axis 0", QUESTIONS)
    assert proof.ask(0) == 0
    proof.answer(0, 1.0, 3)
    assert not proof.proved
    assert asked(proof, 4, 11) == [(ANSWER_TICKS, 1)]
    proof.answer(1, 2.0, 12)
    assert proof.proved
    assert proof.problem == ""


def test_questions_may_follow_each_other_at_once() -> None:
    proof = ReadBack("axis 0", QUESTIONS, apart=1)
    assert prove(proof) == 2


@pytest.mark.parametrize("value", [0.4999, 2.001, math.nan, math.inf, -1.0])
def test_a_wrong_value_is_named_with_what_was_expected_and_asked_again_after_a_while(value: float) -> None:
    proof = ReadBack("axis 0", QUESTIONS, apart=1)
    proof.ask(0)
    proof.answer(0, 1.0, 0)
    proof.ask(1)
    proof.answer(1, value, 1)
    assert not proof.proved
    assert proof.problem == f"axis 0: limit = {value:g}; expected 0.5 to 2: it does not keep what it was told"
    assert asked(proof, 2, RETRY_TICKS + 2) == [(RETRY_TICKS + 1, 0)]
    proof.answer(0, 1.0, RETRY_TICKS + 2)
    assert proof.problem, "until all is right"
    prove(proof, RETRY_TICKS + 3)
    assert proof.problem == ""


def test_silence_is_named_after_three_questions() -> None:
    proof = ReadBack("axis 2", QUESTIONS)
    assert asked(proof, 0, 31) == [(0, 0), (ANSWER_TICKS, 0), (2 * ANSWER_TICKS, 0)]
    assert MOST_ASKED == 3
    assert proof.problem == "axis 2: mode was read back and gave no answer"
    assert not proof.proved


def test_an_answer_to_another_tool_is_none() -> None:
    proof = ReadBack("axis 0", QUESTIONS)
    proof.answer(0, 7.0, 0)
    proof.ask(0)
    proof.answer(1, 7.0, 1)
    assert proof.problem == ""
    proof.answer(0, 1.0, 2)
    proof.answer(0, 7.0, 3)
    assert proof.problem == ""


def test_a_proved_drive_is_asked_on_and_loses_its_proof_by_a_wrong_value() -> None:
    proof = ReadBack("axis 0", QUESTIONS, apart=1)
    end = prove(proof)
    assert asked(proof, end, end + WATCH_TICKS) == [(1 + WATCH_TICKS, 0)]
    proof.answer(0, 3.0, end + WATCH_TICKS)
    assert not proof.proved
    assert proof.problem.startswith("axis 0: mode = 3; expected 1:")


def test_a_reset_begins_anew() -> None:
    proof = ReadBack("axis 0", QUESTIONS, apart=1)
    end = prove(proof)
    proof.begin()
    assert not proof.proved
    assert proof.ask(end) == 0
