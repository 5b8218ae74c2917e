"""LOAD_TASK: over the Unix socket and from elsewhere; what is refused, with axis, time, value and limit."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import runtime_paths
from hil.live.task_loading import law_document
from hil.telemetry.command_client import CommandClient, local_client, remote_client
from hil.telemetry.credentials import Credentials
from hil.telemetry.task_loader import MOST_BYTES
from hil.virtual.replay import replay_run
from tests.support.certificates import certificates
from tests.support.command_bench import RIG, CommandBench
from tests.support.live_rig import PAPER, Control, emulated
from tests.support.paths import ROOT
from tests.telemetry.test_commands import free_port

SMALL = {"kind": "circle", "axes": ["x", "y"], "radius": 1e-4, "frequency_hz": 0.5}


@pytest.fixture
def long_task() -> str:
    """A path whose JSON does not fit a message by far, nor compresses well."""
    rows = 20_000
    random = np.random.default_rng(1)
    samples = np.column_stack([0.05 * np.arange(rows), 1e-6 * random.random((rows, 2))]).tolist()
    return json.dumps({"kind": "path", "axes": ["x", "y"], "samples": samples, "beyond": 10.0})


@pytest.fixture(params=["local", "remote"])
def client(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[CommandClient, CommandBench]]:
    made, where = certificates(tmp_path / "certificates"), free_port()
    with CommandBench(tmp_path / "rig", (where, Credentials(made / "sidecar"))) as bench:
        local = request.param == "local"
        with local_client(bench.directory) if local else remote_client(where, Credentials(made / "operator")) as client:
            yield client, bench


def test_a_task_is_loaded_and_recorded(client: tuple[CommandClient, CommandBench]) -> None:
    asking, bench = client
    verdict = asking.load_task(json.dumps(SMALL))
    assert (verdict.accepted, verdict.reason) == (True, "")
    (entry,) = bench.entries
    assert (entry.kind, entry.accepted, entry.posted) == (CommandKind.LOAD_TASK, True, 1)
    assert json.loads(entry.task)["radius"] == 1e-4
    (task,) = bench.tasks
    assert task is not None
    assert task.plan([0.0] * 4).phase_names == ("approach", "figure")


@pytest.mark.long
def test_the_longest_task_travels_in_parts(long_task: str, client: tuple[CommandClient, CommandBench]) -> None:
    asking, bench = client
    assert asking.load_task(long_task).accepted
    (entry,) = bench.entries
    assert json.loads(entry.task)["samples"] == json.loads(long_task)["samples"]
    assert asking.command(CommandKind.STOP).accepted  # the connection goes on


@pytest.mark.long
@pytest.mark.parametrize(("task", "text"), [
    ({**SMALL, "radius": 1.0}, "the task cannot begin here: axis x: force 12.7629 N 1.279 s after the start"),
    ({**SMALL, "frequency_hz": 300.0, "radius": 1e-6}, "change task.frequency_hz"),
    ({**SMALL, "axes": ["x", "q"]}, "no axis 'q'"),
    ({"kind": "path", "axes": ["x"], "samples": [[0.0, 0.0], [1.0, 9.0]]}, "row 2, column x: 9 is outside"),
    ({"kind": "dance"}, "the tasks are hold, circle"),
    ({"kind": "./evil.py:Evil"}, "samples: no axis"),
])  # fmt: skip
def test_what_cannot_be_done_is_refused_with_its_reason(
    task: dict[str, object], text: str, client: tuple[CommandClient, CommandBench]
) -> None:
    asking, bench = client
    verdict = asking.load_task(json.dumps(task))
    assert not verdict.accepted
    assert text in verdict.reason
    assert bench.tasks == []
    assert asking.load_task(json.dumps(SMALL)).accepted


@pytest.mark.long
def test_bytes_that_are_no_task_and_too_many_of_them_are_refused(client: tuple[CommandClient, CommandBench]) -> None:
    asking, bench = client
    assert "damaged" in asking.command(CommandKind.LOAD_TASK, b"", patience_s=5.0).reason
    assert not asking.command(CommandKind.LOAD_TASK, b"no zlib", patience_s=5.0).accepted
    part, sent = os.urandom(30_000), 0
    while (verdict := asking.command(CommandKind.LOAD_TASK, part, more=True)).accepted:
        sent += len(part)
        assert sent <= MOST_BYTES
    assert "longer than" in verdict.reason
    assert bench.tasks == []


def test_a_dead_control_process_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.telemetry.task_loader.PATIENCE_NS", 300_000_000)
    with CommandBench(tmp_path / "rig") as bench, local_client(bench.directory) as asking:
        bench.dead = True
        assert "not ready after" in asking.load_task(json.dumps(SMALL)).reason


def test_a_law_is_set_and_recorded(client: tuple[CommandClient, CommandBench]) -> None:
    asking, bench = client
    chosen = RIG.law.model_copy(update={"name": "pd-feedforward"})
    verdict = asking.set_law(law_document(chosen))
    assert (verdict.accepted, verdict.reason) == (True, "")
    (entry,) = bench.entries
    assert (entry.kind, entry.accepted, entry.posted) == (CommandKind.SET_LAW, True, 1)
    assert json.loads(entry.task) == {"name": "pd-feedforward", "gains": chosen.effective_gains()}
    (law,) = bench.laws
    assert law.law.gains == chosen.effective_gains() != {}
    assert bench.tasks == []


@pytest.mark.parametrize(("law", "text"), [
    ({"name": "pd-feedforward", "gains": {"kp": 1e9, "kd": 150.0}},
     "law 'pd-feedforward' is unstable on axis 'x' at 1000 Hz"),  # as `hil check` has it
    ({"name": "pd-feedforward", "gains": {"kq": 1.0}}, "law.gains.kq: pd-feedforward has kp, kd"),
    ({"name": "./evil.py:Evil"}, "one of hil's own laws is set"),
    ({"name": "pid", "iterative_learning": True}, "a law that learns is not set"),
])  # fmt: skip
def test_a_law_that_cannot_be_is_refused_with_its_reason(
    law: dict[str, object], text: str, client: tuple[CommandClient, CommandBench]
) -> None:
    asking, bench = client
    verdict = asking.set_law(json.dumps(law))
    assert not verdict.accepted
    assert text in verdict.reason
    assert bench.laws == []


# live -----------------------------------------------------------------------------------------------------------------


@pytest.mark.live
def test_a_live_rig_takes_another_task_and_its_recording_replays(tmp_path: Path) -> None:
    path = tmp_path / "line.csv"
    path.write_text("time_s,x\n" + "".join(f"{0.5 * k},{1e-3 * (k % 2)}\n" for k in range(400)))
    runner, words = CliRunner(env={"COLUMNS": "300"}), [sys.executable, "-m", "hil", "sidecar", str(PAPER)]
    windows = [word for axis in "xy" for word in ("--set", f"axes.{axis}.motion.window=3e-3")]  # friction holds them
    with emulated(), Control(*windows):
        sidecar = subprocess.Popen(
            [*words, "--listen", "tcp/127.0.0.1:7447", "--or-free-port", "--out", str(tmp_path)],
            cwd=ROOT, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            endpoint = runtime_paths("paper").endpoint
            until = time.monotonic() + 30.0
            while not endpoint.exists() and time.monotonic() < until:
                time.sleep(0.02)
            with hil.connect("paper", endpoint.read_text()) as rig:
                rig.wait_for("READY")
                refused = rig.load_task({**SMALL, "radius": 5.0})
                assert not refused.accepted
                assert "axis x: position" in refused.reason
                assert rig.load_task({**SMALL, "radius": 1e-3}, overrides=["task.approach_s=0.5"]).accepted
                bad = runner.invoke(build_app("command"), ["command", str(PAPER), "load-task", str(tmp_path / "none")])
                assert isinstance(bad.exception, hil.RigError)
                done = runner.invoke(build_app("command"), ["command", str(PAPER), "load-task", str(path),
                                                            "--set", "task.approach_s=0.5"])  # fmt: skip
                assert "load-task: accepted" in done.output, done.output
                assert rig.command("activate").accepted
                rig.wait_for("ACTIVE")
                assert "READY" in rig.load_task(SMALL).reason
                followed = (next(rig.telemetry())["setpoint_position"][:, 0] for _ in range(60))
                largest = max(np.nan_to_num(np.abs(setpoint)).max() for setpoint in followed)  # NaN until ACTIVE
                assert largest > 1e-5
                assert rig.command("stop").accepted
                rig.wait_for("READY")
                assert rig.command("activate_hold").accepted
                with rig.motion() as mover:
                    assert "kind = circle: while the axes hold, only paths" in rig.load_task(SMALL).reason
                    ended = mover.path({"x": [0.0, 1e-3, 0.0], "y": [0.0, 0.0, 1e-3]}, blend=1e-5).wait(30.0)
                    assert ended.setpoint == [0.0, 1e-3]
                    moving = mover.path({"x": [0.0, 1e-2], "y": [0.0, 0.0]}, speed=1e-2)
                    assert "its motion PATH" in rig.load_task(SMALL).reason
                    moving.cancel()
        finally:
            sidecar.terminate()
            sidecar.wait(20.0)
    report = replay_run(tmp_path / "run.mcap")
    assert report.ticks > 200
    assert report.different == 0
