"""The emulated stage behind a frame layout: sampling, answers, watchdogs, and the process that runs it live."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus.port import Port, open_port
from drivers.config import BusConfig, DrivesConfig
from drivers.frame import Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import Command, DriveStatus, HostProtocol, Reject, Sample
from sim_plant.config import PlantConfig
from sim_plant.drives.servo import NEVER_NS
from sim_plant.emulator import EmulatedStage
from sim_plant.process import Emulator, Rhythm, StopSignals
from tests.support.paths import ROOT

MS = 1_000_000
AXES = ["x", "y", "z"]
RATED = [5.0, 5.0, 10.0]
PLANT = PlantConfig(
    mass=[0.5, 0.3, 0.25],
    coulomb=[0.4, 0.2, 0.2],
    viscous=[1.0, 1.0, 1.0],
    quadratic=[0.0, 0.0, 0.0],
    gravity=[0.0, 0.0, -2.5],
    encoder_resolution=1e-8,
    brake_force=40.0,
)
DRIVES = DrivesConfig(brake=[False, False, True])


def make(protocol: str = "stage_fd", start_ns: int = 0) -> tuple[EmulatedStage, HostProtocol]:
    bus = BusConfig(protocol=protocol)
    stage = EmulatedStage(PLANT, bus, AXES, RATED, Path(), start_ns, drives=DRIVES)
    return stage, host_protocol(bus, len(AXES), RATED, Path())


def frame(host: HostProtocol, at_ns: int, sequence: int, force: list[float]) -> Frame:
    return host.encode(Command(sequence, force, 0b111, False))[0]._replace(timestamp_ns=at_ns)


def samples(host: HostProtocol, answers: list[Frame], at_ns: int) -> list[Sample]:
    decoded = [host.decode(answer._replace(timestamp_ns=at_ns)) for answer in answers]
    assert not any(isinstance(item, Reject) for item in decoded)
    return decoded  # type: ignore[return-value]


@pytest.mark.parametrize("protocol", ["stage_fd", "stage_classic"])
def test_drives_sample_at_the_command_and_apply_its_force_from_then_on(protocol: str) -> None:
    stage, host = make(protocol)
    stage.on_frame(frame(host, 1 * MS, 1, [2.0, 0.0, 2.5]))
    answers = stage.on_frame(frame(host, 2 * MS, 2, [0.0, 0.0, 2.5]))
    got = samples(host, answers, 2 * MS)
    moved = 0.5 * (2.0 - 0.4) / 0.5 * 1e-3**2  # after 1 ms of 2 N
    assert [sample.axis for sample in got] == [0, 1, 2]
    assert got[0].position * 1e-8 == pytest.approx(moved, abs=1.1e-8)
    assert (got[1].position, got[2].position) == (0, 0)
    assert [sample.sequence for sample in got] == [2, 2, 2]
    assert all(sample.status & DriveStatus.ENABLED for sample in got)
    assert stage.applied_force == pytest.approx([0.0, 0.0, 2.5], abs=0.005)  # the classic layout's step
    assert [stage.sender_of(answer) for answer in answers] == AXES


def test_every_drive_is_at_zero_exactly_one_watchdog_after_its_last_valid_command() -> None:
    stage, host = make()
    stage.on_frame(frame(host, 1 * MS + 137, 1, [1.0, -1.0, 3.0]))
    stage.on_frame(frame(host, 5 * MS, 1, [1.0, -1.0, 3.0]))  # a replay feeds nothing
    assert stage.deadline_ns == 11 * MS + 137
    stage.advance(11 * MS + 136)
    assert stage.applied_force[0] == 1.0
    stage.advance(200 * MS)
    assert stage.applied_force == [0.0, 0.0, 0.0]
    assert [drive.trips[0].expired_ns for drive in stage.drives] == [11 * MS + 137] * 3
    assert stage.deadline_ns == NEVER_NS


def test_when_the_stage_is_asked_makes_no_difference_to_what_happens() -> None:
    (asked, host), (left_alone, _) = make(), make()
    for k in range(1, 60):
        command = frame(host, k * MS, k, [2.0 * (-1) ** (k // 7), 1.0, 2.7])
        assert asked.on_frame(command) == left_alone.on_frame(command)
        for part in range(4):
            asked.advance(k * MS + part * 200_000)
            assert asked.position.shape == (3,)
    assert asked.sampled == left_alone.sampled


def test_z_stays_up_by_its_brake_without_a_host_and_after_the_host_is_gone() -> None:
    stage, host = make()
    stage.advance(1000 * MS)
    assert stage.position[2] == 0.0
    stage.on_frame(frame(host, 1001 * MS, 1, [0.0, 0.0, 2.5]))
    stage.advance(3000 * MS)
    assert stage.drives[2].status & DriveStatus.BRAKE
    assert abs(stage.position[2]) < 1e-6


def test_a_brake_that_takes_time_holds_the_axis_until_then() -> None:
    slow = DRIVES.model_copy(update={"brake_opening_s": 0.0205})
    bus = BusConfig(protocol="stage_fd")
    stage = EmulatedStage(PLANT, bus, AXES, RATED, Path(), drives=slow)
    host = host_protocol(bus, len(AXES), RATED, Path())
    for tick in range(1, 30):
        stage.on_frame(frame(host, tick * MS, tick, [0.0, 0.0, 0.0]))
        closed = bool(stage.drives[2].status & DriveStatus.BRAKE)
        assert closed == (tick < 22), "the first force, 20.5 ms, and the command behind that"
        assert (stage.position[2] < 0.0) != closed, "it falls without a force that holds it"
    assert abs(stage.position[0]) == 0.0


def test_frames_that_are_no_command_are_counted_and_change_nothing() -> None:
    stage, host = make()
    good = frame(host, 1 * MS, 1, [1.0, 0.0, 0.0])
    bad = good._replace(data=bytes([good.data[0] ^ 1]) + good.data[1:])
    assert stage.on_frame(bad) == []
    assert stage.on_frame(Frame(0x7FF, b"\0" * 8, 0, 1 * MS)) == []
    assert stage.rejected[Reject.BAD_CHECKSUM] == 1
    assert stage.rejected[Reject.UNKNOWN_ID] == 1
    assert stage.deadline_ns == NEVER_NS


def test_an_intact_frame_that_asks_for_the_impossible_faults_every_drive() -> None:
    stage, host = make()
    stronger = host_protocol(BusConfig(), len(AXES), [50.0, 50.0, 50.0], Path())
    stage.on_frame(frame(host, 1 * MS, 1, [1.0, 1.0, 2.5]))
    assert stage.on_frame(frame(stronger, 2 * MS, 2, [20.0, 0.0, 0.0])) == []
    assert all(drive.status & DriveStatus.FAULT for drive in stage.drives)
    assert stage.applied_force == [0.0, 0.0, 0.0]


def test_a_frame_stamped_in_the_past_counts_as_received_now() -> None:
    stage, host = make()
    stage.on_frame(frame(host, 5 * MS, 1, [1.0, 0.0, 0.0]))
    stage.on_frame(frame(host, 4 * MS, 2, [1.0, 0.0, 0.0]))
    assert stage.drives[0].last_command_ns == 5 * MS


def test_canopen_drives_start_up_by_their_own_rules_on_the_same_physics() -> None:
    bus = BusConfig(protocol="cia402", node_id=3)
    stage = EmulatedStage(PLANT, bus, AXES, RATED, Path())
    assert not stage.fd
    boot = stage.advance(MS)
    assert [answer.can_id for answer in boot] == [0x703, 0x704, 0x705]  # boot-up messages
    assert [stage.sender_of(answer) for answer in boot] == AXES


def live_pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Emulator, HostProtocol, Port]:
    """A stage on a live bus, and who commands it there; the stage has taken the newcomer in."""
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    bus = BusConfig(interface="local", channel="emu0")
    stage = EmulatedStage(PLANT, bus, AXES, RATED, Path(), time.monotonic_ns())
    emulator = Emulator(stage, open_port(bus, role="device", fd=True), tmp_path / "status.json")
    control = open_port(bus, role="host", fd=True)
    emulator.step(time.monotonic_ns())
    return emulator, host_protocol(bus, len(AXES), RATED, Path()), control


def test_on_a_live_bus_a_stall_of_the_emulator_expires_no_watchdog_that_was_fed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, host, control = live_pair(tmp_path, monkeypatch)
    start_ns = time.monotonic_ns()
    for sequence in range(1, 9):  # the emulator does not run meanwhile; the frames wait with their stamps
        control.send(frame(host, 0, sequence, [0.5, 0.0, 2.5]))
    sent_ns = time.monotonic_ns()
    emulator.step(time.monotonic_ns())
    answers = control.drain(time.monotonic_ns())
    assert len(answers) == 8 * len(AXES)
    stamps = {sample.stamp_ns for sample in samples(host, answers, sent_ns)}
    assert start_ns <= min(stamps)
    assert max(stamps) <= sent_ns
    last_ns = emulator.stage.drives[0].last_command_ns
    emulator.step(last_ns + 500 * MS)  # half a second later
    status = json.loads((tmp_path / "status.json").read_text())
    for axis in AXES:
        trip = status["axes"][axis]["trips"][0]
        assert trip["zero_after_ms"] == 10.0
        assert trip["last_command_ns"] == last_ns
    control.close()
    emulator.port.close()


def test_commands_at_a_steady_rate_are_fetched_a_little_after_each_is_due() -> None:
    """So that no command has to wake the stage, at the control loop's expense."""
    rhythm = Rhythm()
    assert rhythm.fetch_ns() <= 0  # nobody has spoken: wait for whoever does
    for number in range(4):
        rhythm.heard(10 * MS + number * MS)
    rhythm.heard(13 * MS)  # looked again, nothing new
    assert rhythm.fetch_ns() == 13 * MS + MS + MS // 10
    rhythm.heard(15 * MS)  # one was left out: its successor is due as ever
    assert rhythm.fetch_ns() == 15 * MS + MS + MS // 10


def test_a_command_before_its_time_waits_for_the_stage_not_the_stage_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, host, control = live_pair(tmp_path, monkeypatch)
    now_ns = time.monotonic_ns()
    for number in (3, 2, 1):
        emulator.rhythm.heard(now_ns - number * 4 * MS)
    emulator.rhythm.heard(now_ns)
    control.send(frame(host, 0, 1, [0.5, 0.0, 2.5]))
    with StopSignals() as stop:
        emulator.wait(stop)
        assert time.monotonic_ns() >= emulator.rhythm.fetch_ns()
        emulator.step(time.monotonic_ns())
    assert len(control.drain(time.monotonic_ns())) == len(AXES)
    control.close()
    emulator.port.close()


def test_who_speaks_seldom_or_falls_silent_is_waited_for_not_looked_for() -> None:
    rhythm = Rhythm()
    for number in range(4):
        rhythm.heard(number * 50 * MS)
    assert rhythm.fetch_ns() <= 150 * MS
    for number in range(3):
        rhythm.heard((200 + number) * MS)
    assert rhythm.fetch_ns() < 204 * MS  # then, with nothing there, it is past: wait


@given(gap=st.integers(200_000, 4 * MS), jitter=st.lists(st.integers(-20_000, 20_000), min_size=4, max_size=40))
def test_a_rhythm_that_trembles_is_fetched_after_each_command_and_before_the_one_after(
    gap: int, jitter: list[int]
) -> None:
    stamps = [MS + number * gap + shake for number, shake in enumerate(jitter)]
    rhythm = Rhythm()
    for number, stamp in enumerate(stamps[:-1]):
        rhythm.heard(stamp)
        if number >= 2:
            assert stamp < rhythm.fetch_ns() < stamps[number + 1] + gap


@pytest.mark.long
def test_telling_the_status_leaves_no_garbage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The collector is off in this process: what only it would find would stay for good."""
    emulator, _, control = live_pair(tmp_path, monkeypatch)
    seconds = iter(range(1, 301))

    def garbage_of_hundred_seconds() -> int:
        gc.collect()
        for _ in range(100):
            emulator.step(time.monotonic_ns() + next(seconds) * 10**9)
        return gc.collect()

    gc.disable()
    try:  # what other tests of this worker left behind is found once; what telling leaves, every time
        assert min(garbage_of_hundred_seconds() for _ in range(3)) == 0
    finally:
        gc.enable()
    control.close()
    emulator.port.close()


def test_a_status_file_that_cannot_be_written_does_not_end_the_stage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, _, control = live_pair(tmp_path, monkeypatch)
    # It stands in the way, as a full file system or a removed directory would.
    (tmp_path / f"status.json.{os.getpid()}.new").mkdir()
    before = (tmp_path / "status.json").read_text()
    emulator.step(time.monotonic_ns() + 10**9)
    assert "status.json: Is a directory" in emulator.status_error
    assert (tmp_path / "status.json").read_text() == before
    control.close()
    emulator.port.close()


def test_on_a_live_bus_canopen_drives_announce_themselves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    bus = BusConfig(interface="local", channel="emu1", protocol="cia402")
    stage = EmulatedStage(PLANT, bus, AXES, RATED, Path(), time.monotonic_ns())
    control = open_port(bus, role="host", fd=False)
    emulator = Emulator(stage, open_port(bus, role="device", fd=False))
    emulator.step(time.monotonic_ns())
    assert [frame.can_id for frame in control.drain(time.monotonic_ns())] == [0x701, 0x702, 0x703]
    control.close()
    emulator.port.close()


@pytest.mark.parametrize(("share", "told"), [(0.93, 1), (0.85, 0)])
def test_a_stage_that_takes_all_of_a_core_says_so_once(
    share: float, told: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Live, its answers would come later and later, and whoever waits for READY would not know why."""
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    bus, cpu_ns = BusConfig(interface="local", channel="emu2"), 0
    monkeypatch.setattr("sim_plant.process.time.process_time_ns", lambda: cpu_ns)
    said: list[float] = []
    stage = EmulatedStage(PLANT, bus, AXES, RATED, Path(), time.monotonic_ns())
    emulator = Emulator(
        stage, open_port(bus, role="device", fd=True), tmp_path / "status.json", lambda: said.append(emulator.busy)
    )
    now_ns = begun_ns = time.monotonic_ns()
    for _ in range(3):  # 1.8 s: not yet
        now_ns += 600 * MS
        cpu_ns = round((now_ns - begun_ns) * share)
        emulator.step(now_ns)
    assert said == []
    for _ in range(5):
        now_ns += 600 * MS
        cpu_ns = round((now_ns - begun_ns) * share)
        emulator.step(now_ns)
    assert len(said) == told
    assert json.loads((tmp_path / "status.json").read_text())["busy"] == pytest.approx(share)
    emulator.port.close()


def test_the_status_says_that_the_drives_are_there_before_any_frame_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`hil demo` starts the control process by it."""
    emulator, _, control = live_pair(tmp_path, monkeypatch)
    status = tmp_path / "status.json"
    status.unlink()
    waited = []

    def wait(stop: StopSignals) -> None:
        waited.append(json.loads(status.read_text())["running"])
        stop.seen = True

    monkeypatch.setattr(emulator, "wait", wait)
    monkeypatch.setattr("sim_plant.process.promote", lambda: False)  # these tests keep their garbage collector
    emulator.run()
    assert waited == [True]
    assert json.loads(status.read_text())["running"] is False
    control.close()
    emulator.port.close()


@pytest.mark.live
def test_hil_emulate_ends_on_sigterm_with_its_last_word_on_disk(tmp_path: Path) -> None:
    rig = ROOT / "deploy/rigs/microscope-ideal.toml"
    environment = {**os.environ, "HIL_RUNTIME_DIR": str(tmp_path)}
    status = tmp_path / "emulator.json"
    with subprocess.Popen(
        [sys.executable, "-m", "hil", "emulate", str(rig), "--set", "bus.interface=local", "--status", str(status)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert "hil emulate: microscope-ideal on" in process.stdout.readline()
        deadline = time.monotonic() + 20
        while not status.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
    assert json.loads(status.read_text())["running"] is False
