"""What `hil demo` makes of what it hears: whose stop it was, what may be reset, and what it says at its end."""

import contextlib
import io
import json
import shlex
import signal
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from rich.console import Console

from drivers.protocols.base import DriveStatus
from hil.cli.exit_status import EXIT_FAULT
from hil.cycle.axis_homing import HOMING_REQUIRED
from hil.cycle.tick import CommandKind
from hil.operate import demo as demo_module
from hil.operate import demo_live, demo_virtual
from hil.operate.demo_live import Demo, Scene, Signals, TooBusyError, drive_report
from hil.operate.stalls import by_this_computer
from hil.rig.file import load_rig
from hil.runs.summary import load_run
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import RigClient
from hil.telemetry.command_client import Verdict
from tests.operate.test_demo import IDEAL, hil
from tests.support.paths import ROOT

RIG = ROOT / "deploy" / "rigs" / "microscope.toml"


class Conversation:
    """A sidecar that shows the given statuses one by one and takes every command, of which it remembers."""

    def __init__(self, *statuses: pb.Status) -> None:
        self.statuses = list(statuses)
        self.heard: list[CommandKind] = []

    def status(self) -> pb.Status:
        return self.statuses.pop(0)

    def events(self) -> list[pb_events.Event]:
        return []

    def command(self, kind: CommandKind) -> Verdict:
        self.heard.append(kind)
        return Verdict(True, "", "-")


def test_a_watchdog_that_tripped_before_anything_moved_is_reset_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive that this machine left without commands in CONNECTED holds the rig there, with no fault to be seen."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # those of this process are pytest's
    rig = load_rig(RIG)
    said = Console(record=True, width=120, file=io.StringIO())
    scene = Scene(rig, RIG, (), tmp_path, tmp_path)
    axes = list(rig.axes)
    healthy = [int(DriveStatus.HOMED)] * len(axes)
    tripped = [*healthy[:-1], int(DriveStatus.HOMED | DriveStatus.WATCHDOG)]
    waits = pb.Status(state="CONNECTED", fault="NONE", axes=axes, drive_status=healthy)
    held = pb.Status(state="CONNECTED", fault="NONE", axes=axes, drive_status=tripped, index=70)
    ready = pb.Status(state="READY", fault="NONE", axes=axes, drive_status=healthy, recording=True)
    conversation = Conversation(waits, held, held, waits, ready)
    client = cast(RigClient, conversation)
    monkeypatch.setattr(demo_live, "local_client", lambda _: contextlib.nullcontext(conversation))
    demo = Demo(scene, said, Signals(), insists=True, holds=False)
    while conversation.statuses:
        demo._look(client)
    assert conversation.heard == [CommandKind.RESET, CommandKind.RESET, CommandKind.ACTIVATE]
    assert demo.stalls == 1
    assert "this computer was too busy: a drive's watchdog tripped at tick 70" in said.export_text()


def test_a_rig_that_an_operator_stopped_stays_so_until_an_operator_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    said = Console(record=True, width=120, file=io.StringIO())

    def state(name: str) -> pb.Status:
        return pb.Status(state=name, fault="NONE", recording=True)

    stopped = [state(name) for name in ("READY", "ACTIVE", "STOPPING", "READY", "READY")]
    homed = [state(name) for name in ("HOMING", "READY", "CONNECTED", "READY")]
    conversation = Conversation(*stopped, *homed, state("ACTIVE"), state("CONNECTED"), state("READY"))
    monkeypatch.setattr(demo_live, "local_client", lambda _: contextlib.nullcontext(conversation))
    demo = Demo(Scene(load_rig(RIG), RIG, (), tmp_path, tmp_path), said, Signals(), insists=True, holds=True)
    heard = []
    while conversation.statuses:
        demo._look(cast(RigClient, conversation))
        heard.append(len(conversation.heard))
    assert conversation.heard == [CommandKind.ACTIVATE_HOLD] * 2
    assert heard == [1] * 11 + [2], "at first, and in the end, when the operator had let it go on"
    assert "stopped by an operator; to go on: hil command microscope activate-hold" in said.export_text()


class Unhomed(Conversation):
    """A rig that is ACTIVE only once it is homed. completes: HOMING comes to its end, nobody stops it."""

    def __init__(self, *statuses: pb.Status, completes: bool) -> None:
        super().__init__(*statuses)
        self._completes = completes

    def command(self, kind: CommandKind) -> Verdict:
        homed = self._completes and CommandKind.HOME in self.heard
        super().command(kind)
        refused = kind is CommandKind.ACTIVATE and not homed
        return Verdict(not refused, f"refused: {HOMING_REQUIRED}: x" if refused else "", "-")


@pytest.mark.parametrize("completes", [True, False])
def test_a_rig_that_is_yet_to_be_homed_is_homed_once(
    completes: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And moved no more where an operator stopped that."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    said = Console(record=True, width=120, file=io.StringIO())
    names = ("READY", "READY", "HOMING", "READY", "READY", "READY")
    statuses = [pb.Status(state=name, fault="NONE", recording=True) for name in names]
    conversation = Unhomed(*statuses, completes=completes)
    monkeypatch.setattr(demo_live, "local_client", lambda _: contextlib.nullcontext(conversation))
    demo = Demo(Scene(load_rig(RIG), RIG, (), tmp_path, tmp_path), said, Signals(), insists=True, holds=False)
    while conversation.statuses:
        demo._look(cast(RigClient, conversation))
    first = [CommandKind.ACTIVATE, CommandKind.HOME, CommandKind.ACTIVATE]
    assert conversation.heard[:3] == first
    assert ("to go on: hil command microscope home" in said.export_text()) is not completes
    assert len(conversation.heard) == (5 if completes else 3), "a stage that was stopped is left alone"


def test_a_stage_moves_only_while_a_key_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    rig = load_rig(RIG, ["safety.heartbeat_s=1e-6"])
    held = [False, False, True, True, False]
    statuses = [pb.Status(state=name, fault="NONE", recording=True) for name in ("READY",) * 3 + ("ACTIVE",) * 2]
    conversation = Conversation(*statuses)
    monkeypatch.setattr(demo_live, "local_client", lambda _: contextlib.nullcontext(conversation))
    demo = Demo(
        Scene(rig, RIG, (), tmp_path, tmp_path),
        Console(file=io.StringIO()),
        Signals(),
        insists=False,
        holds=False,
        held=lambda: held.pop(0),
    )
    heard = []
    while conversation.statuses:
        demo._look(cast(RigClient, conversation))
        heard.append(conversation.heard.copy())
        conversation.heard.clear()
    beat = CommandKind.HEARTBEAT
    assert heard == [[], [], [beat, CommandKind.ACTIVATE], [beat], []]


def test_a_stop_that_this_computer_caused_ends_a_demo_that_need_not_be_live(tmp_path: Path) -> None:
    scene = Scene(load_rig(RIG), RIG, (), tmp_path, tmp_path)
    demo = Demo(
        scene,
        Console(file=io.StringIO()),
        cast(Signals, SimpleNamespace(check=lambda: None)),
        insists=False,
        holds=False,
    )
    demo.status = pb.Status(state="FAULT", fault="ENCODER_LOST", index=900)
    with pytest.raises(TooBusyError, match="this computer was too busy: ENCODER_LOST stopped the stage at tick 900"):
        demo._note_stall(pb.Status(state="ACTIVE", fault="NONE"))


@pytest.mark.parametrize(
    ("before", "ours"),
    [
        (pb_events.Event(kind=pb_events.Event.TICKS_LOST, name="overrun", run_ns=9_500_000_000), True),
        (pb_events.Event(kind=pb_events.Event.TICK_LATE, run_ns=9_000_000_000), True),
        (pb_events.Event(kind=pb_events.Event.FAULT_SEEN, name="encoder_gap", run_ns=9_900_000_000), True),
        (pb_events.Event(kind=pb_events.Event.FAULT_SEEN, name="encoder_gap", axis="x", run_ns=9_900_000_000), False),
        (pb_events.Event(kind=pb_events.Event.FAULT_SEEN, name="encoder_lost", axis="x", run_ns=9_900_000_000), True),
        (pb_events.Event(kind=pb_events.Event.TICKS_LOST, run_ns=8_000_000_000), False),  # too long ago
        (pb_events.Event(kind=pb_events.Event.TICKS_LOST, run_ns=10_100_000_000), False),  # after it
        (pb_events.Event(kind=pb_events.Event.STATE, name="ACTIVE", run_ns=9_900_000_000), False),
    ],
)
@pytest.mark.parametrize("fault", ["OSCILLATION", "SPEED", "FOLLOWING_ERROR"])
def test_what_a_loop_came_to_without_samples_is_not_told_as_the_stages(
    fault: str, before: pb_events.Event, ours: bool
) -> None:
    assert by_this_computer(fault, "", 10_000_000_000, [before]) is ours
    assert not by_this_computer(fault, "rings at 234 Hz: a resonance", 10_000_000_000, [before])
    assert not by_this_computer("TRAVEL", "", 10_000_000_000, [before])


@pytest.mark.parametrize(("fault", "status"), [("RECEIVE_FLOOD", 0), ("FOLLOWING_ERROR", EXIT_FAULT)])
def test_only_a_stop_that_this_machine_caused_may_be_the_last_thing_of_a_demo(
    fault: str, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is reset where there is time for it; where the time is up, it is said."""
    latched = {"name": fault, "cause": "", "run_ns": 9_000_000_000}
    monkeypatch.setattr(Demo, "run", lambda *_: None)
    monkeypatch.setattr(demo_module, "Signals", lambda: SimpleNamespace(seen=0))
    monkeypatch.setattr(demo_module, "private_runtime", lambda: tmp_path / "runtime")
    monkeypatch.setattr(demo_module, "summed_up", lambda *_: {"latched": latched, "clock": "live"})
    try:
        demo_module.demo(RIG, out=tmp_path / "out", live=True)
        ended = 0
    except SystemExit as left:
        ended = left.code
    assert ended == status
    told = capsys.readouterr().out
    assert ("too busy at the very end" in told) == ("next, try" in told) == (status == 0)


def test_a_drive_whose_watchdog_did_not_trip_is_named_too() -> None:
    [line] = drive_report({"axes": {"x": {"trips": [], "applied_force": 1.5}}})
    assert line == "drive x: applies 1.5; its watchdog did not trip"


@pytest.mark.parametrize(
    ("kernel", "path", "overrides", "slow"),
    [
        (None, "interpreted", (), True),
        (None, "interpreted", ("plant.stage=ideal",), False),
        (None, "compiled", (), False),
        ("kernel.so", "interpreted", (), False),
    ],
)
def test_a_stage_that_python_alone_cannot_emulate_live_is_told(
    kernel: str | None, path: str, overrides: tuple[str, ...], slow: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_virtual.library, "found", lambda: (kernel, "not built"))
    monkeypatch.setattr(demo_virtual, "control_path", lambda: path)
    assert ("not built" in demo_virtual.too_slow(load_rig(RIG, overrides))) == slow


@pytest.mark.parametrize(("missed", "lost", "busy"), [(10, 0, False), (11, 0, True), (3, 8, True), (0, 0, False)])
def test_figures_are_the_stages_where_hardly_a_tick_was_missed(missed: int, lost: int, busy: bool) -> None:
    summary = {"ticks": 10_000, "missed": {"own": 0, "host": missed}, "frames": {"lost": lost}}
    assert ("too busy" in demo_virtual.was_too_busy(summary)) == busy


@pytest.mark.long
def test_in_virtual_time_the_demo_has_the_stage_and_law_of_the_rig_and_what_it_prints_can_be_pasted(
    tmp_path: Path,
) -> None:
    out = tmp_path / "my runs"
    done = hil("demo", str(RIG), "--virtual", "--seconds", "4", "--out", str(out))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "virtual time" in done.stdout
    assert done.stdout.count("s to go in virtual time") == 4
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["clock"], summary["law"], summary["latched"]) == ("virtual", "presliding-kalman", None)
    assert load_run(out / "run.mcap").rig.plant.stage == "crossed-roller"
    assert summary["axes"]["z"]["rms_error"] < 1e-6
    assert (out / "tracking.png").read_bytes().startswith(b"\x89PNG")
    commands = [line.strip() for line in done.stdout.partition("next, try:")[2].strip().splitlines()]
    assert len(commands) == 4
    replay = shlex.split(commands[0], comments=True)
    assert replay[-2:] == ["replay", f"{out}/run.mcap"]
    assert subprocess.run(replay, check=False, capture_output=True).returncode == 0


def test_what_comes_next_keeps_what_was_chosen_for_the_run_and_says_whose_code_a_replay_runs(tmp_path: Path) -> None:
    own = f"law.name={ROOT / 'examples' / 'laws' / 'lqr.py'}:Lqr"
    chosen = ("plant.friction_scale=1.5", own)
    said = Console(record=True, width=120, file=io.StringIO())
    scene = Scene(load_rig(IDEAL, chosen), IDEAL, (*chosen, *demo_live.ALWAYS), tmp_path, tmp_path)
    demo_module._what_next(scene, said)
    lines = [shlex.split(line, comments=True) for line in said.export_text().partition("next, try:")[2].splitlines()]
    after = {name: line[line.index(name) + 2 :] for line in lines for name in ("replay", "demo", "sim") if name in line}
    assert after["replay"] == ["--run-its-code"]
    assert after["demo"] == ["--law", "pd-feedforward", "--set", chosen[0]]
    assert after["sim"] == ["--seconds", "20", "--set", chosen[0], "--set", own]
