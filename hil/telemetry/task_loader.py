"""LOAD_TASK and SET_LAW in the sidecar: the parts put together, checked, planned, and handed to the control process.

Checked of a task is what ACTIVATE would ask: the rig with that task is a rig, and the task keeps every limit from where
the stage stands. Of a law, that its loop is stable, as `hil check` has it. All that takes as
long as it takes, in a thread: the sidecar goes on, and no tick waits. The control process takes what was made in
between its ticks (hil/live/task_file.py); only then the command itself is posted.
"""

import contextlib
import zlib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.base.runtime import write_private
from drivers.base.text_file import words_of
from hil.analysis.feasibility import violations
from hil.analysis.task_figures import excursion_problems
from hil.control.trajectories.injection import OverCells
from hil.control.trajectories.paths import AlongPath
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.task_file import law_bytes, task_bytes
from hil.live.task_loading import loaded_law, loaded_task, rig_with_law, rig_with_task, task_document
from hil.rig.schema import RigConfig, RigError
from hil.telemetry.command_server import Asked

MOST_BYTES = 2**21  # of a task, compressed
MOST_TEXT = 2**24  # of its JSON
PATIENCE_NS = 60_000_000_000  # the longest task takes two seconds of a processor
_LONGEST = 800  # characters of a reason: it has to fit a message


class Prepared(NamedTuple):
    """What became of a task or law. reason: why it is refused; empty where it is not."""

    reason: str
    document: str = ""
    rig: RigConfig | None = None
    data: bytes = b""


class TaskLoader:
    """One task or law at a time, from the last of its parts until the control process has it. path: of its file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._threads: ThreadPoolExecutor | None = None
        self._asked: Asked | None = None
        self._future: Future[Prepared] | None = None
        self._prepared = Prepared("")
        self._number = 0
        self._until_ns = 0

    def take(self, asked: Asked, rig: RigConfig, mailbox: Mailbox | None, last: np.void | None, now_ns: int) -> str:
        """Begin with a request that holds the last part. last: the newest tick. Returns why it is refused, or ""."""
        upload, asked.connection.upload = asked.connection.upload, b""
        if mailbox is None or last is None:
            return "no control process is running this rig, or it is not known where the stage stands"
        what = "law" if asked.request.kind == CommandKind.SET_LAW else "task"
        state, motion = State(int(last["state"])), MotionWord(int(last["motion"]))
        if state is not State.READY and motion is not MotionWord.HOLD:
            moves = f", its motion {motion.name}" if motion is not MotionWord.NONE else ""
            return f"a {what} is loaded at rest, in READY or while the axes hold; the state is {state.name}{moves}"
        if rig.law.iterative_learning:
            return f"law.iterative_learning = true: the law learns from the rig's own task, and no {what} is loaded"
        if self._asked is not None:
            return "another task or law is being loaded"
        self._number = mailbox.task_posted + 1
        self._asked, self._until_ns = asked, now_ns + PATIENCE_NS
        self._threads = self._threads or ThreadPoolExecutor(1, thread_name_prefix="task")
        start = last["position"][: len(rig.axes)].tolist()
        if what == "law":
            self._future = self._threads.submit(_prepare_law, upload, rig, self._number)
        else:
            held = state is not State.READY
            self._future = self._threads.submit(_prepare, upload, rig, start, self._number, holds=held)
        return ""

    def advance(self, mailbox: Mailbox | None, now_ns: int) -> tuple[Asked, Prepared] | None:
        """Go on with what was begun; what came of it once the control process has it, or it is refused."""
        if self._asked is None:
            return None
        reason = self._step(mailbox, now_ns)
        if reason is None:
            return None
        asked, self._asked, self._future = self._asked, None, None
        return asked, self._prepared._replace(reason=reason)

    def _step(self, mailbox: Mailbox | None, now_ns: int) -> str | None:
        """Why it is refused; "": the control process has it; None: neither yet."""
        assert self._asked is not None
        if mailbox is None or not self._asked.connection.open:
            return "the control process, or who asked, is gone"
        if now_ns > self._until_ns:
            return f"it is not ready after {PATIENCE_NS * 1e-9:g} s"
        if self._future is not None:
            return self._hand_on(self._future, mailbox) if self._future.done() else None
        ready = mailbox.task_ready(self._number)
        if ready is None:
            return None
        return "" if ready else "the control process cannot take it in: is it of another version of hil?"

    def _hand_on(self, future: "Future[Prepared]", mailbox: Mailbox) -> str | None:
        self._future, self._prepared = None, future.result()
        if self._prepared.reason:
            return self._prepared.reason
        try:
            write_private(self._path, self._prepared.data)
        except OSError as error:
            return f"{self._path}: {error.strerror}"
        mailbox.post_task(self._number)
        return None


def _prepare(upload: bytes, rig: RigConfig, start: list[float], number: int, *, holds: bool) -> Prepared:
    """Everything about a task that takes time. start: where the stage stands, m by axis. holds: under torque, where a
    tick has the time to read points and not to plan.
    """
    with _refusing() as refused:
        other = rig_with_task(rig, _inflated(upload))
        loaded = loaded_task(other)
        if holds and not isinstance(loaded.plan, (AlongPath, OverCells)):
            return Prepared(f"task.kind = {other.task.kind}: while the axes hold, only paths through points are loaded")
        if found := violations(other, start):
            return Prepared(f"the task cannot begin here: {found[0].text()}")
        if beyond := excursion_problems(other):
            return Prepared(beyond[0])
        return Prepared("", task_document(other.task), other, task_bytes(number, loaded, other))
    return Prepared(refused[0])


def _prepare_law(upload: bytes, rig: RigConfig, number: int) -> Prepared:
    """Everything about a law that takes time."""
    from hil.analysis.loop_corners import loop_problems  # which a sidecar mostly never needs

    with _refusing() as refused:
        other = rig_with_law(rig, _inflated(upload))
        loaded = loaded_law(other)
        if found := loop_problems(other):
            return Prepared(found[0][:_LONGEST])
        return Prepared("", loaded.document, other, law_bytes(number, loaded))
    return Prepared(refused[0])


def _inflated(upload: bytes) -> str:
    """The document of an upload. Raises ValueError, zlib.error."""
    inflater = zlib.decompressobj()
    text = inflater.decompress(upload, MOST_TEXT)
    if not inflater.eof:
        raise ValueError(f"what was sent is damaged, or longer than {MOST_TEXT} bytes")
    return text.decode()


@contextlib.contextmanager
def _refusing() -> Iterator[list[str]]:
    """Ends what raises; the list then holds why it is refused."""
    reasons: list[str] = []
    try:
        yield reasons
    except RigError as error:
        reasons.append("; ".join(error.problems)[:_LONGEST])
    except (ValueError, ArithmeticError, zlib.error) as error:
        reasons.append(words_of(error)[:_LONGEST])
