"""The sidecar as a real process beside a stand-in for the control process: publishing, commands, recording, deaths."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from hil.cycle.tick import CommandKind
from hil.live.ring import RingReader
from hil.operate.monitor import silence
from hil.telemetry import codec, cycle_codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.blackbox import run_directory
from hil.telemetry.client import NoSidecarError, RigClient
from hil.telemetry.command_client import NoGatewayError, Verdict, local_client
from hil.telemetry.recording import Recording
from hil.telemetry.session import client_config
from hil.telemetry.sidecar import DRAINED
from tests.support.paths import ROOT

RIG = ROOT / "deploy" / "rigs" / "microscope-ideal.toml"


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Bench:
    """Starts processes in a private runtime directory and ends all of them."""

    def __init__(self, directory: Path) -> None:
        self.runtime = directory / "runtime"
        self.out = directory / "out"
        self.out.mkdir()
        self.endpoint = free_endpoint()
        self.environment = {**os.environ, "HIL_RUNTIME_DIR": str(self.runtime)}
        self.processes: list[subprocess.Popen[str]] = []

    def start(self, *arguments: str, until: str, cwd: Path = ROOT) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, *arguments], cwd=cwd, env=self.environment, stdout=subprocess.PIPE, text=True
        )
        self.processes.append(process)
        assert process.stdout
        for line in process.stdout:
            if until in line:
                return process
        raise AssertionError(f"{arguments} ended with {process.wait()} before it said {until!r}")

    def control(self, *arguments: str) -> subprocess.Popen[str]:
        return self.start("-m", "tests.support.fake_control", str(RIG), *arguments, until="up")

    def sidecar(self, out: Path | None = None) -> subprocess.Popen[str]:
        options = ["--out", str(out or self.out), "--listen", self.endpoint]
        return self.start("-m", "hil", "sidecar", str(RIG), *options, until="listening")

    def command(self, kind: CommandKind) -> Verdict:
        with local_client(self.runtime / "microscope-ideal") as client:
            return client.command(kind)

    def close(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.wait()
            if process.stdout:
                process.stdout.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def end(process: subprocess.Popen[str], number: int = signal.SIGTERM) -> int:
    process.send_signal(number)
    try:
        return process.wait(timeout=60)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGABRT)  # its faulthandler says on stderr where it stands
        process.wait(timeout=60)
        raise AssertionError(f"not ended 60 s after {signal.Signals(number).name}") from None


@contextlib.contextmanager
def ignored(number: int) -> Iterator[None]:
    """Processes started within ignore the signal, unless they ask for it."""
    previous = signal.signal(number, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(number, previous)


def eventually(client: RigClient, wanted: Callable[[pb.Status], bool], seconds: float = 60) -> pb.Status:
    until = time.monotonic() + seconds
    while not wanted(status := client.wait_status(seconds)):
        assert time.monotonic() < until, status
    return status


def obeyed(bench: Bench, kind: CommandKind) -> Verdict:
    """Ask, and ask again where the machine held the command up beyond its life of 0.3 s, as an operator would."""
    for _ in range(20):
        with contextlib.suppress(NoGatewayError):
            verdict = bench.command(kind)
            if not verdict.reason.startswith(("stale", "the control process did not")):
                break
    assert verdict.accepted, verdict.reason
    return verdict


def recorded(path: Path) -> tuple[list[codec.RecordedTick], Recording]:
    recording = Recording(path)
    messages = (pb.Cycle.FromString(item.data) for item in recording if item.topic == "cycle")
    return [tick for message in messages for tick in cycle_codec.recorded_ticks(message)], recording


@pytest.mark.live
def test_a_run_is_published_commanded_and_recorded_from_its_first_tick_to_its_last(bench: Bench) -> None:
    sidecar = bench.sidecar()
    control = bench.control()
    with RigClient(bench.endpoint) as client:
        status = eventually(client, lambda status: status.recording and status.produced > 100)
        assert (status.rig, status.state, list(status.axes)) == ("microscope-ideal", "READY", ["x", "y", "z", "theta"])
        assert status.realtime == "none: a test"
        assert status.control_alive
        assert obeyed(bench, CommandKind.ACTIVATE).state == "ACTIVE"
        reply = bench.command(CommandKind.ACTIVATE)
        assert (reply.accepted, reply.reason) == (False, "ACTIVATE is not possible in state ACTIVE")
        assert end(control) == 0
        status = eventually(client, lambda status: status.control_ended)
        assert status.produced == status.sent + status.dropped
        assert status.dropped == 0
    assert end(sidecar) == 0
    ticks, recording = recorded(bench.out / "run.mcap")
    assert not recording.truncated
    assert recording.metadata["rig"]["name"] == "microscope-ideal"
    assert [tick.ring for tick in ticks] == list(range(status.produced))
    assert [command.kind for tick in ticks for command in tick.tick.commands] == [CommandKind.ACTIVATE] * 2
    assert all(len(tick.received) == 4 for tick in ticks)
    assert any(tick.tick.recorder_ok for tick in ticks)


@pytest.mark.live
def test_a_subscriber_without_this_package_decodes_every_tick(bench: Bench, tmp_path: Path) -> None:
    bench.sidecar()
    bench.control()
    script = ROOT / "tests" / "support" / "plain_subscriber.py"
    arguments = [sys.executable, str(script), bench.endpoint, "300"]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines() if "gap" not in line]
    assert len(lines) == 300
    assert [line[1] for line in lines] == ["READY"] * 300
    assert [word.partition("=")[0] for word in lines[0][2:]] == ["x", "y", "z", "theta"]
    sequence = [int(line[0]) for line in lines]
    gaps = sum(int(line.split()[2]) for line in done.stdout.splitlines() if "gap" in line)
    assert sequence[-1] - sequence[0] == 299 + gaps


@pytest.mark.live
def test_a_killed_control_process_is_reported_and_its_last_tick_is_recorded(bench: Bench) -> None:
    bench.sidecar()
    control = bench.control()
    with RigClient(bench.endpoint) as client:
        eventually(client, lambda status: status.produced > 100)
        end(control, signal.SIGKILL)
        status = eventually(client, lambda status: not status.control_alive and not status.recording)
        assert not status.control_ended
        reply = bench.command(CommandKind.STOP)
        assert (reply.accepted, reply.reason) == (False, "no control process is running this rig")
        ticks, recording = recorded(bench.out / "run.mcap")
        assert not recording.truncated
        assert len(ticks) == status.produced
        bench.control()  # the next one gets a recording of its own, and is judged by its own sequence numbers
        eventually(client, lambda status: status.control_alive and status.recording)
        obeyed(bench, CommandKind.ACTIVATE)
    assert (bench.out / "run-2.mcap").exists()
    assert not (bench.runtime / "microscope-ideal" / "ring.previous").exists()


@pytest.mark.live
def test_a_sidecar_that_dies_leaves_a_readable_recording_and_its_successor_carries_on(
    bench: Bench, tmp_path: Path
) -> None:
    first = bench.sidecar()
    bench.control()
    with RigClient(bench.endpoint) as client:
        eventually(client, lambda status: status.recording and len(recorded(bench.out / "run.mcap")[0]) > 100)
        end(first, signal.SIGKILL)
        ticks, recording = recorded(bench.out / "run.mcap")
        assert recording.truncated
        assert [tick.ring for tick in ticks] == list(range(len(ticks)))
        assert len(ticks) > 100
        bench.sidecar(tmp_path / "second")
        status = eventually(client, lambda status: status.recording)
        assert status.dropped <= DRAINED  # the ring still held what the first one had not seen; one batch was under way
        obeyed(bench, CommandKind.ACTIVATE)


@pytest.mark.live
def test_a_rig_that_is_not_recorded_leaves_no_folder(bench: Bench, tmp_path: Path) -> None:
    unrecorded = ["--set", "telemetry.record=false", "--listen", bench.endpoint]
    sidecar = bench.start("-m", "hil", "sidecar", str(RIG), *unrecorded, until="listening", cwd=tmp_path)
    control = bench.control()
    with RigClient(bench.endpoint) as client:
        status = eventually(client, lambda status: status.index > 10)
        assert not status.recording
    assert (end(control), end(sidecar)) == (0, 0)
    assert not (tmp_path / "runs").exists()


@pytest.mark.live
def test_a_sidecar_that_met_no_control_process_leaves_no_folder(bench: Bench, tmp_path: Path) -> None:
    arguments = ["-m", "hil", "sidecar", str(RIG), "--listen", bench.endpoint]
    sidecar = bench.start(*arguments, until="listening", cwd=tmp_path)
    assert len(list((tmp_path / "runs").iterdir())) == 1
    assert end(sidecar) == 0
    assert list((tmp_path / "runs").iterdir()) == []


def test_runs_that_begin_in_one_second_have_a_folder_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.strftime", lambda _: "20260101-120000")
    assert [run_directory().name for _ in range(3)] == ["20260101-120000", "20260101-120000-2", "20260101-120000-3"]


@pytest.mark.live
def test_without_a_sidecar_the_black_box_holds_the_last_ticks(bench: Bench) -> None:
    control = bench.control("1000")
    control.wait(timeout=60)
    control = bench.control()
    with RingReader(bench.runtime / "microscope-ideal" / "ring") as reader:
        while reader.written < 100:
            assert control.poll() is None
    end(control, signal.SIGKILL)
    bench.start("-m", "hil", "blackbox", str(RIG), "--out", str(bench.out), until="saved")
    ticks, recording = recorded(bench.out / "blackbox.mcap")
    assert [tick.ring for tick in ticks] == list(range(len(ticks)))
    assert len(ticks) >= 100
    assert recording.metadata["rig"]["name"] == "microscope-ideal"
    bench.start("-m", "hil", "blackbox", str(RIG), "--out", str(bench.out), until="nothing to save")


@pytest.mark.live
def test_the_example_subscriber_of_the_readme_prints_the_stage(bench: Bench) -> None:
    bench.sidecar()
    bench.control()
    example = ROOT / "deploy" / "examples" / "subscribe.py"
    assert len(example.read_text().splitlines()) <= 20
    with ignored(signal.SIGINT):  # as a shell's background jobs start
        process = bench.start(str(example), bench.endpoint, until="x=")
    assert end(process, signal.SIGINT) == 0


@pytest.mark.live
def test_what_others_publish_as_a_status_does_not_end_those_who_watch(bench: Bench) -> None:
    bench.sidecar()
    with RigClient(bench.endpoint) as client, zenoh.open(client_config(bench.endpoint)) as other:
        client.wait_status(10.0)
        for _ in range(20):
            other.put("hil/microscope-ideal/status", b"\xff\xff no status")
        assert eventually(client, lambda status: status.rig == "microscope-ideal")


def test_of_a_stopped_sidecar_whose_kernel_still_accepts_an_operator_hears_sooner_than_zenoh_itself_would_say() -> None:
    assert json.loads(client_config(free_endpoint()).get_json("transport/unicast/open_timeout")) < 3000  # ms, not 10 s


@pytest.mark.live
def test_a_second_sidecar_of_a_rig_is_refused_and_the_first_ones_operators_are_still_obeyed(bench: Bench) -> None:
    bench.sidecar()
    bench.control()
    for options in (["--listen", bench.endpoint], ["--listen", free_endpoint()]):
        second = subprocess.run(
            [sys.executable, "-m", "hil", "sidecar", str(RIG), "--out", str(bench.out), *options],
            env=bench.environment,
            capture_output=True,
            text=True,
            cwd=ROOT,
            timeout=30,
        )
        assert second.returncode == 69
        assert "another sidecar serves this rig already" in second.stderr
    obeyed(bench, CommandKind.ACTIVATE)  # the stand-in for the control process knows no ESTOP


def test_an_endpoint_in_use_is_reported_by_name_with_its_own_exit_status(bench: Bench) -> None:
    host, port = bench.endpoint.removeprefix("tcp/").split(":")
    with socket.create_server((host, int(port))):
        result = subprocess.run(
            [sys.executable, "-m", "hil", "sidecar", str(RIG), "--out", str(bench.out), "--listen", bench.endpoint],
            env=bench.environment,
            capture_output=True,
            text=True,
            cwd=ROOT,
            timeout=30,
        )
    assert result.returncode == 69
    assert f"cannot listen on {bench.endpoint}" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_client_without_a_sidecar_says_what_to_start() -> None:
    with RigClient(free_endpoint()) as client, pytest.raises(NoSidecarError, match="hil sidecar"):
        client.wait_status(0.1)


@pytest.mark.live
def test_a_new_sidecar_tells_no_state_before_it_has_caught_up(bench: Bench) -> None:
    """The ring of a process that was stopped for a while holds what was, not what is."""
    control = bench.control()
    with RingReader(bench.runtime / "microscope-ideal" / "ring") as reader:
        while reader.written < 5000:  # more than a sidecar reads in one round
            assert control.poll() is None
            time.sleep(0.05)
        bench.sidecar()
        with RigClient(bench.endpoint) as client:
            first = eventually(client, lambda status: bool(status.state))
            assert first.index > 5000
            assert first.now_ns - first.tick_ns < 1_000_000_000
            os.kill(control.pid, signal.SIGSTOP)
            hung = eventually(client, lambda status: status.now_ns - status.tick_ns > 500_000_000)
            assert hung.control_alive
            assert "THE CONTROL PROCESS HANGS" in silence(hung, 0.0)
            verdict = bench.command(CommandKind.STOP)
            assert (verdict.accepted, verdict.reason) == (False, "the control process did not take it")
            assert "s ago, nothing since" in verdict.state
            os.kill(control.pid, signal.SIGCONT)
            eventually(client, lambda status: status.now_ns - status.tick_ns < 100_000_000)


@pytest.mark.live
def test_every_request_is_in_the_recording(bench: Bench) -> None:
    sidecar = bench.sidecar()
    control = bench.control()
    with RigClient(bench.endpoint) as client:
        eventually(client, lambda status: status.recording and status.produced > 100)
    obeyed(bench, CommandKind.ACTIVATE)
    assert not bench.command(CommandKind.HOME).accepted
    assert (end(control), end(sidecar)) == (0, 0)
    entries = [pb.CommandEntry.FromString(m.data) for m in Recording(bench.out / "run.mcap") if m.topic == "commands"]
    assert [(entry.kind, entry.accepted) for entry in entries][-2:] == [(1, True), (5, False)]
    assert all(entry.who.startswith(f"uid {os.getuid()} (pid ") for entry in entries)
    assert entries[-1].reason == "HOME is not possible in state ACTIVE"
