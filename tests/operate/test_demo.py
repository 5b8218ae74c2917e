"""`hil demo` as people meet it: real processes, a run that ends well, and every way in which it can be cut short."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.cli.exit_status import EXIT_FAULT
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.runs.summary import RunData, load_run
from tests.support.paths import ROOT

# What is live here runs on a host that may stall for 50 ms: an ideal stage forgives that, presliding guides do not.
IDEAL = ROOT / "deploy" / "rigs" / "microscope-ideal.toml"
LIVE = ("--live", "--set", "plant.stage=ideal")  # on a machine that does much else
pytestmark = pytest.mark.live


class Show:
    """A running `hil demo` and what it said so far."""

    def __init__(self, directory: Path, runtime: Path, seconds: float) -> None:
        self.out = directory / "out"
        self.runtime = runtime
        self.text = ""
        demo = [sys.executable, "-u", "-m", "hil", "demo", str(IDEAL), *LIVE]
        self.process = subprocess.Popen(
            [*demo, "--seconds", str(seconds), "--out", str(self.out)],
            cwd=directory,
            env={**os.environ, "HIL_RUNTIME_DIR": str(runtime)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def read_until(self, wanted: str) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self.text += line
            if wanted in line:
                return
        raise AssertionError(f"{wanted!r} was never said, but:\n{self.text}")

    def end(self) -> int:
        output, _ = self.process.communicate(timeout=120)
        self.text += output
        return self.process.returncode

    def pid(self, name: str) -> int:
        found = re.search(rf"{name} (\d+)", self.text)
        assert found, self.text
        return int(found[1])

    def children(self) -> list[int]:
        return [self.pid(name) for name in ("emulator", "sidecar", "control process")]

    def left_running(self) -> list[int]:
        return [pid for pid in self.children() if _is_running(pid)]

    def recording(self) -> RunData:
        return load_run(self.out / "run.mcap")


def _is_running(pid: int) -> bool:
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
        return b"hil" in command and "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.fixture
def show(tmp_path: Path, private_runtime_dir: Path, request: pytest.FixtureRequest) -> Iterator[Show]:
    show = Show(tmp_path, private_runtime_dir, getattr(request, "param", 60.0))
    yield show
    if show.process.poll() is None:
        show.process.terminate()
        show.process.communicate(timeout=30)
    for pid in (pid for pid in show.children() if _is_running(pid)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def assert_ended_with_zero_torque(run: RunData) -> None:
    states = [int(state) for state in TORQUE_STATES]
    assert np.abs(run.force[np.isin(run.columns["state"], states)]).max() > 0.1
    assert (run.force[-1] == 0).all()


def hil(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hil", *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300
    )


def activated_while_active() -> subprocess.CompletedProcess[str]:
    """The answer to ACTIVATE of a rig that is ACTIVE. Where this machine has just held a process up, the demo has reset
    the rig to READY: the first one takes it back, and is asked again.
    """
    answers = (hil("command", str(IDEAL), "activate") for _ in range(3))
    return next(answer for answer in answers if "accepted" not in answer.stdout)


@pytest.mark.parametrize("show", [12.0], indirect=True)
def test_a_demo_runs_is_seen_from_elsewhere_and_sums_up(show: Show) -> None:
    show.read_until("to go")
    seen = hil("monitor", "microscope-ideal", "--once")
    assert seen.returncode == 0, seen.stderr
    assert "theta" in seen.stdout
    assert "tick lateness" in seen.stdout
    refused = activated_while_active()
    assert refused.returncode == 1
    assert "not possible in state" in refused.stdout
    assert show.end() == 0, show.text
    summary = json.loads((show.out / "summary.json").read_text())
    counts = summary["telemetry"]
    assert counts["produced"] == counts["sent"] + counts["dropped"] == summary["ticks"] > 3000
    assert summary["recording"] == {"ticks": summary["ticks"], "lost": 0, "truncated": False, "loss": ""}
    assert summary["frames"]["sent"] <= summary["ticks"]
    assert summary["frames"]["received"] > 3 * summary["frames"]["sent"]
    assert list(summary["axes"]) == ["x", "y", "z", "theta"]
    # theta rests for most of it, on a count as often as not: as measured, without any error
    assert all(0 <= axis["rms_error"] <= axis["max_error"] < 1e-3 for axis in summary["axes"].values())
    assert summary["axes"]["z"]["rms_error"] > 0
    assert summary["lateness"]["p50"] <= summary["lateness"]["p99"] <= summary["lateness"]["max"]
    assert (show.out / "tracking.png").read_bytes().startswith(b"\x89PNG")
    assert "next, try" in show.text
    assert_ended_with_zero_torque(show.recording())
    assert show.left_running() == []
    assert list(show.runtime.iterdir()) == []
    replayed = hil("replay", str(show.out / "run.mcap"), "--json", "-")
    report = json.loads(replayed.stdout)
    assert (report["ticks"], report["different"]) == (summary["ticks"], 0)


def test_ctrl_c_ends_everything_with_zero_torque_last_and_a_whole_recording(show: Show) -> None:
    show.read_until("to go")
    show.process.send_signal(signal.SIGINT)
    assert show.end() == 130, show.text
    assert "tick lateness" in show.text
    assert show.left_running() == []
    run = show.recording()
    assert not run.truncated
    assert_ended_with_zero_torque(run)


def test_ctrl_c_during_the_start_leaves_nothing_running(show: Show) -> None:
    show.read_until("started")
    show.process.send_signal(signal.SIGINT)
    assert show.end() == 130, show.text
    assert show.left_running() == []


def test_a_killed_control_process_leaves_the_drives_at_zero_within_10_ms_and_the_demo_says_so(show: Show) -> None:
    show.read_until("to go")
    os.kill(show.pid("control process"), signal.SIGKILL)
    assert show.end() == 1
    assert "the control process was ended by SIGKILL" in show.text
    reports = re.findall(r"drive (\w+): zero torque ([\d.]+) ms after the last command .*; now (\S+)", show.text)
    assert [name for name, _, _ in reports] == ["x", "y", "z", "theta"]
    assert all(float(after) <= 10.0 and float(now) == 0.0 for _, after, now in reports)
    assert show.left_running() == []
    run = show.recording()
    assert not run.truncated
    assert run.columns["state"][-1] != State.SHUTDOWN  # no orderly end, and yet every tick is recorded
    assert run.status is not None
    assert len(run.columns["index"]) == run.status.produced == run.status.sent


def test_a_demo_that_ends_in_a_fault_says_axis_time_value_and_limit_and_exits_with_3(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = hil(
        "demo", "paper", "--live", "--seconds", "5", "--out", str(out), "--set", "axes.x.limits.following_error=1e-6"
    )
    assert done.returncode == EXIT_FAULT, done.stdout + done.stderr
    told = json.loads((out / "summary.json").read_text())["latched"]
    assert told["axis"] == "x"  # its errors alone have so low a limit
    assert told["value"] > told["limit"] > 0
    assert re.fullmatch(r"tick \d+ \(\d+\.\d+ s\): fault latched: \w+ on x: .* \S+ m, limit \S+ m; .*", told["line"])
    assert told["line"] in done.stdout
    assert told["line"] in (out / "control.log").read_text()
    assert told["line"].encode() in (out / "tracking.png").read_bytes()


def test_a_killed_sidecar_is_reported_and_the_stage_is_stopped(show: Show) -> None:
    show.read_until("to go")
    os.kill(show.pid("sidecar"), signal.SIGKILL)
    assert show.end() == 1
    assert "the sidecar was ended by SIGKILL" in show.text
    assert show.left_running() == []
    assert (show.out / "control.log").read_text().count("hil run:") == 2  # it ended by itself, with its summary
    assert show.recording().truncated


def test_a_killed_demo_takes_its_processes_along(show: Show) -> None:
    show.read_until("to go")
    show.process.kill()
    show.end()
    for pid in show.children():
        with contextlib.suppress(ChildProcessError, ProcessLookupError):
            subprocess.run(["tail", f"--pid={pid}", "-f", "/dev/null"], timeout=20, check=False)
    assert show.left_running() == []
    assert_ended_with_zero_torque(show.recording())
