"""`hil run RIG`: the control process. Sets up, runs the loop, and says how it ended.

Exit status: 0 stopped as asked, zero torque sent last; 69 no bus, or the rig is being run already. 70 the cycle failed
(sending stopped at once, the drives' watchdogs act). 77 the kernel refused real time and [timing] allow_degraded is
false; 78 the rig file is wrong (no bus was touched).
"""

import argparse
import contextlib
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NoReturn

from drivers.base.runtime import RuntimeDirectoryError, stop_signals
from drivers.bus.port import Port, PortError, open_port
from drivers.protocols.base import HostProtocol, echo_ids
from hil.analysis.feasibility import unit_questions
from hil.analysis.stability import refuse_unstable
from hil.cli.exit_status import EXIT_CONFIG, EXIT_REALTIME, EXIT_SOFTWARE, EXIT_UNAVAILABLE
from hil.events.notes import NoteWriter
from hil.live.goal_page import GoalPage
from hil.live.journal import Journal
from hil.live.kept_learnt import keep, with_kept
from hil.live.loop import ControlLoop, Parts, TimedCycle
from hil.live.mailbox import Mailbox
from hil.live.realtime import claim
from hil.live.ring import RingError, RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_line import RigInUseError, StopLine
from hil.live.systemd import Notifier
from hil.live.timing_record import TimingRecorder, read_timing
from hil.live.watched_file import WatchedFile
from hil.rig.baseline_file import read_baseline
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.file import load_rig
from hil.rig.former_keys import show_former_keys
from hil.rig.provenance import describe_run
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import by_name


class RealtimeRefusedError(Exception):
    """The kernel refused what [timing] asks for, and the rig file does not allow to go on without."""


def main(words: Sequence[str]) -> NoReturn:
    """The command, without its name. It reads its words with argparse, so that no command-line library (typer, rich) is
    ever in the control process.
    """
    asked = _parser().parse_args(words)
    show_former_keys()
    clock = time.thread_time_ns if asked.cpu_clock else time.monotonic_ns
    sys.exit(run_rig(by_name("rigs", asked.rig), asked.overrides, asked.ticks, clock, fresh=asked.fresh))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hil run",
        description="Run the control process of RIG until it is told to stop (SIGTERM, SIGINT, SIGHUP, or an "
        "operator's shutdown).",
    )
    parser.add_argument("rig", metavar="RIG", type=Path, help="rig file")
    parser.add_argument(
        "--set", metavar="KEY=VALUE", dest="overrides", action="append", default=[], help="overrides the rig file"
    )
    parser.add_argument("--ticks", metavar="N", type=_count, help="stop after so many ticks (at least 1)")
    parser.add_argument(
        "--fresh", action="store_true", help="begin without what the law has learnt in earlier runs of this rig"
    )
    parser.add_argument("--cpu-clock", action="store_true", help=argparse.SUPPRESS)  # stages in CPU time; benchmarks
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number of at least 1")
    return int(text)


def run_rig(
    path: Path, overrides: list[str], ticks: int | None, stage_clock: Callable[[], int], *, fresh: bool = False
) -> int:
    """Validate, set up, loop, keep what was learnt; returns the exit status."""
    try:
        watched = WatchedFile(path)  # before the file is read: a change in between is a change
        config, layout = validated(path, overrides)
        config, learnt = with_kept(config, fresh=fresh)
        if learnt:
            print(f"hil run: {learnt}", flush=True)
        with control_loop(config, path.parent, watched, stage_clock, layout) as loop:
            return _run_to_end(loop, ticks)
    except RigError as error:
        return _refuse(EXIT_CONFIG, error.problems)
    except RealtimeRefusedError as error:
        return _refuse(EXIT_REALTIME, [str(error)])
    except (PortError, RingError, RigInUseError, RuntimeDirectoryError, OSError) as error:
        return _refuse(EXIT_UNAVAILABLE, [str(error)])


def _refuse(status: int, problems: list[str]) -> int:
    for problem in problems:
        print(f"hil run: {problem}", file=sys.stderr)
    return status


def validated(path: Path, overrides: list[str]) -> tuple[RigConfig, HostProtocol]:
    """The rig and its layout, with everything checked that can be checked before a bus is touched. Raises RigError."""
    config = load_rig(path, overrides)
    try:
        layout = refuse_unschedulable(config, path.parent)
    except ValueError as error:
        raise RigError([f"{path}: {error}"]) from None
    if doubtful := [*encoder_range_problems(config, layout), *unit_questions(config)]:
        raise RigError([f"{path}: {problem}" for problem in doubtful])
    try:
        refuse_unstable(config)
    except ValueError as error:
        raise RigError([f"{path}: {error}"]) from None
    return config, layout


@contextlib.contextmanager
def control_loop(
    rig: RigConfig,
    base_dir: Path,
    rig_file: WatchedFile,
    stage_clock: Callable[[], int],
    layout: HostProtocol | None = None,
) -> Iterator[ControlLoop]:
    """All the loop needs, in the order in which it may fail; real time after every import and large allocation."""
    files = runtime_paths(rig.name)
    try:
        cycle = TimedCycle(rig, base_dir, stage_clock, layout)
    except ValueError as error:  # a task, law or filter this rig cannot have; no bus is open yet
        raise RigError([str(error)]) from None
    with contextlib.ExitStack() as stack:
        # Before a bus, core, priority or memory is asked for: a second control process must not disturb the first.
        stop_line = stack.enter_context(StopLine(files.directory))
        journal = Journal(files)  # before real time and locked memory, none of which is for it
        stack.callback(journal.leave)
        port = _open_bus(rig, cycle.protocol)
        stack.callback(port.close)
        notifier = Notifier()
        stack.callback(notifier.close)
        held = claim(rig.timing)
        stack.callback(held.close)
        verdict = held.verdict.text()
        if not held.verdict.ok and not rig.timing.allow_degraded:
            raise RealtimeRefusedError(f"{verdict}. To run all the same: --set timing.allow_degraded=true")
        metadata = describe_run(rig, base_dir, realtime=verdict, baseline=read_baseline(rig))
        ring = RingWriter(files.ring, rig.ring_slots, period_ns=rig.period_ns, metadata=metadata)
        mailbox = Mailbox.create(files.mailbox)
        stack.callback(mailbox.close)
        goals = GoalPage.create(files.goals)
        stack.callback(goals.close)
        timing = TimingRecorder(files.timing, rig.period_ns, realtime_ok=held.verdict.ok, verdict=verdict)
        notes = NoteWriter(files.notes)
        print(f"hil run: {rig.name} at {rig.rate_hz:g} Hz on {', '.join(rig.bus.channels)}; {verdict}", flush=True)
        yield ControlLoop(
            Parts(
                cycle,
                port,
                ring,
                mailbox,
                goals,
                stop_line,
                timing,
                held,
                rig_file,
                notifier,
                notes,
                files.task,
                journal,
            ),
            stage_clock,
        )


def _open_bus(rig: RigConfig, layout: HostProtocol) -> Port:
    """The rig's bus. Raises PortError."""
    if rig.bus.segments:
        from drivers.bus.segmented_port import open_segments  # which no other rig needs

        return open_segments(rig.bus, role="host", fd=layout.fd, echo_ids=echo_ids(layout))
    return open_port(rig.bus, role="host", fd=layout.fd, echo_id=layout.echo_id)


def _run_to_end(loop: ControlLoop, ticks: int | None) -> int:
    """Loop until stopped. What the cycle raises is shown once no more frames go out, and is never hidden."""

    def ask_to_stop(_signal: int, _frame: object) -> None:
        loop.stop = True

    for number in stop_signals():
        signal.signal(number, ask_to_stop)
    try:
        loop.run(ticks)
    except BaseException:
        loop.parts.port.close()
        print("hil run: the control cycle failed; nothing is sent any more", file=sys.stderr)
        traceback.print_exc()
        return EXIT_SOFTWARE  # without an end mark in the ring: it is kept as the black box
    cycle, pacer = loop.parts.cycle, loop.pacer
    loop.parts.notes.write(cycle, pacer.index, pacer.now_ns)  # said since the last chore, or under torque
    loop.parts.ring.close()
    loop.parts.timing.show()
    _say_farewell(loop)
    _keep_learnt(loop)
    loop.parts.journal.end()
    if loop.overstayed:
        print("hil run: the cycle did not come to a stop in time; sending was ended without it", file=sys.stderr)
        return EXIT_SOFTWARE
    return 0


def _say_farewell(loop: ControlLoop) -> None:
    """The stop went well even where the terminal or the runtime directory is gone, and nobody can be told."""
    try:
        if loop.parts.cycle.law.failure:
            print(f"hil run: {loop.parts.cycle.law.failure}", file=sys.stderr, flush=True)
        print(_summary(loop), flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else what is left fails again at exit


def _keep_learnt(loop: ControlLoop) -> None:
    axes, rig = loop.parts.cycle.axes, loop.parts.cycle.rig
    axes.keep()
    try:
        keep(rig, axes.kept())
    except (OSError, RuntimeDirectoryError) as error:
        with contextlib.suppress(OSError):
            print(f"hil run: what was learnt is not kept: {error}", file=sys.stderr, flush=True)


def _summary(loop: ControlLoop) -> str:
    timing = read_timing(loop.parts.timing.path)
    late, cpu = (timing.summary()[metric] for metric in ("lateness", "cpu"))
    ledger = loop.ledger
    return (
        f"hil run: {loop.ticks} ticks; lateness p50 {late['p50']:.0f} p99 {late['p99']:.0f} max {late['max']:.0f} us; "
        f"CPU p50 {cpu['p50']:.0f} p99 {cpu['p99']:.0f} us; slots lost: {ledger.own} own, {ledger.host} the host's"
    )
