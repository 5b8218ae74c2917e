"""What a drive was told is read back: one question at a time, until every answer is as it should be.

Rules. A drive counts as in fault until all of its answers are right, so no rig with it becomes READY. Another value, or
no answer to a question that was asked three times, is a problem for people, with name and values; it is begun again
after a while, and at every reset. A drive that was proved is asked on, more seldom: a value that changes by itself is a
problem, too.

Time is counted in ticks (calls of `HostProtocol.encode`).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

ANSWER_TICKS: Final = 10  # in which an answer is waited for
MOST_ASKED: Final = 3  # times
RETRY_TICKS: Final = 500
WATCH_TICKS: Final = 50  # between the questions to a drive that was proved


class Question(NamedTuple):
    """One value. name: for people. least, most: bounds that are allowed; NaN is in none. otherwise: what a value beyond
    them means, for people.
    """

    name: str
    least: float
    most: float
    otherwise: str = "it does not keep what it was told"

    @property
    def expected(self) -> str:
        """In words."""
        return _text(self.least) if self.least == self.most else f"{_text(self.least)} to {_text(self.most)}"


class ReadBack:
    """The values of one drive. proved: all are as they should be. problem: what is not, or empty. subject: who, for
    people. apart: ticks at least between two questions. answer_ticks: in which an answer is waited for.
    """

    def __init__(
        self, subject: str, questions: Sequence[Question], apart: int = ANSWER_TICKS, answer_ticks: int = ANSWER_TICKS
    ) -> None:
        self._subject, self._questions, self._apart = subject, tuple(questions), apart
        self._answer_ticks = answer_ticks
        self.problem = ""
        self.begin()

    def begin(self) -> None:
        """From the first question on: at the start, after a reset."""
        self.proved = not self._questions
        self._at = self._asked = 0
        self._waits = False
        self._next_tick = self._asked_tick = 0

    def rest(self) -> None:
        """No answer is waited for until the next question; what was proved stays so."""
        self._waits, self._asked = False, 0

    def ask(self, tick: int) -> int | None:
        """Number of the question to ask in this tick."""
        if not self._questions or tick < self._next_tick:
            return None
        if self._waits and self._asked == MOST_ASKED:
            self._fail(tick, f"{self._questions[self._at].name} was read back and gave no answer")
            return None
        self._asked += 1
        self._waits, self._next_tick, self._asked_tick = True, tick + self._answer_ticks, tick
        return self._at

    def answer(self, number: int, value: float, tick: int) -> None:
        """An answer came; one to another question than that asked is another tool's."""
        question = self._questions[number]
        if not self._waits or number != self._at:
            return
        if not question.least <= value <= question.most:
            self._fail(tick, f"{question.name} = {_text(value)}; expected {question.expected}: {question.otherwise}")
            return
        self._waits, self._asked = False, 0
        self._at = (self._at + 1) % len(self._questions)
        if not self._at:
            self.proved, self.problem = True, ""
        self._next_tick = self._asked_tick + (WATCH_TICKS if self.proved else self._apart)

    def _fail(self, tick: int, text: str) -> None:
        self.begin()
        self.problem = f"{self._subject}: {text}"
        self._next_tick = tick + RETRY_TICKS


def _text(value: float) -> str:
    """A number for people; all digits of a whole one."""
    return f"{value:.0f}" if float(value).is_integer() else f"{value:g}"
