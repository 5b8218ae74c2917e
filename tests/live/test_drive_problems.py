"""Why drives were refused reaches the journal, the sidecar's file and the monitor."""

from pathlib import Path

import pytest

from drivers.frame import Frame
from drivers.protocols.base import Command, HostProtocol
from drivers.protocols.mounting import MountedHost, Mounting
from hil.live.drive_problems import DriveProblems, read_problems
from hil.operate.monitor import control_line
from hil.telemetry import telemetry_pb2 as pb
from sim_plant.drives.object_dictionary import key_of
from tests.support.canopen_bench import Bench


def test_a_refusal_is_told_once_and_read_by_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "problems"
    path.write_text("of a run before\n")
    problems = DriveProblems(path)
    assert read_problems(path) == []
    for _ in range(3):
        problems.tell(["node 3: 6502h = 0x5"])
    problems.tell(["node 3: 6502h = 0x5", "node 4: 1000h"])
    assert read_problems(path) == ["node 3: 6502h = 0x5", "node 4: 1000h"]
    assert capsys.readouterr().err.splitlines() == [
        "hil run: drive not ready: node 3: 6502h = 0x5",
        "hil run: drive not ready: node 4: 1000h",
    ]
    problems.tell([])
    assert read_problems(path) == []


def test_a_runtime_directory_that_is_gone_does_not_end_the_loop(tmp_path: Path) -> None:
    problems = DriveProblems(tmp_path / "gone" / "problems")
    problems.tell(["node 3: 6502h = 0x5"])
    assert problems.told == ("node 3: 6502h = 0x5",)


def test_the_monitor_shows_it_under_the_state() -> None:
    status = pb.Status(state="BOOT", control_alive=True, drive_problems=["node 3: 6502h:00 aborted"])
    assert "drive not ready: node 3: 6502h:00 aborted" in control_line(status).plain


def test_mounted_drives_say_it_too() -> None:
    bench = Bench()
    bench.tick()  # resets communication, and 1000h with it
    bench.drives[0].dictionary.values[key_of(0x1000)] = 0x191
    bench.tick(60)
    host: HostProtocol = MountedHost(bench.host, [Mounting(direction=-1)] * 4)
    assert host.encode(Command(0, [0.0] * 4, 0, False))[0] == Frame(0x201, bytes(8))
    assert host.problems == bench.host.problems
    assert "1000h = 0x191" in host.problems[0]
