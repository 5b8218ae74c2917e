"""What people look at: terminal view, one-line form, browser page, picture."""

import io
import os
import termios
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console

from drivers.protocols.base import DriveStatus
from hil.cli.pictures import tracking_picture
from hil.operate import monitor
from hil.operate.monitor import Newest, banner, line, silence, view
from hil.rig.schema import RigConfig
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import RigClient, printable


def status(**changes: Any) -> pb.Status:
    values: dict[str, Any] = {
        "rig": "microscope",
        "law": "pd-feedforward",
        "axes": ["x", "theta"],
        "units": ["m", "rad"],
        "period_ns": 1_000_000,
        "pid": 5,
        "control_alive": True,
        "state": "ACTIVE",
        "fault": "NONE",
        "index": 1234,
        "position": [0.001234567, -0.02],
        "setpoint": [0.001234, -0.02],
        "max_error": [5.67e-7, 3e-5],
        "force": [0.5, -0.001],
        "drive_status": [DriveStatus.ENABLED, DriveStatus.ENABLED],
        "lateness_p50": 22e-6,
        "lateness_p99": 35e-6,
        "lateness_max": 410e-6,
        "realtime": "SCHED_FIFO 80",
        "counters": pb.Counters(sent=1234, received=4936, missed_host=2, samples_lost=3, rejects=[0, 1]),
        "sent": 1234,
        "recording": True,
        **changes,
    }
    return pb.Status(**values)


def test_an_axis_that_has_fallen_silent_is_named_with_how_long_ago() -> None:
    silent = status(answer_age=[0.0, 0.7], drive_problems=["theta: <b>1018h</b> differs"])
    for text in (shown(silent), line(silent)):
        assert "no answer from theta for 0.7 s" in text
        assert "1018h" in text
        assert "x for" not in text
    assert "no answer" not in shown(status(answer_age=[0.1, 0.4]))


def shown(message: pb.Status) -> str:
    console = Console(width=120, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(view(message))
    return console.export_text()


def test_the_view_names_state_axes_lateness_losses_and_real_time() -> None:
    text = shown(status())
    for expected in (
        "microscope · pd-feedforward · 1000 Hz · tick 1234",
        "ACTIVE",
        "+1.234567 mm",
        "567 nm",
        "-20.000000 mrad",
        "30 µrad",
        "+0.5000 N",
        "enabled",
        "p50 22 / p99 35 / max 410 µs",
        "0 own, 2 the host's",
        "1234 sent, 4936 received; 3 samples lost, 1 frames rejected",
        "recording",
        "SCHED_FIFO 80",
    ):
        assert expected in text


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"state": "FAULT", "fault": "ENCODER_DEAD"}, "FAULT  fault ENCODER_DEAD"),
        ({"faults_active": ["ENCODER_GAP"]}, "seen now: ENCODER_GAP"),
        ({"control_alive": False}, "the control process was killed"),
        ({"control_alive": False, "control_ended": True}, "the control process ended"),
        ({"control_alive": False, "pid": 0}, "the control process is not running"),
    ],
)
def test_what_went_wrong_is_said_in_every_form(changes: dict[str, Any], expected: str) -> None:
    assert expected in shown(status(**changes))
    assert expected in line(status(**changes))


def test_a_drive_that_keeps_the_rig_from_ready_says_why() -> None:
    text = shown(status(state="CONNECTED", drive_status=[DriveStatus.BRAKE, DriveStatus.WATCHDOG | DriveStatus.BRAKE]))
    assert "watchdog brake" in text


def test_a_status_without_any_tick_is_shown_too() -> None:
    assert "is not running" in shown(pb.Status(rig="microscope"))
    assert "is not running" in line(pb.Status(rig="microscope"))


def event(name: str, kind: int = pb_events.Event.FAULT_LATCHED, **changes: Any) -> pb_events.Event:
    line = f"tick 7 (0.007 s): fault latched: {name} on x: age 3 ticks, limit 3 ticks; cause: <b>; next: reset"
    return pb_events.Event(kind=kind, name=name, severity=pb_events.Event.ERROR, line=line, wall_ns=10**18, **changes)


def test_a_latched_fault_is_a_banner_above_the_list_of_events() -> None:
    stopped, events = status(state="FAULT", fault="ENCODER_LOST"), [event("speed"), event("encoder_lost")]
    assert banner(stopped, events).plain == events[1].line
    assert banner(status(), events).plain == ""
    assert banner(stopped, []).plain == "fault ENCODER_LOST"  # its event has not come yet
    storm = [event("slots", pb_events.Event.TICKS_LOST)] * 1000
    kept = status(state="FAULT", fault="ENCODER_LOST", latched=events[1])
    assert banner(kept, storm).plain == events[1].line  # part of the status, whatever followed
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(view(stopped, events=events))
    text = console.export_text()
    assert text.count("encoder_lost on x") == 2
    assert text.index("encoder_lost on x") < text.index("max error, last s")


@pytest.mark.long
@pytest.mark.parametrize("ticks", [0, 1, 7, 5000])
def test_a_picture_is_drawn_of_any_length_of_run(tmp_path: Path, paper: RigConfig, ticks: int) -> None:
    values = np.sin(np.arange(ticks)[:, None] * 1e-2 + np.arange(2))
    values[: ticks // 3] = np.nan
    time = np.arange(ticks) * 1e-3
    run = SimpleNamespace(time=time, setpoint=values, error=values * 1e-6, force=np.zeros((ticks, 2)))
    tracking_picture(tmp_path / "deep" / "tracking.png", paper, run, np.full(ticks, 3e-5))
    assert (tmp_path / "deep" / "tracking.png").read_bytes().startswith(b"\x89PNG")


def test_a_single_peak_survives_the_thinning_of_a_long_line(ideal_microscope: RigConfig) -> None:
    from matplotlib.figure import Figure

    from hil.cli.pictures import _line

    values = np.zeros(100_000)
    values[77_777] = 5.0
    panel = Figure().add_subplot()
    _line(panel, ideal_microscope, np.arange(100_000) * 1e-3, values, "", "C0")
    [drawn] = panel.lines
    assert np.max(drawn.get_ydata()) == 5.0
    assert len(np.asarray(drawn.get_ydata())) < 4000


@pytest.mark.requirement(id="SR-9.3")
def test_a_control_process_that_hangs_is_said_to_and_how_old_what_is_shown_is() -> None:
    hung = status(now_ns=10_000_000_000, tick_ns=6_800_000_000)
    assert "THE CONTROL PROCESS HANGS: no tick for 3.2 s; what is shown is as old; it was ACTIVE" in line(hung)
    assert "HANGS" in shown(hung)
    assert "HANGS" not in line(status(now_ns=10_000_000_000, tick_ns=9_600_000_000))


@pytest.mark.requirement(id="SR-9.3")
def test_a_sidecar_that_falls_silent_is_said_to_within_a_second() -> None:
    class Silent:
        statuses = [status()]  # noqa: RUF012

        def status(self) -> pb.Status | None:
            return self.statuses.pop() if self.statuses else None

        def events(self) -> list[Any]:
            return []

    newest = Newest(cast(RigClient, Silent()))
    assert newest.look()
    began = time.monotonic()
    while not silence(newest.status, newest.age_s):
        assert not newest.look()
        assert time.monotonic() - began < 1.0
    assert newest.status
    assert "NO WORD FROM THE SIDECAR for 0.5 s" in line(newest.status, newest.age_s)


def test_no_text_in_a_status_commands_the_terminal_or_the_browser() -> None:
    evil = "\x1b[2J\x1b]0;x\x07<script>alert(1)</script>[bold red on white]"
    fields = [field for field in pb.Status.DESCRIPTOR.fields if field.type == field.TYPE_STRING]
    hostile = status()
    for field in fields:
        if isinstance(getattr(hostile, field.name), str):
            setattr(hostile, field.name, evil)
        else:
            getattr(hostile, field.name)[:] = [evil] * 2
    hostile.latched.line = evil
    clean = printable(hostile)
    assert "\x1b" not in clean.latched.line
    console = Console(width=200, record=True, file=io.StringIO(), force_terminal=False)
    console.print(view(clean))
    console.print(line(clean), markup=False)
    text = console.export_text()
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "[bold red on white]" in text  # shown, not obeyed


def test_one_key_stops_the_rig_that_is_shown_and_the_terminal_is_left_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Showing:
        endpoint = "nowhere"

        def status(self) -> pb.Status:
            return status()

        def events(self) -> list[Any]:
            return []

    stopped: list[str] = []

    def stop(name: str) -> int:
        stopped.append(name)
        raise KeyboardInterrupt  # and the person leaves

    monkeypatch.setattr(monitor, "stop_rig", stop)
    ours, theirs = os.openpty()
    keys, before = monitor.Keys, termios.tcgetattr(theirs)
    monkeypatch.setattr(monitor, "Keys", lambda _: keys(theirs))
    os.write(ours, b"xe")
    with pytest.raises(KeyboardInterrupt):
        monitor._watch(cast(RigClient, Showing()), Console(file=io.StringIO(), force_terminal=True))
    assert stopped == ["microscope"]
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)
