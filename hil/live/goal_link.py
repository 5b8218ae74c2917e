"""How a client on this machine moves a running rig: goals by the goal page, what they come to by the ring buffer.

Rules:
- A client reads what the control process itself recorded. Nothing in between can say otherwise.
- The lease is kept by a thread of its own, so that a client may think between two goals. It ends with the process.
"""

import contextlib
import threading
import time
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.base.runtime import make_private
from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, MotionError, MotionWord, Refusal
from hil.cycle.limits import motion_windows
from hil.cycle.state_machine import State
from hil.live.goal_page import LEASE_NS, GoalPage, GoalPageError
from hil.live.mapped_file import Closing
from hil.live.ring import RingError, RingReader
from hil.rig.file import build_rig
from hil.rig.schema import RigConfig, TaskConfig

VERDICT_S: Final = 1.0  # that a client waits for the tick that takes its goal
SILENT_S: Final = 1.0  # without a tick: the control process hangs or is gone
IN_POSITION_S: Final = 0.02
_POLL_S: Final = 2e-4
FIELDS: Final = ("state", "fault", "motion", "goal_number", "setpoint_position", "setpoint_velocity", "position")


class Look(NamedTuple):
    """The newest tick. number: of the goal accepted last. setpoint, its velocity, position: m, m/s (rad), by axis.
    in_position: the set-points have rested for IN_POSITION_S, with every encoder within axes.NAME.motion.window.
    """

    state: State
    fault: Fault
    motion: MotionWord
    number: int
    setpoint: list[float]
    velocity: list[float]
    position: list[float]
    in_position: bool


class GoalLink(Protocol):
    """What moves a rig, running or simulated. All raise MotionError where the rig is gone or the lease is."""

    rig: RigConfig

    def take(self, *, by_force: bool = False) -> None:
        """Become the one who sends goals."""

    def send(self, goal: Goal) -> tuple[int, Refusal]:
        """Send a goal and wait for the tick that takes it; its number, and what refused it."""

    def load_task(self, task: TaskConfig) -> None:
        """Load another task of this rig, which a PATH goal begins. Raises MotionError with why it is refused."""

    def look(self) -> Look:
        """The newest tick."""

    def now_ns(self) -> int:
        """The rig's time."""

    def wait(self, seconds: float) -> None:
        """Let time pass, at least a tick."""

    def leave(self) -> None:
        """Give the lease back."""


class TickReader:
    """Makes a Look of the last ticks' records."""

    def __init__(self, rig: RigConfig) -> None:
        self._windows = np.array(motion_windows(rig))
        self.ticks = max(1, round(IN_POSITION_S * 1e9 / rig.period_ns))

    def look(self, records: NDArray[np.void]) -> Look:
        """Of the newest of the records, (ticks,), which may be fewer than `ticks`."""
        newest, n = records[-1], len(self._windows)
        return Look(
            State(int(newest["state"])),
            Fault(int(newest["fault"])),
            MotionWord(int(newest["motion"])),
            int(newest["goal_number"]),
            newest["setpoint_position"][:n].tolist(),
            newest["setpoint_velocity"][:n].tolist(),
            newest["position"][:n].tolist(),
            len(records) >= self.ticks and bool(self.near(records).all()),
        )

    def near(self, records: NDArray[np.void]) -> NDArray[np.bool_]:
        """Ticks, (ticks,), in which the axes hold, each within its window."""
        n = len(self._windows)
        off = np.abs(records["position"][:, :n] - records["setpoint_position"][:, :n])
        found: NDArray[np.bool_] = (records["motion"] == MotionWord.HOLD) & (off <= self._windows).all(axis=1)
        return found


class PageLink(Closing):
    """A running rig, by the files in its runtime directory. Raises MotionError, RuntimeDirectoryError."""

    def __init__(self, directory: Path) -> None:
        make_private(directory)  # nobody else can have put a page there
        self._name = directory.name
        with contextlib.ExitStack() as undo:
            try:
                self._ring = undo.enter_context(RingReader(directory / "ring"))
            except RingError as error:
                raise MotionError(f"{self._name} does not run here: {error}") from None
            if not self._ring.writer_alive:
                raise MotionError(f"{self._name} does not run here: its control process has ended")
            self._page = undo.enter_context(GoalPage(directory / "goals"))
            undo.pop_all()
        self.rig = build_rig(dict(self._ring.metadata["rig"]), carried=True)
        self._reader = TickReader(self.rig)
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._beats: threading.Thread | None = None
        self._seen, self._seen_ns = -1, time.monotonic_ns()

    def look(self) -> Look:
        """The newest tick. Raises MotionError where there are none any more."""
        written, now_ns = self._ring.written, time.monotonic_ns()
        if written != self._seen:
            self._seen, self._seen_ns = written, now_ns
        elif now_ns - self._seen_ns > SILENT_S * 1e9:
            raise MotionError(f"{self._name}: the control process has run no tick for {SILENT_S:g} s")
        while written:
            ticks = min(written, self._reader.ticks)
            records = self._ring.look(written - ticks, ticks, FIELDS).records
            if len(records):
                return self._reader.look(records)
            written = self._ring.written
        raise MotionError(f"{self._name}: the control process has run no tick yet")

    def holder(self) -> str:
        """Who moves the rig now, in words; "" nobody."""
        found = self._page.holder()
        return "" if found is None else found.holder

    def take(self, *, by_force: bool = False) -> None:
        """Raises GoalPageError where somebody else moves the rig."""
        self._page.take_lease(by_force=by_force)
        self._beats = threading.Thread(target=self._keep, name="goal lease", daemon=True)
        self._beats.start()

    def _keep(self) -> None:
        while not self._ended.wait(LEASE_NS * 0.25e-9):
            try:
                with self._lock:
                    self._page.beat()
            except GoalPageError:
                return

    def send(self, goal: Goal) -> tuple[int, Refusal]:
        """Raises MotionError where the lease has ended, or no tick takes the goal."""
        with self._lock:
            number = self._page.post(goal)
        until = time.monotonic() + VERDICT_S
        while (refusal := self._page.verdict(number)) is None:
            if time.monotonic() > until:
                gone = "has ended" if self._page.replaced or not self._ring.writer_alive else "does not answer"
                raise MotionError(f"{self._name}: the control process {gone}")
            time.sleep(_POLL_S)
        return number, refusal

    def now_ns(self) -> int:
        """This machine's monotonic clock."""
        return time.monotonic_ns()

    def wait(self, seconds: float) -> None:
        """Raises MotionError where somebody else has taken the lease, or it was revoked."""
        time.sleep(max(seconds, self._ring.period_ns * 1e-9))
        if self._beats is not None and not self._beats.is_alive():
            raise MotionError(f"{self._name}: the lease has ended{self._by_whom()}")

    def _by_whom(self) -> str:
        now = self.holder()
        if now:
            return f": {now} has taken it"
        which = f"a stop, a fault, or a second without word of this program; hil events {self._name} tells which"
        return f"; the rig is {self.look().state.name}: {which}"

    def leave(self) -> None:
        """Give the lease back; the plan in hand goes on to its rest."""
        self._ended.set()
        if self._beats is not None:
            self._beats.join()
            self._beats = None
        self._page.give_back()

    def close(self) -> None:
        """Leave, and let go of the files."""
        self.leave()
        self._ring.close()
        self._page.close()
