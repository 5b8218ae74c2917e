"""The loop: what becomes of torque that waits for the wire; who lost a slot, has the rig file changed, what systemd is
told.
"""

import socket
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from drivers.bus.port import BusState, Port
from drivers.frame import ERROR, Frame, to_bytes
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, OperatorCommand, PortCounters, Tick
from hil.live import run as daemon
from hil.live.loop import ControlLoop
from hil.live.pacing import Pacer
from hil.live.watched_file import WatchedFile
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from sim_plant.scenario.language import Scenario
from tests.drivers.bus.test_port import Cable
from tests.support.paths import ROOT
from tests.support.records import kept

PAPER = ROOT / "deploy" / "rigs" / "paper.toml"
PERIOD = 1_000_000
NO_ACK = to_bytes(Frame(ERROR | 0x020, bytes(8)))
BUS_OFF = to_bytes(Frame(ERROR | 0x040, bytes(8)))
BESIDE = (
    "timing.realtime=false", "timing.allow_degraded=true", "bus.interface=local",
    "telemetry.blackbox_s=4",  # the ring of a minute, 320 MB, took half a second of every test to clear
)  # fmt: skip


class UnpoweredDrives:
    """Media of a bus where nobody acknowledges: what is sent waits; each frame earns an `answer`."""

    def __init__(self, answer: bytes, purges: list[bool]) -> None:
        self.answer = answer
        self.purges = purges  # what the coming recalls will say
        self.waiting: list[bytes] = []
        self.recalls = 0

    def open(self) -> Cable:
        drives, (near, far) = self, socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

        class Medium(Cable):
            def transmit(self, packet: bytes) -> bool:
                drives.waiting.append(packet)
                far.send(drives.answer)
                return True

            def purge(self) -> bool:
                drives.recalls += 1
                done = drives.purges.pop(0) if drives.purges else True
                if done:
                    drives.waiting.clear()
                return done

        return Medium(near, far)


def loop_beside(
    drives: UnpoweredDrives,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    *overrides: str,
    stage_clock: Callable[[], int] = time.monotonic_ns,
) -> AbstractContextManager[ControlLoop]:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(
        daemon, "open_port", lambda *_, fd, **__: Port(drives.open, fd=fd, receive_limit=32), raising=True
    )
    rig = load_rig(PAPER, [*BESIDE, *overrides])
    return daemon.control_loop(rig, PAPER.parent, WatchedFile(PAPER), stage_clock)


def run_beside(drives: UnpoweredDrives, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ticks: int, *overrides: str):
    with loop_beside(drives, tmp_path, monkeypatch, *overrides) as loop:
        loop.pacer.start()
        for _ in range(ticks):
            loop._tick()
            loop.ticks += 1
        loop.parts.ring.close()
    return loop


@pytest.mark.requirement(id="SR-6.4")
def test_commands_that_nobody_acknowledged_are_recalled_before_the_drives_get_power(tmp_path, monkeypatch):
    drives = UnpoweredDrives(NO_ACK, purges=[])
    loop = run_beside(drives, tmp_path, monkeypatch, ticks=10)
    assert loop.parts.cycle.fault is Fault.NO_ACK
    assert (drives.recalls, drives.waiting) == (1, [])


@pytest.mark.long
def test_a_recall_that_failed_is_tried_until_nothing_waits(tmp_path, monkeypatch):
    drives = UnpoweredDrives(NO_ACK, purges=[False, False])
    loop = run_beside(drives, tmp_path, monkeypatch, ticks=1000)
    assert loop.parts.cycle.fault is Fault.NO_ACK
    assert (drives.recalls, drives.waiting) == (3, [])


@pytest.mark.requirement(id="SR-6.4")
def test_after_bus_off_nothing_restarts_the_controller_but_the_operator(tmp_path, monkeypatch):
    drives = UnpoweredDrives(BUS_OFF, purges=[])
    loop = run_beside(drives, tmp_path, monkeypatch, ticks=1000)
    assert loop.parts.cycle.fault is Fault.BUS_OFF
    assert loop.parts.port.counters().state is BusState.BUS_OFF
    assert drives.recalls == 0


@pytest.mark.long
@pytest.mark.replaces_methods
@pytest.mark.parametrize("kind", CommandKind, ids=lambda kind: kind.name)
def test_after_bus_off_no_command_restarts_the_controller_but_reset(tmp_path, monkeypatch, kind):
    drives = UnpoweredDrives(BUS_OFF, purges=[])
    with loop_beside(drives, tmp_path, monkeypatch) as loop:
        rebound = []
        monkeypatch.setattr(loop._port, "rebind", lambda: rebound.append(1))
        loop.pacer.start()
        for tick in range(20):
            if tick == 10:
                loop.parts.mailbox.post(kind, 2**62)
            loop._tick()
            loop.ticks += 1
        loop.parts.ring.close()
    assert loop.parts.port.counters().state is BusState.BUS_OFF
    assert (drives.recalls, len(rebound)) == ((1, 1) if kind is CommandKind.RESET else (0, 0))


@pytest.mark.long
def test_the_loop_is_woken_ahead_as_far_as_the_rig_file_lets_it(tmp_path, monkeypatch):
    ahead = [
        run_beside(UnpoweredDrives(NO_ACK, []), tmp_path, monkeypatch, 50, f"timing.wake_ahead_s={most}").pacer.ahead_ns
        for most in (0, 100e-9, 5e-5)
    ]
    assert ahead[:2] == [0, 100]
    assert 100 < ahead[2] <= 50_000


def slots_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: list[int], ticks: list[tuple[int, int]]):
    """(own, the host's). late: CPU time, ns, at each wake beyond its time. ticks: (time, CPU time) of each, ns."""
    now, cpu, wakes, works = 0, 0, iter(late), iter([part for work in ticks for part in (work, *[(0, 0)] * 5)])

    def pass_time(ns: int, cpu_ns: int) -> int:
        nonlocal now, cpu
        now, cpu = now + ns, cpu + cpu_ns
        return now

    def sleep_until(instant: int) -> None:
        pass_time(max(instant - now, 0), 0)
        stall = next(wakes, 0)
        pass_time(stall, stall)

    drives = UnpoweredDrives(NO_ACK, [])
    # Each tick reads the stages' clock six times.
    with loop_beside(drives, tmp_path, monkeypatch, stage_clock=lambda: pass_time(*next(works))) as loop:
        loop.cpu_clock = lambda: cpu
        loop.pacer = Pacer(PERIOD, now=lambda: now, sleep_until=sleep_until)
        loop.pacer.start()
        for _ in range(len(ticks)):
            loop._tick()
        loop.parts.ring.close()
    return loop.ledger.own, loop.ledger.host


@pytest.mark.long
def test_a_tick_answers_for_what_it_computed_and_not_for_the_wait_before_it(tmp_path, monkeypatch):
    quick = (50_000, 50_000)
    computed = [quick, (2_500_000, 2_500_000), quick, quick]
    assert slots_lost(tmp_path, monkeypatch, [], computed) == (2, 0)
    interrupted = [quick, (2_500_000, 50_000), quick, quick]
    assert slots_lost(tmp_path, monkeypatch, [], interrupted) == (0, 2)
    # A host that stops the core inside the wait and is believed to have computed there; the tick then ends late.
    stalled = [quick, (700_000, 50_000), quick, quick]
    assert slots_lost(tmp_path, monkeypatch, [0, 450_000, 0], stalled) == (0, 1)
    assert slots_lost(tmp_path, monkeypatch, [0, 2_450_000, 450_000, 0], stalled) == (0, 4)


class Script:
    """A lockstep run's ticks in place of a bus, a mailbox and a clock: what came in, and when the loop is to wake."""

    skipped = overrun = sleeps = task_posted = mended = 0

    def mend(self) -> None:
        """Nobody cuts this mailbox short."""

    def __init__(self, ticks: list[tuple[Tick, list[Frame]]]) -> None:
        self._ticks, self.sent = iter(ticks), []
        self.period_ns = PERIOD

    def wait(self) -> None:
        self.tick, self.frames = next(self._ticks)
        self.index, self.scheduled_ns, self.now_ns = self.tick.index, self.tick.scheduled_ns, self.tick.now_ns
        self.sent.append([])

    def drain(self, now_ns: int) -> list[Frame]:
        assert now_ns == self.now_ns
        return self.frames

    def send(self, frame: Frame) -> None:
        self.sent[-1].append(frame)

    def counters(self) -> PortCounters:
        return self.tick.port

    def poll(self) -> tuple[OperatorCommand, ...]:
        return self.tick.commands

    def recorder_ok(self, now_ns: int) -> bool:
        return self.tick.recorder_ok

    def purge(self) -> bool:
        return True

    def rebind(self) -> None: ...

    @property
    def members(self) -> "tuple[Script]":
        return (self,)


OF_THE_SHELL = ("cpu_ns", "run_delay_ns", "missed_own", "missed_host", "longest_streak")


@pytest.mark.replaces_methods
def test_the_loop_does_what_lockstep_does_with_the_same_ticks(tmp_path, monkeypatch):
    """Bring-up, task, a silent drive, a reset, a drive fault, stop: every frame and every record, but for times."""
    fault = {"kind": "drive_fault", "axis": "y", "at_tick": 420, "duration_ticks": 5}
    silent = {"kind": "encoder_silent", "axis": "x", "at_tick": 200, "duration_ticks": 30}
    said = {60: CommandKind.ACTIVATE, 300: CommandKind.RESET, 380: CommandKind.ACTIVATE, 500: CommandKind.RESET}
    said |= {580: CommandKind.HOME, 640: CommandKind.STOP, 700: CommandKind.SHUTDOWN}
    ticks, results = [], []

    def observe(tick, frames, result):
        ticks.append((tick, list(frames)))
        results.append((list(result.frames), kept(result.record)))

    rig = load_rig(PAPER, ["timing.realtime=false", "timing.allow_degraded=true", "bus.interface=local"])
    run = LockstepRun(
        rig, PAPER.parent, operator=lambda run, index: [said[index]] if index in said else [], observer=observe,
        scenario=Scenario.model_validate({"fault": [fault, silent]}),
    )  # fmt: skip
    states = []
    for _ in range(720):
        run.tick()
        states.append(run.cycle.state)
    assert {State.ACTIVE, State.HOMING, State.STOPPING, State.FAULT, State.SHUTDOWN} <= set(states)
    records = []
    with loop_beside(UnpoweredDrives(NO_ACK, []), tmp_path, monkeypatch) as loop:
        script = Script(ticks)
        loop.pacer = loop._port = loop._mailbox = script
        loop._realtime_ok = True
        ring, append = loop._ring, loop._ring.append
        monkeypatch.setattr(ring, "append", lambda record: (records.append(kept(record)), append(record)))
        for _ in range(len(ticks)):
            loop._tick()
            loop.ticks += 1
        assert loop.stop, "the operator's shutdown ends the process"
        ring.close()
    assert script.sent == [frames for frames, _ in results]
    for mine, (_, lockstep) in zip(records, results, strict=True):
        for name in OF_THE_SHELL:
            mine[name] = lockstep[name]
        if loop.stop and mine["index"] > 700:
            mine["flags"] &= ~1 & 0xFFFFFFFF  # from then on the loop's own stop is set, too
        assert mine.tobytes() == lockstep.tobytes(), mine["index"]
