"""`hil estop NAME` on a live control process, with everything else broken."""

import os
import shutil
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_page import live_pages
from tests.support.live_rig import PAPER, Control, emulated, every_record, order

ESTOP = [sys.executable, "-m", "hil", "estop"]


def estop(name: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*ESTOP, name], env={**os.environ, **environment}, capture_output=True, text=True, timeout=30, cwd="/"
    )


def test_no_control_process_of_that_name_is_an_error() -> None:
    for name in ("nobody", "../paper", ""):
        done = estop(name)
        assert (done.returncode, done.stdout) == (69, "")
        assert "no control process of the name" in done.stderr


@pytest.mark.requirement(id="SR-2.1")
@pytest.mark.live
def test_it_stops_a_moving_rig_without_rig_file_sidecar_or_runtime_directory_and_tells_what_was_recorded(
    tmp_path: Path,
) -> None:
    for part in PAPER.parent.iterdir():
        if part.is_file():
            shutil.copy(part, tmp_path)
    with emulated() as emulator, Control(rig=tmp_path / "paper.toml") as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        (tmp_path / "paper.toml").unlink()
        first = estop("paper")
        control.wait_for(State.ESTOP, reader)
        shutil.rmtree(runtime_paths("paper").directory)
        again = estop("paper")  # idempotent, and found without the directory
        for done in (first, again):
            assert done.returncode == 0, done.stderr
            assert f"paper (pid {control.process.pid}): ESTOP in tick" in done.stdout
        assert emulator.stage.applied_force == [0.0, 0.0]
    gone = estop("paper")
    assert (gone.returncode, gone.stdout) == (69, "")
    assert "unset it to look everywhere" in gone.stderr


@pytest.mark.live
def test_of_a_process_that_does_not_run_it_says_so_and_the_press_waits_for_it() -> None:
    with emulated() as emulator, Control() as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        (page,) = live_pages("paper")
        while page.status().state != "ACTIVE":  # told a few times a second
            time.sleep(0.01)
        control.process.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        hung = estop("paper")
        assert time.monotonic() - began < 5.0
        assert (hung.returncode, hung.stdout) == (70, "")
        assert "does not run: its last word was ACTIVE" in hung.stderr
        control.process.send_signal(signal.SIGCONT)
        control.wait_for(State.ESTOP, reader)
        assert emulator.stage.applied_force == [0.0, 0.0]
    assert estop("paper").returncode == 69


@pytest.mark.live
def test_a_second_control_process_is_refused_before_it_asks_for_a_core_and_the_first_loses_nothing() -> None:
    with emulated(), Control() as control:
        reader = control.wait_for(State.READY)
        with Control() as second:
            status, out, err = second.finish()
        assert (status, out) == (69, "")
        assert f"another control process is running this rig (pid {control.process.pid})" in err
        before = reader.written
        while reader.written == before:
            time.sleep(0.001)
        assert estop("paper").returncode == 0
        control.wait_for(State.ESTOP, reader)
    assert State.FAULT not in every_record()["state"]


def test_it_loads_next_to_nothing() -> None:
    count = "import sys; before = set(sys.modules)\n"
    act = "sys.argv = ['hil', 'estop', 'nobody']\nfrom hil.__main__ import main\n"
    end = "try: main()\nexcept SystemExit: print(*sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", count + act + end], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert len(loaded) <= 20, loaded
    assert not {"typer", "numpy", "pathlib", "typing", "enum", "re"} & set(loaded)


@pytest.mark.live
def test_it_acts_within_three_times_a_bare_interpreters_start() -> None:
    def seconds(*command: str) -> float:
        began = time.perf_counter()
        subprocess.run(command, capture_output=True, check=False)
        return time.perf_counter() - began

    bare, whole = [], []
    for _ in range(21):
        bare.append(seconds(sys.executable, "-c", "pass"))
        whole.append(seconds(*ESTOP, "nobody"))
    assert statistics.median(whole) < 3 * statistics.median(bare)
