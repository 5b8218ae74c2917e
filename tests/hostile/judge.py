"""What may become of a command in bad surroundings: its work, or one line that names what was in its way."""

import signal

from hil.cli import exit_status
from tests.hostile.commands import Case
from tests.hostile.started import Ended
from tests.hostile.surroundings import Surroundings
from tests.support.paths import ROOT

MARKS = ("Traceback (most recent call last)", "Exception ignored", "Fatal Python error", "During handling of")
DOCUMENTED = {1, 2, 4, *(value for name, value in vars(exit_status).items() if name.startswith("EXIT_"))}
JOURNAL = "tick "  # of a control process: as many lines as there are events
LONGEST_LINES = 12  # a refusal of the command line stands in a frame


def wrong(case: Case, over: Surroundings, ended: Ended) -> str:
    """Why this is not right, or nothing."""
    said = (ended.out or "") + (ended.err or "")
    foreign = _before_us(over, said) or _of_a_library(said)
    if (found := [mark for mark in MARKS if mark in said]) and not foreign:
        return f"status {ended.status}: {found[0]}"
    if ended.status is None:
        return "does not end"
    if over.number is not None and ended.status in (-over.number, 128 + over.number, *((0,) if case.ends else ())):
        return ""
    if case.ends and ended.status == -signal.SIGTERM and not ended.out:
        return ""  # told to end before it had begun, on a busy machine
    if ended.status == case.status:
        return _lacks(case, ended)
    if over.killed and ended.status == -signal.SIGKILL:
        return ""
    if ended.status < 0:
        return f"ended by {signal.Signals(-ended.status).name}"
    if ended.status == 0:
        return f"status 0, where undisturbed it is {case.status}"
    if ended.status not in DOCUMENTED:
        return f"status {ended.status} is not documented"
    return _untold(ended)


def _before_us(over: Surroundings, said: str) -> bool:
    """A signal within the first milliseconds, in which Python itself starts: nothing of hil is in the traceback."""
    return over.number is not None and "KeyboardInterrupt" in said and f"{ROOT}/hil/" not in said


def _of_a_library(said: str) -> bool:
    """A callback of another package that ran out of memory and cannot raise; ours has said so in its line."""
    return "MemoryError" in said and "hil: not enough memory" in said and f"{ROOT}/hil/" not in said


def _lacks(case: Case, ended: Ended) -> str:
    """It ends as it does undisturbed; so it must have done its work, too."""
    missing = [name for name in case.makes if not ended.made.get(name)]
    if missing and (ended.status == 0 or not ended.err):
        return f"status {ended.status} without {', '.join(missing)}"
    return "" if case.status < 0 else _untold(ended)


def _untold(ended: Ended) -> str:
    """Something must be said wherever it can be read."""
    lines = [line for line in ((ended.err or "") + (ended.out or "")).splitlines() if line.strip()]
    if not lines and ended.err is not None and ended.out is not None:
        return f"status {ended.status} without a word"
    told = [line for line in (ended.err or "").splitlines() if not line.startswith(JOURNAL)]
    if len(told) > LONGEST_LINES:
        return f"status {ended.status} in {len(told)} lines"
    return ""
