"""Recordings in parts, their quota, and the seconds around each fault, out of a ring in this process."""

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.cycle.fault_table import Fault
from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.events.table import Kind
from hil.live.ring import RingReader, RingWriter
from hil.telemetry import cycle_codec, events_pb2
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.event_codec import decode
from hil.telemetry.fault_snapshots import AFTER_S, BEFORE_S, FaultSnapshots
from hil.telemetry.recorder import Recorder, write_batch
from hil.telemetry.recording import Recording
from hil.telemetry.run_recorder import Limits, RunRecorder, Store, prune
from hil.telemetry.sidecar_progress import Progress, ProgressFile
from tests.telemetry.test_recorder import METADATA

PERIOD_NS = 10_000_000
RATE = 100
NO_LIMITS = Limits(2**40, 2**62, 2**50)


class Ring:
    """A writer and a reader of one ring, and a clock."""

    def __init__(self, path: Path, slots: int = 8192) -> None:
        self.writer = RingWriter(path, slots, period_ns=PERIOD_NS, metadata=METADATA)
        self.reader = RingReader(path)
        self._record = np.zeros(1, RECORD)
        self.now_ns = 0

    def tick(self, count: int, fault: int = 0, state: State = State.ACTIVE) -> None:
        for _ in range(count):
            record = self._record[0]
            record["index"] = self.writer.written
            record["scheduled_ns"] = record["now_ns"] = self.now_ns = self.writer.written * PERIOD_NS
            record["fault"], record["state"] = fault, int(state)
            record["position"] = np.sin(self.writer.written)
            self.writer.append(record)

    def close(self) -> None:
        self.reader.close()
        self.writer.close()


@pytest.fixture
def ring(tmp_path: Path) -> Iterator[Ring]:
    ring = Ring(tmp_path / "ring" / "ring")
    yield ring
    ring.close()


def recorder_of(ring: Ring, folder: Path, limits: Limits = NO_LIMITS, progress: Progress | None = None) -> RunRecorder:
    progress = progress or Progress(ring.reader.run_id)
    return RunRecorder(Store(folder, folder, fixed=True), ring.reader, limits, progress, lambda _: None)


def rings_of(path: Path) -> list[int]:
    """Ring indices of the recorded ticks, through all parts."""
    return [
        tick.ring
        for item in Recording(path)
        if item.topic == "cycle"
        for tick in cycle_codec.recorded_ticks(pb.Cycle.FromString(item.data))
    ]


@pytest.mark.parametrize(
    ("limits", "parts"),
    [(NO_LIMITS, 1), (NO_LIMITS._replace(part_ns=5 * 10**9), 8), (NO_LIMITS._replace(part_size=40_000), 6)],
)
def test_a_long_run_is_in_as_many_parts_as_it_takes_and_reads_as_one(
    ring: Ring, tmp_path: Path, limits: Limits, parts: int
) -> None:
    recorder = recorder_of(ring, tmp_path, limits)
    for _ in range(40):
        ring.tick(RATE)
        while recorder.keep_up(ring.reader.written, ring.now_ns):
            pass
    recorder.close(ring.reader.written, ring.now_ns)
    recording = Recording(tmp_path / "run.mcap")
    assert [item.topic for item in recording].count("tick") == 40 * RATE
    assert abs(len(recording.parts) - parts) <= (0 if parts == 1 else 4)
    assert len(recording.parts) == len(list(tmp_path.glob("run*.mcap")))
    assert not recording.truncated
    assert rings_of(tmp_path / "run.mcap") == list(range(40 * RATE))
    later = rings_of(recording.parts[-1])  # a part alone begins where it begins
    assert later == list(range(later[0], 40 * RATE))


@pytest.mark.parametrize(("at_once", "hurried"), [(50, False), (500, True)])
def test_who_is_behind_hurries(
    ring: Ring, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: int, hurried: bool
) -> None:
    found = []
    monkeypatch.setattr(Recorder, "ticks", lambda self, *_, **__: found.append(self.hurried))
    recorder = recorder_of(ring, tmp_path)
    ring.tick(at_once)
    recorder.keep_up(ring.writer.written, ring.now_ns)
    assert found == [hurried]


def test_what_is_written_in_a_hurry_is_the_same_and_larger(ring: Ring, tmp_path: Path) -> None:
    ring.tick(500)
    batch = ring.reader.look(0, 500)
    for hurried in (False, True):
        recorder = Recorder(tmp_path / f"{hurried}.mcap", ring.reader.metadata)
        recorder.hurried = hurried
        write_batch(recorder, batch.records, first=0, lost=0)
        recorder.close()
    assert rings_of(tmp_path / "True.mcap") == rings_of(tmp_path / "False.mcap") == list(range(500))
    assert (tmp_path / "False.mcap").stat().st_size < 0.95 * (tmp_path / "True.mcap").stat().st_size


def test_another_control_processs_part_is_not_read_as_this_ones(ring: Ring, tmp_path: Path) -> None:
    limits = NO_LIMITS._replace(part_ns=10**9)
    for name in ("one", "two"):
        recorder = recorder_of(ring, tmp_path / name, limits)
        for _ in range(4):
            ring.tick(RATE)
            while recorder.keep_up(ring.reader.written, ring.now_ns):
                pass
        recorder.close(ring.reader.written, ring.now_ns)
        ring = Ring(tmp_path / "next" / name)
    (tmp_path / "one" / "run.part-0002.mcap").unlink()
    (tmp_path / "two" / "run.part-0002.mcap").rename(tmp_path / "one" / "run.part-0002.mcap")
    recording = Recording(tmp_path / "one" / "run.mcap")
    assert len(list(recording)) > 0
    names = [path.name for path in recording.parts]
    assert names == [
        "run.mcap",
        "run.part-0003.mcap",
        "run.part-0004.mcap",
    ]  # that ticks are missing, their indices say


def test_who_takes_over_records_on_where_the_file_on_the_disk_ends(ring: Ring, tmp_path: Path) -> None:
    progress = Progress(ring.reader.run_id)
    first = recorder_of(ring, tmp_path, progress=progress)
    ring.tick(730)
    while first.keep_up(ring.reader.written, ring.now_ns):
        pass  # and then it is killed: nothing is closed
    assert 0 < progress.recorded < 730 + 1
    with ProgressFile(tmp_path / "progress") as file:
        file.write(progress)
        assert file.read(ring.reader.run_id) == progress
        assert file.read(ring.reader.run_id + 1) == Progress(ring.reader.run_id + 1)  # another control process
        found = file.read(ring.reader.run_id)
    ring.tick(100)
    while first.keep_up(ring.reader.written, ring.now_ns):
        pass  # a chunk on the disk that it had not noted when it was killed
    assert progress.size > found.size
    ring.tick(170)
    second = recorder_of(ring, tmp_path, progress=dataclasses.replace(found))
    second.close(ring.reader.written, ring.now_ns)
    assert rings_of(tmp_path / "run.mcap") == list(range(1000))


@pytest.mark.parametrize("content", [b"", b"{} 0", b"\xff" * 3000, b'{"run": 1} 99', b'{"x": 1} 3518054230'])
def test_a_progress_file_that_makes_no_sense_is_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "progress").write_bytes(content)
    with ProgressFile(tmp_path / "progress") as file:
        assert file.read(1) == Progress(1)


@pytest.mark.parametrize("left", [b"", b"\x89MCAP0\r\n"])
def test_a_file_that_a_killed_sidecar_had_hardly_made_gives_its_name_to_the_next(
    ring: Ring, tmp_path: Path, left: bytes
) -> None:
    (tmp_path / "run.mcap").write_bytes(left)
    ring.tick(100)
    progress = Progress(ring.reader.run_id, file=str(tmp_path / "run.mcap"), part=1)
    recorder_of(ring, tmp_path, progress=progress).close(ring.reader.written, ring.now_ns)
    assert rings_of(tmp_path / "run.mcap") == list(range(100))
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["run.mcap"]


def test_ticks_the_ring_lost_before_they_were_recorded_are_counted_once(tmp_path: Path) -> None:
    ring = Ring(tmp_path / "ring" / "ring", 256)
    recorder = recorder_of(ring, tmp_path)
    ring.tick(1000)
    recorder.close(ring.reader.written, ring.now_ns)
    cycles = [pb.Cycle.FromString(item.data) for item in Recording(tmp_path / "run.mcap") if item.topic == "cycle"]
    ring.close()
    assert sum(cycle.lost for cycle in cycles) == cycles[0].lost == cycles[0].first == 1000 - 255
    assert sum(len(cycle.index) for cycle in cycles) == 255


def test_snapshots_count_in_the_quota_and_go_only_beyond_half_of_it(tmp_path: Path) -> None:
    snapshots = ["a/fault-SPEED-7-00.mcap", "a/fault-SPEED-9-00.mcap", "b/blackbox-2.mcap"]
    recordings = ["a/run.mcap", "b/run.mcap", "c/run.mcap"]
    for age, name in enumerate([*snapshots, *recordings]):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(bytes(1000))
        os.utime(path, ns=(age, age))
    newest = tmp_path / "c" / "run.mcap"
    assert prune(tmp_path, 6000, newest) == []
    assert prune(tmp_path, 5999, newest) == [tmp_path / snapshots[0]], "three have more than half"
    assert prune(tmp_path, 4000, newest) == [tmp_path / "a" / "run.mcap"]
    assert prune(tmp_path, 0, newest) == [tmp_path / name for name in (*snapshots[1:], "b/run.mcap")]
    assert newest.exists()


def test_the_quota_takes_the_oldest_and_leaves_the_newest_and_what_is_not_ours(tmp_path: Path) -> None:

    names = ["a/run.mcap", "a/run.part-2.mcap", "b/run.mcap", "b/run-2.mcap", "run.mcap"]
    others = ["b/runs.mcap", "b/run.mcap.txt", "c/d/run.mcap"]
    for age, name in enumerate([*names, *others]):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(1000))
        os.utime(path, ns=(age, age))
    (tmp_path / "b" / "run-3.mcap").symlink_to(tmp_path / "c" / "d" / "run.mcap")
    assert prune(tmp_path, 5000, tmp_path / "run.mcap") == []
    assert prune(tmp_path, 2500, tmp_path / "a" / "run.mcap") == [tmp_path / name for name in names[1:4]]
    assert prune(tmp_path, 0, tmp_path / "a" / "run.mcap") == [tmp_path / "run.mcap"]
    assert all((tmp_path / name).exists() for name in (*others, "a/run.mcap"))


def finish(snapshots: FaultSnapshots, now_ns: int) -> None:
    while snapshots.work(now_ns):
        pass


def seconds_of(path: Path) -> tuple[int, int]:
    found = rings_of(path)
    assert found == list(range(found[0], found[-1] + 1))
    return found[0], found[-1]


def test_each_fault_that_latches_leaves_the_seconds_around_it_in_a_file_of_its_own(ring: Ring, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    snapshots = FaultSnapshots(folder, ring.reader, 0)
    before, after = round(BEFORE_S * RATE), round(AFTER_S * RATE)

    def run(count: int, fault: int) -> None:
        first = ring.writer.written
        ring.tick(count, fault)
        snapshots.watch(ring.reader.look(first, count).records, first)
        finish(snapshots, ring.now_ns)

    run(1500, 0)
    run(100, int(Fault.TRAVEL))
    assert list(folder.iterdir()) == []  # the seconds after it are still to come
    run(10, 0)  # reset,
    run(200, int(Fault.OVERRUN))  # and the next one within those seconds
    run(500, 0)
    names = sorted(path.name.rpartition("-")[0] for path in folder.iterdir())
    assert names == ["fault-OVERRUN-1610", "fault-TRAVEL-1500"]
    [estop] = folder.glob("fault-TRAVEL-*")
    [overrun] = folder.glob("fault-OVERRUN-*")
    assert seconds_of(estop) == (1500 - before, 1500 + after - 1)
    assert seconds_of(overrun) == (1610 - before, 1610 + after - 1)
    assert not Recording(estop).truncated
    assert estop.stat().st_mode & 0o007 == 0
    told = [decode(events_pb2.Event.FromString(item.data)) for item in Recording(estop) if item.topic == "events"]
    latched = [(event.name, event.tick) for event in told if event.kind is Kind.FAULT_LATCHED]
    assert latched == [("travel", 1500), ("overrun", 1610)], "in the middle of a run, where no replay tells anything"


def test_a_fault_just_before_the_end_and_one_a_killed_sidecar_left_undone_have_their_files_too(
    ring: Ring, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    ring.tick(100)
    ring.tick(50, state=State.ESTOP)
    (folder / f".fault-ESTOP-100-{ring.reader.run_id:016x}.mcap.new").write_bytes(b"cut short by a kill")
    successor = FaultSnapshots(folder, ring.reader, 150)  # its predecessor had read all of it
    successor.close(ring.now_ns)
    [path] = folder.iterdir()
    assert path.name == f"fault-ESTOP-100-{ring.reader.run_id:016x}.mcap"
    assert seconds_of(path) == (0, 149)
    FaultSnapshots(folder, ring.reader, 150).close(ring.now_ns)  # one more has nothing to do
    assert list(folder.iterdir()) == [path]


def test_a_snapshot_that_finds_no_room_is_tried_again_and_counted_when_it_is_too_late(tmp_path: Path) -> None:
    ring = Ring(tmp_path / "ring" / "ring", 2000)
    snapshots = FaultSnapshots(tmp_path / "not there", ring.reader, 0)
    (tmp_path / "not there").write_bytes(b"a file where the folder should be")
    ring.tick(100, int(Fault.TRAVEL))
    snapshots.watch(ring.reader.look(0, 100).records, 0)
    ring.tick(300, int(Fault.TRAVEL))
    assert snapshots.work(ring.now_ns)
    assert not snapshots.work(ring.now_ns)  # not at once
    (tmp_path / "not there").unlink()
    finish(snapshots, ring.now_ns + 2 * 10**9)
    assert len(list((tmp_path / "not there").glob("fault-TRAVEL-0-*.mcap"))) == 1
    assert snapshots.failed == 0
    ring.close()
