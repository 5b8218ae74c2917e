"""A few SDO accesses with a drive that runs, in order, one frame at a time. Time is counted in ticks.

Rules. A read that does not say what is expected is repeated for PATIENCE_TICKS, as a drive may need a moment for what
it was told. An access without an answer is made MOST_ASKED times. What ends an errand early is in `problem`.
"""

from collections.abc import Sequence
from typing import Final, Protocol

from drivers.eds.reader import object_name
from drivers.families.cia402.cia301 import Abort
from drivers.families.cia402.sdo import Progress, Step, Transfer, describe_abort
from drivers.protocols.finding import Search

PATIENCE_TICKS: Final = 200
ANSWER_TICKS: Final = 100
MOST_ASKED: Final = 2


class Errand:
    """over: nothing more is asked. problem: why it did not come to its end, for people; empty where it did. values:
    what was read, by object. required: the drive is refused where it does not come to its end.
    """

    def __init__(self, steps: Sequence[Step], *, required: bool = False) -> None:
        self.required = required
        self.problem = ""
        self.values: dict[int, int] = {}
        self.over = not steps
        self._steps = list(steps)
        self._at = self._asked = 0
        self._begun_tick = -1  # of the step
        self._asked_tick = -1  # of the request not answered yet
        self._closing = b""
        self._transfer = Transfer(steps[0]) if steps else None

    def request(self, tick: int) -> bytes:
        """The eight bytes to send in this tick; empty where none are due."""
        if self._closing:
            closing, self._closing = self._closing, b""
            return closing
        if self.over or self._transfer is None:
            return b""
        if self._begun_tick < 0:
            self._begun_tick = tick
        if self._asked_tick < 0:
            self._asked_tick = tick
            return self._transfer.request()
        if tick - self._asked_tick <= ANSWER_TICKS:
            return b""
        self._asked += 1
        overdue = self._transfer
        if self._asked == MOST_ASKED:
            self.fail(f"no answer to {self._name}")
        else:
            self._ask_again()
        return overdue.abort(Abort.TIMEOUT)

    def on_answer(self, data: bytes) -> bool:
        """An SDO answer of eight bytes; False where it is not one to the request that is open."""
        if self.over or self._transfer is None or self._asked_tick < 0:
            return False
        progress = self._transfer.answer(data)
        if progress is Progress.FOREIGN:
            return False
        begun, asked = self._begun_tick, self._asked_tick
        self._asked_tick = -1
        self._closing = self._transfer.closing
        step = self._steps[self._at]
        if progress is Progress.ABORTED:
            self.fail(f"{self._name} aborted with {describe_abort(self._transfer.code)}")
        elif progress is Progress.DONE:
            value = self._transfer.value
            if step.size or value & step.mask == step.value:
                self.values[step.object_index] = value
                self._next()
            elif asked - begun <= PATIENCE_TICKS:
                self._ask_again()
            else:
                name = self._name.removesuffix(":00")
                self.fail(f"{name} = {value:#x}; expected {step.value:#x} in the bits {step.mask:#x}")
        return True

    def fail(self, problem: str) -> None:
        """It ends here."""
        if not self.over:
            self.problem, self.over = problem, True

    @property
    def _name(self) -> str:
        step = self._steps[self._at]
        return object_name(step.object_index, step.subindex)

    def _ask_again(self) -> None:
        self._asked_tick = -1
        self._transfer = Transfer(self._steps[self._at])

    def _next(self) -> None:
        self._at += 1
        if self._at == len(self._steps):
            self.over = True
            return
        self._asked, self._begun_tick = 0, -1
        self._ask_again()


class Runner(Protocol):
    """A drive that runs errands. node_id: its node."""

    node_id: int

    def take_on(self, errand: Errand) -> None:
        """Run it next; it fails at once where the drive does not run."""


class Asked:
    """What a drive was asked by one errand after the other, and how far it is. problem: why it failed, for people."""

    def __init__(self, runner: Runner) -> None:
        self.problem = ""
        self._runner = runner
        self._search = Search.NONE
        self._errand: Errand | None = None

    @property
    def search(self) -> Search:
        """See drivers/protocols/finding.py."""
        errand = self._errand
        if errand is not None and errand.over:
            self._errand = None
            if errand.problem:
                self.problem, self._search = f"node {self._runner.node_id}: {errand.problem}", Search.FAILED
            else:
                self._conclude(errand)
        return self._search

    def _ask(self, steps: Sequence[Step], *, required: bool = False) -> None:
        self._search, self._errand = Search.ASKED, Errand(steps, required=required)
        self._runner.take_on(self._errand)

    def _forget(self) -> None:
        """Nothing was asked."""
        self._search, self._errand = Search.NONE, None

    def _conclude(self, errand: Errand) -> None:
        """An errand came to its end."""
        raise NotImplementedError


def written(index: int, subindex: int, value: int, size: int) -> list[Step]:
    """Steps that write a number and read it back."""
    raw = value % (1 << 8 * size)
    return [
        Step(index, subindex, raw, size, width=size),
        Step(index, subindex, raw, mask=(1 << 8 * size) - 1, width=size),
    ]
