"""The control loop: wait for the deadline, read the bus, step the cycle, send, record. One thread and nothing else.

Rules:
- Nothing in here waits but the pacing sleep, and nothing grows.
- Whatever goes wrong in the cycle ends the loop without another frame, so that the drives' watchdogs act.
- Chores (systemd, rig file, statistics) are done a few times a second, one per tick, after the tick's frames are out.

Theory of operation: `run` repeats `_tick`, which hands the cycle (hil/cycle/step.py) what has come in since the last
one and hands on what the cycle makes of it. That is command frames to the bus, then the record to the ring, then times
to the timing record. The loop decides nothing about the stage. It ends when the cycle is in SHUTDOWN; asked to stop, it
waits for that no longer than a damped stop may take and STOP_GRACE_S. What the kernel does to the process (lateness,
lost slots, page faults) is measured here and never acted upon: skipped slots reach the cycle as a gap in the ticks'
index.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from librt.vecs import vec
from mypy_extensions import i64

from drivers.bus.counters import BusState
from drivers.bus.port import Port
from drivers.protocols.base import HostProtocol
from hil.cycle.command_desk import LOADS
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.cycle.step import RECORD, ControlCycle
from hil.cycle.tick import CommandKind, LoadedLaw, LoadedTask, OperatorCommand, Tick
from hil.events.notes import Note, NoteWriter
from hil.live.goal_page import GoalPage
from hil.live.journal import Journal
from hil.live.mailbox import Mailbox
from hil.live.miss_ledger import MissLedger
from hil.live.pacing import Pacer, run_signal_handlers, sleeper
from hil.live.realtime import Claim
from hil.live.ring import RingWriter
from hil.live.stop_line import StopLine
from hil.live.systemd import Notifier
from hil.live.task_file import TaskIntake
from hil.live.timing_record import METRICS, TimingRecorder
from hil.live.watched_file import WatchedFile
from hil.rig.schema import RigConfig

CHORE_INTERVAL_S = 0.25
STOP_GRACE_S = 1.0  # beyond what STOPPING may take; then the loop ends without the cycle's consent
_NO_AGE: Final = -1
_monotonic_ns: Final = time.monotonic_ns


class TimedCycle(ControlCycle):
    """stamps: when the tick's estimate, control, gate and record began, on `clock` (ns); see hil.cycle.step.ESTIMATE
    ...
    """

    def __init__(
        self, rig: RigConfig, base_dir: Path, clock: Callable[[], int], layout: HostProtocol | None = None
    ) -> None:
        super().__init__(rig, base_dir, layout)
        self.stamps = [0, 0, 0, 0]
        self._clock = clock

    def _mark(self, stage: int) -> None:
        self.stamps[stage] = self._clock()


class Parts(NamedTuple):
    """What the loop works with; made, and closed, by its owner."""

    cycle: TimedCycle
    port: Port
    ring: RingWriter
    mailbox: Mailbox
    goals: GoalPage
    stop_line: StopLine
    timing: TimingRecorder
    claim: Claim
    rig_file: WatchedFile
    notifier: Notifier
    notes: NoteWriter
    task_file: Path
    journal: Journal


class ControlLoop:
    """The live shell around one cycle. Set `stop` (a signal handler may) and the loop stops the stage and ends.

    stage_clock: what the stages are measured with. CLOCK_MONOTONIC costs no system call and equals CPU time while
    nobody interrupts; benchmarks pass the thread's CPU clock. cpu_clock: what a tick's CPU time is told by.
    """

    def __init__(self, parts: Parts, stage_clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.stop = False
        self.overstayed = False  # the cycle did not reach SHUTDOWN in time
        self.ticks = 0
        self.parts = parts
        rig = parts.cycle.rig
        self._cycle, self._port, self._ring, self._mailbox, self._goals, self._stop_line, self._timing, *_ = parts
        self._clock = stage_clock
        self.cpu_clock: Callable[[], int] = time.thread_time_ns
        alone = threading.active_count() == 1
        self.pacer = Pacer(
            rig.period_ns, sleep_until=sleeper(alone=alone), most_ahead_ns=round(rig.timing.wake_ahead_s * 1e9)
        )
        self.ledger = MissLedger(rig.period_ns)
        self._rig_ok = True
        self._realtime_ok = parts.claim.verdict.ok
        self._records = parts.cycle.records
        self._cpu_mark_ns = self._cpu_ns = 0
        self._times: vec[i64] = vec[i64]([0] * len(METRICS))  # of the tick, as METRICS
        self._told: tuple[State, tuple[Note, ...]] | None = None
        self._silent = False
        self._recall_due: list[Port] = []  # by segment, what may still hold frames
        self._next_rebind = 0
        self._task: LoadedTask | None = None  # taken in, for the LOAD_TASK that is to come
        self._law: LoadedLaw | None = None  # the same for SET_LAW
        self._intake: TaskIntake | None = None
        self._task_number = parts.mailbox.task_posted
        self._pause: tuple[Goal, ...] = ()  # of a path whose client is gone: for the next tick
        self._plan_chores(rig.period_ns)
        self._stop_ticks = round((self._cycle.supervisor.longest_stop_s + STOP_GRACE_S) * 1e9 / rig.period_ns)

    def _plan_chores(self, period_ns: int) -> None:
        interval = min(CHORE_INTERVAL_S, self.parts.notifier.watchdog_s / 3 or CHORE_INTERVAL_S)
        chores = (self._tell_alive, self._look_at_rig, self._take_stock, self._recover_bus, self._look_at_pages)
        self._chore_ticks = ticks = max(len(chores), round(interval * 1e9 / period_ns))
        self._chores = {(number + 1) * ticks // len(chores) - 1: chore for number, chore in enumerate(chores)}

    # the loop ---------------------------------------------------------------------------------------------------------

    def run(self, max_ticks: int | None = None) -> None:
        """Tick until the cycle is in SHUTDOWN and has sent its last zero. max_ticks: ask it to stop after so many."""
        self.pacer.start()
        self._cpu_mark_ns = self.cpu_clock()
        deadline = -1  # tick by which a stop must be over
        while True:
            self._tick()
            self.ticks += 1
            if self._cycle.state is State.SHUTDOWN:
                return
            if self.ticks == max_ticks:
                self.stop = True
            if self.stop:
                if deadline < 0:
                    deadline = self.ticks + self._stop_ticks
                elif self.ticks > deadline:
                    self.overstayed = True
                    return

    def _tick(self) -> None:
        pacer, port, mailbox, clock = self.pacer, self._port, self._mailbox, self._clock
        pacer.wait()
        woke = pacer.now_ns
        mark = self.cpu_clock()
        self._cpu_ns = mark - self._cpu_mark_ns
        self._cpu_mark_ns = mark
        began = clock()
        if pacer.skipped:
            self._book_miss()
        frames = port.drain(woke)
        estop = self._stop_line.pressed()  # before the mail: no RESET that was sent before it comes after it
        commands = mailbox.poll()
        if commands:
            self._before_commands(commands)
        goals = self._goals.poll(woke)
        tick = Tick(
            pacer.index,
            pacer.scheduled_ns,
            woke,
            port.counters(),
            commands,
            stop=self.stop,
            recorder_ok=mailbox.recorder_ok(woke),
            realtime_ok=self._realtime_ok,
            rig_ok=self._rig_ok,
            estop=estop,
            task=self._task if commands else None,
            law=self._law if commands else None,
            goals=goals or self._pause,
        )
        result = self._cycle.step(tick, frames)
        if commands:
            self._after_commands()
        sending = self._cycle.stamps[RECORD]
        for frame in result.frames:
            port.send(frame)
        sent_ns = _monotonic_ns()
        self._ring.append(result.record)
        if goals:
            self._goals.answer(self._cycle.supervisor.goals.handled)
        if self._pause:
            self._pause = ()
        if estop:
            self._stop_line.latched(self._cycle.state.name, pacer.index)
        self._measure(began, sending, clock(), sent_ns)
        if self._cycle.silent is not self._silent:
            self._silent = self._cycle.silent
            self._recall_due = list(port.members) if self._silent else []
            self._recall()
        chore = self._chores.get(self.ticks % self._chore_ticks)
        if chore is not None:
            run_signal_handlers()  # of one that came while a tick ran; those that end a sleep have been
            chore()
        elif self._intake is not None:
            self._take_task_in(self._intake)

    def _measure(self, began: int, sending: int, ended: int, sent_ns: int) -> None:
        """Time per stage, for the timing file and the next record."""
        cycle, pacer = self._cycle, self.pacer
        estimate, control, gate, _ = cycle.stamps
        read, estimated, controlled, gated = estimate - began, control - estimate, gate - control, sending - gate
        sent = ended - sending
        self._records.spent(read, estimated, controlled, gated, sent)
        age, fresh = _NO_AGE, cycle.inbox.fresh
        for axis, instant in enumerate(cycle.sampling.instants):
            if not fresh[axis]:
                age = _NO_AGE
                break
            age = max(age, sent_ns - instant)
        lateness = pacer.now_ns - pacer.scheduled_ns
        times = self._times
        times[0], times[1], times[2], times[3] = lateness, read, estimated, controlled
        times[4], times[5], times[6], times[7] = gated, sent, self._cpu_ns, age
        self._timing.note(times)

    def _book_miss(self) -> None:
        ledger = self.ledger
        ledger.book(self.pacer.skipped, self.pacer.overrun, self._cpu_ns, self.pacer.sleeps)
        self._timing.note_missed(ledger.own, ledger.host, ledger.longest)
        self._records.missed(ledger.own, ledger.host, ledger.longest, ledger.run_delay_ns)

    # chores -----------------------------------------------------------------------------------------------------------

    def _tell_alive(self) -> None:
        """To systemd and on the stop page. Only from here: whoever hears it knows that ticks are being run."""
        state = self._cycle.state
        self._stop_line.tell(state.name, self.pacer.index)
        self.parts.ring.mend()
        self._mailbox.mend()
        self._goals.mend()
        self._stop_line.tell_mended(self.parts.ring.mended + self._mailbox.mended + self._goals.mended)
        notes = self.parts.notes
        if state not in TORQUE_STATES:  # writing may wait
            notes.write(self._cycle, self.pacer.index, self.pacer.now_ns)
        if (state, notes.told) == self._told:
            self.parts.notifier.send("WATCHDOG=1")
            return
        verdict = "" if self._realtime_ok else ", real time degraded"
        told = [state.name + verdict, *(note.text for note in notes.told)]
        lines = ["WATCHDOG=1", f"STATUS={'; '.join(told)}"]
        if self._told is None:
            lines.append("READY=1")
        self.parts.notifier.send(*lines)
        self._told = state, notes.told

    def _look_at_pages(self) -> None:
        """A task or law that was sent, and who moves the rig."""
        self._look_for_task()
        self._look_at_lease()

    def _look_for_task(self) -> None:
        number = self._mailbox.task_posted
        if number != self._task_number:
            self._task_number = number
            self._intake = TaskIntake(self.parts.task_file, number, self._cycle.rig, self._cycle.axes.make_law)

    def _take_task_in(self, intake: TaskIntake) -> None:
        """A piece of the file of a task or law, while no axis moves under torque."""
        if self._cycle.state in TORQUE_STATES and not self._cycle.supervisor.at_rest:
            return
        intake.work()
        if intake.done:
            self._task, self._law, self._intake = intake.task, intake.law, None
            self._mailbox.answer_task(intake.number, ready=intake.task is not None or intake.law is not None)

    def _look_at_lease(self) -> None:
        """Outside ACTIVE nobody moves the rig. A path whose client is gone pauses; every other plan ends by itself."""
        if self._cycle.state is not State.ACTIVE:
            self._goals.revoke()
        elif self._cycle.supervisor.goals.word is MotionWord.PATH and self._goals.lost(self.pacer.now_ns):
            self._pause = (Goal(0, GoalKind.RATE, speed=0.0),)

    def _look_at_rig(self) -> None:
        self._rig_ok = self.parts.rig_file.unchanged()

    def _take_stock(self) -> None:
        self.ledger.take_stock(self.pacer.sleeps)
        self._timing.note_usage(self.ledger.total_run_delay_ns, self.parts.claim.collector_runs[0])

    def _recall(self) -> None:
        """The bus is to stay silent: what still waits for the wire must not move a drive that gets its power back.

        Tried until it works. An interface that is down holds nothing; a controller in bus-off would be restarted by
        this, which is for the operator's reset.
        """
        self._recall_due = [port for port in self._recall_due if not _is_recalled(port)]

    def _recover_bus(self) -> None:
        """Look once a second for an interface that is gone; nothing moves meanwhile, so a slow call does no harm."""
        self._recall()
        if self._port.counters().state is not BusState.DOWN or self._cycle.state in TORQUE_STATES:
            return
        if self.ticks >= self._next_rebind:
            self._next_rebind = self.ticks + round(1e9 / self.pacer.period_ns)
            for port in self._port.members:
                if port.counters().state is BusState.DOWN:
                    port.rebind()

    def _after_commands(self) -> None:
        """An operator's shutdown that the cycle has accepted ends this process as SIGTERM does."""
        handled = self._cycle.commands.handled
        if any(c.kind in LOADS for c, _ in handled):
            self._task = self._law = None  # whatever became of it
        if self._cycle.state is not State.ACTIVE:
            self._goals.revoke()
        self.stop = self.stop or any(c.kind == CommandKind.SHUTDOWN and accepted for c, accepted in handled)

    def _before_commands(self, commands: tuple[OperatorCommand, ...]) -> None:
        """A controller in bus-off is restarted by nobody but the operator, and without the torques it still holds."""
        if self._port.counters().state < BusState.BUS_OFF or self._cycle.state in TORQUE_STATES:
            return
        if any(command.kind == CommandKind.RESET for command in commands):
            for port in self._port.members:
                if port.counters().state >= BusState.BUS_OFF:
                    _clear(port)


def _is_recalled(port: Port) -> bool:
    """Whether a segment holds no frame of ours any more."""
    state = port.counters().state
    if state is BusState.DOWN:
        return True
    if state is BusState.BUS_OFF:
        return False
    return _clear(port)


def _clear(port: Port) -> bool:
    """Take back what waits in a segment and open it anew; False: something may still wait."""
    purged = port.purge()
    port.rebind()
    return purged
