"""Replay: the same frames in give the same torque frames out, byte for byte; and any difference is found."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rich.console import Console

from drivers.frame import Frame
from hil import Recording as RunRecording
from hil.cycle.tick import CycleResult, Tick
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.runs.summary import load_run, summarise
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.recorder import LockstepRecorder
from hil.telemetry.recording import Recording, RecordingError
from hil.telemetry.tick_schema import TickSchema
from hil.virtual.replay import Replayed, exact_motion, replay_run
from hil.virtual.replay_command import _show_replay
from hil.virtual.sim import simulate
from tests.support.command_line import CommandLine
from tests.support.earlier_layout import Change, unchanged, write_earlier
from tests.support.paths import ROOT
from tests.support.records import kept, table

RIG_FILE = ROOT / "deploy" / "rigs" / "microscope-ideal.toml"
SECONDS = 1.2


@pytest.fixture(scope="module")
def rig() -> RigConfig:
    return load_rig(RIG_FILE, ["plant.modelling_error=[0.1, 0.1, 0.05, 0.0]", "wire.drop_probability=0.002"])


@pytest.fixture(scope="module")
def both(rig: RigConfig, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A recording, and the records of its ticks."""
    path = tmp_path_factory.mktemp("lockstep") / "run.mcap"
    recorder = LockstepRecorder(path, rig, RIG_FILE)
    records: list[np.ndarray] = []

    def observe(tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        recorder.observe(tick, frames, result)
        records.append(kept(result.record))

    simulate(rig, RIG_FILE.parent, SECONDS, observer=observe)
    recorder.close()
    return path, table(records)


@pytest.fixture(scope="module")
def recording(both: tuple[Path, np.ndarray]) -> Path:
    return both[0]


def rewritten(both: tuple[Path, np.ndarray], target: Path, change: Change = unchanged) -> Path:
    """The same run in the earlier layout, its traffic changed."""
    return write_earlier(target, Recording(both[0]).metadata, both[1], change)


def test_a_recording_of_the_earlier_layout_replays_byte_for_byte_and_gives_the_same_columns(
    both: tuple[Path, np.ndarray], tmp_path: Path
) -> None:
    earlier = rewritten(both, tmp_path / "earlier.mcap")
    report = replay_run(earlier)
    assert (report.ticks, report.different, report.gap_at, report.truncated) == (1200, 0, None, False)
    exact = exact_motion(both[0])
    assert exact is not None
    old, new = load_run(earlier).columns, load_run(both[0])
    assert new.counters.sent == int(both[1]["port"][-1][1])
    followed = np.isfinite(old["following_error"])
    assert followed.any()
    assert np.array_equal(old["following_error"][followed], exact["following_error"][followed])
    steps = TickSchema(new.metadata["rig"]).scales
    for axis, name in enumerate(steps):
        for field in ("position", "velocity_estimate", "force"):
            difference = np.abs(old[field][:, axis] - new.columns[field][:, axis])
            assert difference.max() <= steps[name][field].step / 2, (name, field)
    for field in ("index", "scheduled_ns", "state", "fault", "task_ns"):
        assert np.array_equal(old[field], new.columns[field]), field


@pytest.mark.requirement(id="SR-9.2")
def test_a_lockstep_run_with_lost_frames_replays_byte_for_byte(recording: Path) -> None:
    report = replay_run(recording)
    assert (report.ticks, report.different, report.gap_at, report.truncated) == (1200, 0, None, False)
    assert report.frames > 1100


def test_one_changed_bit_of_one_sent_frame_is_found(both: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    def flip(message: pb.Traffic, number: int) -> pb.Traffic:
        if number == 10:
            data = bytearray(message.sent.data)
            data[3] ^= 1
            message.sent.data = bytes(data)
        return message

    report = replay_run(rewritten(both, tmp_path / "x.mcap", flip))
    assert (report.ticks, report.different, report.first_different) == (1200, 1, 500)


def test_a_changed_sample_changes_the_torque(both: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    def shift(message: pb.Traffic, number: int) -> pb.Traffic:
        if number == 20:
            message.now_ns[0] += 200_000
        return message

    assert replay_run(rewritten(both, tmp_path / "x.mcap", shift)).different > 0


def test_a_replay_that_compared_nothing_says_so_and_fails(
    both: tuple[Path, np.ndarray], tmp_path: Path, hil_here: CommandLine
) -> None:
    empty = rewritten(both, tmp_path / "empty.mcap", lambda message, number: None)
    done = hil_here("replay", str(empty))
    assert done.returncode == 1
    assert "nothing was compared" in done.stdout
    assert "every torque frame is the same" not in done.stdout


def test_a_gap_ends_the_replay_and_is_named(both: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    report = replay_run(rewritten(both, tmp_path / "x.mcap", lambda message, n: None if n == 4 else message))
    assert (report.ticks, report.different, report.gap_at) == (200, 0, 200)


def test_a_recording_cut_short_replays_as_far_as_it_goes(recording: Path, tmp_path: Path) -> None:
    whole = recording.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    report = replay_run(path)
    assert report.truncated
    assert 0 < report.ticks < 1200
    assert report.different == 0


@pytest.mark.long
def test_a_recording_with_any_bit_wrong_is_replayed_up_to_there_or_refused_but_never_blamed_on_the_cycle(
    recording: Path, tmp_path: Path
) -> None:
    whole = recording.read_bytes()
    path = tmp_path / "damaged.mcap"
    described = whole.index(b'"rig"')
    outcomes = set()
    for place in range(described, len(whole), len(whole) // 20):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            report = replay_run(path)
            load_run(path)
        except (RecordingError, RigError):
            outcomes.add("refused")
        else:
            assert report.different == 0
            outcomes.add("cut short" if report.truncated else "whole")
    assert "cut short" in outcomes


@pytest.mark.parametrize(("digit", "other"), [(b'"bandwidth": [0.2573', b"4"), (b'"rate_hz": 1000.0', b"2")])
def test_a_rig_with_one_digit_changed_is_refused_and_not_blamed_on_the_cycle(
    both: tuple[Path, np.ndarray], tmp_path: Path, digit: bytes, other: bytes, hil_here: CommandLine
) -> None:
    described = json.dumps(Recording(both[0]).metadata).encode()
    assert digit in described
    path = tmp_path / "edited.mcap"
    write_earlier(path, json.loads(described.replace(digit, digit[:-1] + other, 1)), both[1])
    result = hil_here("replay", str(path))
    assert result.returncode == 1
    assert result.stderr.startswith(f"hil replay: {path}: its rig does not have the hash that was recorded with it")


def test_one_damaged_description_of_two_is_told_and_costs_nothing(
    recording: Path, tmp_path: Path, hil_here: CommandLine
) -> None:
    path = tmp_path / "flipped.mcap"
    path.write_bytes(recording.read_bytes().replace(b'"rate_hz": 1000.0', b'"rate_hz": 2000.0', 1))
    result = hil_here("replay", str(path))
    assert result.returncode == 1
    assert "1200 ticks" in result.stdout
    assert "the file is damaged" in result.stdout


@pytest.mark.parametrize("description", [b"", b"[]", b"{}", b'{"rig": 5, "rig_hash": "", "version": ""}', b"\xff"])
def test_a_recording_without_a_rig_is_refused(recording: Path, tmp_path: Path, description: bytes) -> None:
    path = tmp_path / "strange.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_attachment(0, 0, "run.json", "application/json", description)
        writer.finish()
    with pytest.raises(RecordingError, match="damaged"):
        replay_run(path)


def test_traffic_that_no_control_process_can_have_caused_is_refused(
    both: tuple[Path, np.ndarray], tmp_path: Path
) -> None:
    def nonsense(message: pb.Traffic, number: int) -> pb.Traffic:
        if number == 2:
            del message.received.can_id[-1]
        return message

    def oversized(message: pb.Traffic, number: int) -> pb.Traffic:
        message.received.flags[0] = 2**32 - 1
        return message

    def crowded(message: pb.Traffic, number: int) -> pb.Traffic:
        message.received_count[0] = 33
        return message

    def endless(message: pb.Traffic, number: int) -> pb.Traffic:
        message.port[0] = 2**64 - 1
        return message

    def ancient(message: pb.Traffic, number: int) -> pb.Traffic:
        message.received.timestamp_ns[0] = -(2**63)
        return message

    def futuristic(message: pb.Traffic, number: int) -> pb.Traffic:
        message.now_ns[0] = 2**63 - 1
        return message

    for change in (nonsense, oversized, crowded, endless, ancient, futuristic):
        with pytest.raises(RecordingError, match="makes no sense"):
            replay_run(rewritten(both, tmp_path / "x.mcap", change))


def test_a_law_the_rig_cannot_have_is_refused_by_name(recording: Path) -> None:
    with pytest.raises(RigError, match=r"law\.name = 'magic'"):
        replay_run(recording, ("law.name=magic",))


def test_another_law_is_shown_by_what_it_would_have_asked_for(recording: Path) -> None:
    bandwidth = load_rig(RIG_FILE).law.effective_gains()["bandwidth"]
    same = replay_run(recording, (f"law.gains.bandwidth={bandwidth}",))
    other = replay_run(recording, (f"law.gains.bandwidth={[0.5 * bandwidth[0], *bandwidth[1:]]}",))
    assert (same.different, other.different) == (0, 0)
    assert same.other_force is not None
    assert other.other_force is not None
    assert all(row == {"rms": 0.0, "max": 0.0} for row in same.other_force.values())
    assert other.other_force["x"]["max"] > 0
    assert other.other_force["y"]["max"] == 0


@pytest.mark.long
def test_the_command_writes_its_report_and_its_exit_status_tells(
    recording: Path, tmp_path: Path, hil_here: CommandLine
) -> None:
    result = hil_here("replay", str(recording), "--json", "-")
    report = json.loads(result.stdout)
    assert (result.returncode, report["ticks"], report["different"]) == (0, 1200, 0)
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"nothing")
    result = hil_here("replay", str(bad))
    assert result.returncode == 1
    assert "bad.mcap: not a recording" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_summary_is_made_of_what_was_recorded(recording: Path, rig: RigConfig) -> None:
    run = load_run(recording)
    summary = summarise(run)
    assert (summary["rig"], summary["ticks"], summary["final_state"]) == ("microscope-ideal", 1200, "ACTIVE")
    assert run.rig == rig
    assert summary["telemetry"] == {"produced": 1200, "sent": 1200, "dropped": 0}
    error = run.error[summary["steady_from_tick"] :, 0]
    largest = np.nanmax(np.abs(error))
    assert summary["axes"]["x"]["max_error"] == largest
    assert 0 < summary["axes"]["x"]["rms_error"] < largest
    assert np.isnan(run.error[0]).all()  # no task before ACTIVE


def test_a_recorder_that_cannot_write_says_so(rig: RigConfig) -> None:
    with pytest.raises(OSError, match=r"cannot be written: .*/proc/nowhere/run\.mcap"):
        LockstepRecorder(Path("/proc/nowhere/run.mcap"), rig, RIG_FILE)


EARLIER = ROOT / "tests" / "reference" / "recording-0.1.0.mcap"


def test_a_recording_of_the_first_version_opens_and_replays_or_both_versions_are_named() -> None:
    """Written by 0.1.0 itself: 0.3 s of the paper's rig."""
    report = replay_run(EARLIER)
    assert report.ticks == 300
    assert report.different == 0 or "0.1.0" in report.other_version
    run = RunRecording(EARLIER)
    assert run.metadata["version"] == "0.1.0"
    assert len(run.time) == 300
    assert run.state[-1] == "ACTIVE"


def test_what_another_version_recorded_is_refused_or_differs_with_both_versions_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.metadata.version", lambda _: "9.9.9")
    assert replay_run(EARLIER).other_version == "recorded by hil 0.1.0; this is hil 9.9.9"
    with pytest.raises(RigError, match=r"recorded by hil 0\.1\.0; this is hil 9\.9\.9"):
        replay_run(EARLIER, ("rate_hz=0",))
    report = Replayed("run.mcap", "paper", "", "0.1.0", ticks=1, frames=1, different=1, first_different=0)
    report.other_version = "recorded by hil 0.1.0; this is hil 9.9.9"
    _show_replay(report, Console(), EARLIER)
    assert "recorded by hil 0.1.0; this is hil 9.9.9" in capsys.readouterr().out
