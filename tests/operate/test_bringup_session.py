"""A bring-up session on the local bus: alone on its rig, and without torque whichever way it ends."""

import os
import pty
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.bus.any_bus import AnyPort, joined
from drivers.bus.port import PortError
from hil.cli.app import build_app
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_line import RigInUseError, StopLine
from hil.live.stop_page import live_pages
from hil.operate.bringup.jog import POSITIVE, Jog, jog_settings
from hil.operate.bringup.session import open_session
from hil.operate.bringup.survey import Survey
from hil.operate.keys import held_keys
from hil.rig.schema import RigConfig
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drive_double import DoubleSettings, DriveDouble, make_drive
from tests.support.bought_drives import EDS, cia402, write_files
from tests.support.live_rig import CALM, PAPER, PATIENCE_S, Emulator, emulated, rig_with

APP = build_app("drives")
SETS = [part for override in CALM for part in ("--set", override)]
Ending = Callable[[], None]


def drives(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(APP, ["drives", str(PAPER), *SETS, *words])
    return result.exit_code, result.output


def when_pushed(emulator: Emulator, ending: Ending) -> threading.Thread:
    """Do it once the drive of axis x applies a force."""

    def run() -> None:
        limit = time.monotonic() + PATIENCE_S
        while emulator.stage.drives[0].force == 0.0 and time.monotonic() < limit:
            time.sleep(0.002)
        ending()

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def jog_until(ending: Callable[[Emulator], Ending], keys: Callable[[], str] = lambda: POSITIVE) -> tuple[str, Emulator]:
    """Jog with a key that is never let go; why it stopped."""
    rig = rig_with()
    with emulated() as emulator:
        thread = when_pushed(emulator, ending(emulator))
        try:
            with open_session(rig, PAPER.parent) as session:
                jog = Jog(session.host, jog_settings(rig, "x", 2.0, None, None), keys)
                session.run(jog)
                assert not jog.ended
        finally:
            thread.join()
            emulator.stop()  # having heard all that was sent
            assert emulator.stage.applied_force == [0.0, 0.0]
            assert emulator.stage.commands > 10
    return session.stopped, emulator


def test_a_rig_on_the_bus_is_surveyed_and_left_as_it_was(tmp_path: Path) -> None:
    with emulated() as emulator:
        status, text = drives("--json", str(tmp_path / "report.json"))
    assert (status, "ready" in text) == (0, True), text
    assert (tmp_path / "report.json").exists()
    assert emulator.stage.applied_force == [0.0, 0.0]


@pytest.mark.long
def test_drives_that_are_not_there_are_not_ready() -> None:
    status, text = drives()
    assert status == 1
    assert "not ready" in text
    assert "never heard" in text


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGTSTP, signal.SIGQUIT])
def test_a_signal_ends_the_torque(number: signal.Signals) -> None:
    stopped, _ = jog_until(lambda _: lambda: os.kill(os.getpid(), number))
    assert stopped == number.name


def test_so_does_estop() -> None:
    def ending() -> None:
        (page,) = live_pages("paper")
        page.await_latch(page.press(), 1.0)
        page.close()

    assert jog_until(lambda _: ending)[0] == "hil estop"


def test_so_does_an_exception() -> None:
    broken = threading.Event()

    def keys() -> str:
        if broken.is_set():
            raise RuntimeError("the keyboard is gone")
        return POSITIVE

    with pytest.raises(RuntimeError, match="the keyboard is gone"):
        jog_until(lambda _: broken.set, keys)


def test_a_rig_that_is_being_run_is_left_alone() -> None:
    with StopLine(runtime_paths("paper").directory):
        status, text = drives()
        assert (status, "another control process is running this rig" in text) == (69, True)
        with pytest.raises(RigInUseError), open_session(rig_with(), PAPER.parent):
            pass


def test_a_rig_that_is_brought_up_is_not_run() -> None:
    with open_session(rig_with(), PAPER.parent), pytest.raises(RigInUseError):
        StopLine(runtime_paths("paper").directory)


def test_a_bus_that_is_not_there_is_named() -> None:
    rig = rig_with(["bus.interface=socketcan", "bus.channel=nowhere"])
    with pytest.raises(PortError, match="nowhere"), open_session(rig, PAPER.parent):
        pass


def test_without_a_terminal_there_is_no_jog() -> None:
    status, text = drives("--jog", "x", "--force", "0.5")
    assert status == 2
    assert "needs a terminal" in text


def test_keys_come_from_a_pipe_where_asked(tmp_path: Path) -> None:
    pipe = tmp_path / "keys"
    os.mkfifo(pipe)
    with held_keys(pipe) as keys:
        assert keys() == ""
        writer = os.open(pipe, os.O_WRONLY)
        os.write(writer, b"pp")
        assert keys() == "pp"
        os.close(writer)
        assert keys() == "\x04"  # its end is no held key


def test_keys_typed_before_are_no_consent(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, ours = pty.openpty()
    os.write(terminal, b"p\n")
    with open(ours) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with held_keys() as keys:
            assert keys() == ""
            os.write(terminal, b"p")
            assert keys() == "p"
            os.close(terminal)
            assert keys() == "\x04"  # the terminal is gone


def test_a_survey_that_is_stopped_ends_without_a_report() -> None:
    rig = rig_with()
    with emulated(), open_session(rig, PAPER.parent) as session:
        session.stopped = "SIGTERM"
        survey = Survey(session.host)
        session.run(survey)
        assert not survey.done


@pytest.mark.long
def test_drives_are_brought_up_through_an_adapter_that_has_no_driver_in_the_kernel(tmp_path: Path) -> None:
    """`virtual`, python-can's own bus within a process, stands for it; the drives are those of `hil drive`."""
    write_files(tmp_path)
    facts = cia402()
    facts["bus"] |= {"interface": "virtual", "channel": "adapter"}
    facts["rate_hz"] = 200.0
    rig = RigConfig.model_validate(facts)
    settings = DoubleSettings(5.0, 4096, 1e-4, 1e-3, 0.0, 0.0, EmulatedDriveConfig(kind="cia402"))
    ending = threading.Event()
    said: list[str] = []

    def serve(port: AnyPort) -> None:
        drives = [make_drive(tmp_path / EDS, node, settings, time.monotonic_ns()) for node in (3, 9)]
        double = DriveDouble(drives, port, said.append, every=False)
        while not ending.is_set():
            first = port.wait(0.001)
            double.step([first] if first else [], time.monotonic_ns())

    with joined(rig.bus, fd=False) as port:
        thread = threading.Thread(target=serve, args=(port,))
        thread.start()
        try:
            with open_session(rig, tmp_path) as session:
                survey = Survey(session.host)
                session.run(survey)
                report = survey.report()
        finally:
            ending.set()
            thread.join()
    assert [(axis.name, axis.node, axis.phase, axis.problem) for axis in report.axes] == [
        ("x", 3, "RUNNING", ""),
        ("y", 9, "RUNNING", ""),
    ]
    assert [axis.state for axis in report.axes] == ["SWITCHED_ON"] * 2
    assert "node 9: switched on" in said
