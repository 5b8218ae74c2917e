"""Events of live processes: the journal's lines without a sidecar; then all the rest from one that joined late."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from hil.cycle.fault_table import ROWS, Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import runtime_paths
from hil.runs.summary import load_run, summarise
from hil.telemetry.command_client import local_client
from hil.telemetry.events_pb2 import Event, Events
from hil.telemetry.session import client_config
from tests.support.live_rig import CALM, PAPER, PATIENCE_S, Control, emulated, order
from tests.telemetry.test_sidecar import free_endpoint

pytestmark = pytest.mark.live


class LiveSidecar:
    """`hil sidecar` of the rig, with its recordings in a folder."""

    def __init__(self, out: Path) -> None:
        self.out, self.endpoint = out, free_endpoint()
        sets = [part for override in CALM for part in ("--set", override)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil", "sidecar", str(PAPER), *sets, "--out", str(out), "--listen", self.endpoint],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self.process.stdout
        assert "listening" in self.process.stdout.readline()

    def end(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode


@pytest.fixture
def sidecar(tmp_path: Path) -> Iterator[LiveSidecar]:
    started = LiveSidecar(tmp_path / "out")
    yield started
    if started.process.poll() is None:
        started.process.kill()
        started.process.communicate()


def latched(events: list[Event]) -> list[Event]:
    return [event for event in events if event.kind == Event.FAULT_LATCHED]


def asked(endpoint: str, wanted: Callable[[list[Event]], list[Event]] = latched) -> list[Event]:
    """What a plain Zenoh client that joins now is told, once there is something wanted."""
    until = time.monotonic() + PATIENCE_S
    with zenoh.open(client_config(endpoint)) as session:
        while time.monotonic() < until:
            for reply in session.get("hil/*/events", timeout=5.0):
                if reply.ok and wanted(found := list(Events.FromString(reply.ok.payload.to_bytes()).events)):
                    return found
            time.sleep(0.05)
    raise AssertionError("it was not told")


@pytest.mark.requirement(id="SR-9.1")
def test_without_a_sidecar_the_journal_has_the_fault_and_the_ring_has_it_for_hil_events() -> None:
    with emulated() as emulator, Control() as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        emulator.stop()
        control.wait_for(State.FAULT, reader)
        words = [sys.executable, "-m", "hil", "events", "paper", "--json"]
        shown = subprocess.run(words, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
        control.process.send_signal(signal.SIGTERM)
        status, _, err = control.finish()
    assert status == 0
    told = [json.loads(line) for line in shown.stdout.splitlines()]
    last = [event for event in told if event["kind"] == "FAULT_LATCHED"][-1]
    assert last["name"] in ("encoder_lost", "drive_watchdog", "no_ack")
    assert last["line"] in err.splitlines()
    text = ROWS[Fault[last["name"].upper()]]
    cause = last["cause"].partition("; after ")[0]
    assert cause == text.cause or cause.startswith(("no axis answers: the bus is cut", "this computer was too busy"))
    assert last["action"].endswith("hil command paper reset")
    assert "shutdown" in err.lower()  # the end itself is told, too


def test_whoever_joins_late_is_told_what_the_journal_and_the_recording_say(sidecar: LiveSidecar) -> None:
    with emulated() as emulator, Control() as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        emulator.stop()
        control.wait_for(State.FAULT, reader)
        events = asked(sidecar.endpoint)
        shown = subprocess.run(
            [sys.executable, "-m", "hil", "events", "paper", "--connect", sidecar.endpoint],
            capture_output=True,
            text=True,
            check=True,
            timeout=PATIENCE_S,
        )
        control.process.send_signal(signal.SIGTERM)
        _, _, err = control.finish()
    assert sidecar.end() == 0
    fault = latched(events)[-1]
    assert [event.sequence for event in events] == list(range(len(events)))
    assert fault.line in err.splitlines()
    assert fault.line in shown.stdout.splitlines()
    summary = summarise(load_run(sidecar.out / "run.mcap"))
    assert fault.line in [event["line"] for event in summary["events"]]
    assert summary["latched"]["line"] == fault.line
    assert abs(fault.wall_ns - time.time_ns()) < 3600e9


def test_a_sidecar_killed_and_started_again_tells_the_fault_of_the_time_between(sidecar: LiveSidecar) -> None:
    with emulated() as emulator, Control() as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        sidecar.process.kill()
        sidecar.process.communicate()
        emulator.stop()
        control.wait_for(State.FAULT, reader)
        again = LiveSidecar(sidecar.out / "again")
        try:
            fault = latched(asked(again.endpoint))[-1]
        finally:
            again.end()
        control.process.send_signal(signal.SIGTERM)
        _, _, err = control.finish()
    assert fault.line in err.splitlines()


def test_what_the_sidecar_alone_knows_is_told_too(tmp_path: Path) -> None:
    """A recording that cannot be written, a request that was refused and why, a control process that was killed."""
    (tmp_path / "file").write_text("in the way")
    sidecar = LiveSidecar(tmp_path / "file" / "out")
    try:
        with emulated(), Control() as control:
            control.wait_for(State.READY)
            with local_client(runtime_paths("paper").directory) as client:
                until = time.monotonic() + PATIENCE_S
                while (verdict := client.command(CommandKind.STOP)).reason.startswith("no control process"):
                    assert time.monotonic() < until  # the sidecar has not found it yet
                assert not verdict.accepted
            control.process.kill()

            def killed(events: list[Event]) -> list[Event]:
                return [event for event in events if event.kind == Event.SIDECAR and "was killed" in event.name]

            events = asked(sidecar.endpoint, killed)
    finally:
        sidecar.end()
    request = [event for event in events if event.kind == Event.REQUEST][-1]
    assert request.name == "STOP refused"
    assert verdict.reason in request.cause
    assert "uid" in request.cause
    recorder = next(event for event in events if event.kind == Event.RECORDER)
    assert str(tmp_path / "file" / "out") in recorder.name
    assert recorder.value == 1.0
    assert all(event.action for event in events)


def running(pid: int) -> bool:
    try:
        return b"hil.live.teller" in Path(f"/proc/{pid}/cmdline").read_bytes()  # a zombie has none
    except OSError:
        return False


def child_of(parent: int) -> int:
    """The child that tells, as soon as it is there."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            if running(int(pid)):
                return int(pid)
    raise AssertionError("there is none")


def test_a_run_that_is_told_to_end_at_once_is_told_whole() -> None:
    """The child that tells is slower to start than such a run is to end; a terminal's signals reach it, too."""
    with emulated(), Control("--ticks", "5") as control:
        teller = child_of(control.process.pid)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(teller, number)
        status, _, err = control.finish()
    assert status == 0
    assert "-> SHUTDOWN" in err
    until = time.monotonic() + PATIENCE_S
    while running(teller):
        assert time.monotonic() < until
        time.sleep(0.01)
