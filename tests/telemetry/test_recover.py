"""A recording cut anywhere: what is whole is recovered, and ordinary MCAP readers open it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from hil.cli.exit_status import EXIT_FILE
from hil.cycle.record import RECORD
from hil.cycle.step import ControlCycle
from hil.rig.file import load_rig
from hil.rig.provenance import rig_of_run
from hil.telemetry.recorder import Recorder, write_batch
from hil.telemetry.recording import Recording, RecordingError
from hil.telemetry.recover import command, recover
from hil.virtual.replay import replay_run, steps
from tests.support.earlier_layout import write_earlier
from tests.support.paths import RIGS, ROOT
from tests.telemetry.test_recorder import METADATA, _records
from tests.telemetry.test_run_recorder import rings_of

SECONDS = 4.0


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import hil

    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    hil.simulate("paper", SECONDS, record=path)
    return path


def chunks(path: Path) -> list[tuple[int, int]]:
    """Offset and length of every chunk, from the file's own summary."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    return [(chunk.chunk_start_offset, chunk.chunk_length) for chunk in summary.chunk_indexes]


def read_by_any_reader(path: Path) -> list[int]:
    """Sequence numbers of the ticks, by the plain mcap library alone."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_summary() is not None
        return [tick.sequence for _, _, _, tick in reader.iter_decoded_messages(topics=["tick"])]


@pytest.mark.long
def test_cut_at_every_byte_of_the_last_chunk_it_is_recovered_and_at_most_a_second_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    records = _records([([], [], [], 0)] * 30)
    recorder = Recorder(path, METADATA)
    for first in (0, 10, 20):
        write_batch(recorder, records[first : first + 10], first=first, lost=0)
        recorder.flush(first, at_once=True)
    recorder.close()
    content = path.read_bytes()
    start, length = chunks(path)[-1]
    for size in range(start, start + length + 1):
        path.write_bytes(content[:size])
        kept = rings_of(path)
        assert kept == list(range(20 if size < start + length else 30))
        target = tmp_path / f"{size}.mcap"
        found = recover(path, target)
        assert (found.ticks, bool(found.loss)) == (len(kept), True)
        assert read_by_any_reader(target) == kept
    assert length > 500


@pytest.mark.long
@pytest.mark.parametrize("share", [0.2, 0.7, 0.9, 0.99])
def test_a_run_cut_anywhere_loses_less_than_a_second(whole: Path, tmp_path: Path, share: float) -> None:
    content = whole.read_bytes()
    places = chunks(whole)
    size = round(share * sum(places[-1]))
    (tmp_path / "cut.mcap").write_bytes(content[:size])
    found = recover(tmp_path / "cut.mcap", tmp_path / "good.mcap")
    behind = next(start for start, length in reversed(places) if start <= size)
    (tmp_path / "chunk.mcap").write_bytes(content[: behind + dict(places)[behind]])
    with_it = recover(tmp_path / "chunk.mcap", tmp_path / "with it.mcap")
    assert with_it.ticks - found.ticks <= load_rig(RIGS / "paper.toml").rate_hz
    assert read_by_any_reader(found.path) == list(range(found.ticks))


@pytest.mark.long
def test_what_is_recovered_replays_and_says_how_much(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: chunks(whole)[-1][0] + 100])
    found = recover(tmp_path / "cut.mcap", tmp_path / "good.mcap")
    report = replay_run(tmp_path / "good.mcap")
    assert (report.ticks, report.different, report.truncated) == (found.ticks, 0, False)
    assert 0 < found.ticks < len(rings_of(whole))
    assert found.seconds == pytest.approx(found.ticks / load_rig(RIGS / "paper.toml").rate_hz, abs=0.1)


@pytest.mark.long
def test_replay_reads_on_through_the_parts_and_says_what_of_a_later_one_it_could_not_compare(
    whole: Path, tmp_path: Path
) -> None:
    ticks, metadata = list(steps(Recording(whole))), Recording(whole).metadata | {"run": "7"}
    records = np.zeros(len(ticks), RECORD)
    with rig_of_run(metadata) as (rig, folder):
        cycle = ControlCycle(rig, folder)
        for place, step in enumerate(ticks):
            records[place] = cycle.step(step.tick, step.received).record
    half = len(ticks) // 2
    for part, name, begin, end in ((1, "run.mcap", 0, half), (2, "run.part-2.mcap", half - 100, None)):
        recorder = Recorder(tmp_path / name, metadata | {"part": part})
        for first in range(begin, len(ticks) if end is None else end, 100):
            write_batch(recorder, records[first : first + 100], first=first, lost=0)
        recorder.close()
    both = replay_run(tmp_path / "run.mcap")  # the first 100 ticks of the second part are in the first one, too
    assert (both.ticks, both.different, both.gap_at, both.not_compared, both.parts) == (len(ticks), 0, None, 0, 2)
    later = replay_run(tmp_path / "run.part-2.mcap")
    assert (later.ticks, later.gap_at, later.not_compared) == (0, 0, len(ticks) - half + 100)
    words = [sys.executable, "-m", "hil", "replay", str(tmp_path / "run.part-2.mcap")]
    shown = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
    first = tmp_path / "run.mcap"
    assert shown.returncode == 0, shown.stdout
    assert f"a later part: replays the whole run, from {first} on" in shown.stderr
    assert "of 2 files replayed; every torque frame is the same" in " ".join(shown.stdout.split())
    first.rename(tmp_path / "other")
    alone = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
    assert alone.returncode == 1
    assert "a replay needs its first part, run.mcap, in the same folder" in " ".join(alone.stdout.split())


def test_a_whole_recording_and_one_of_the_earlier_layout_come_out_as_they_were(whole: Path, tmp_path: Path) -> None:
    earlier = write_earlier(tmp_path / "earlier.mcap", METADATA, _records([([], [], [], 0)] * 100))
    for place, path in enumerate((whole, earlier)):
        found = recover(path, tmp_path / f"{place}.mcap")
        assert not found.loss
        assert list(Recording(path)) == list(Recording(found.path))
        assert Recording(path).metadata == Recording(found.path).metadata
        assert found.path.stat().st_mode & 0o007 == 0


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", bytes(1000), json.dumps(METADATA).encode()])
def test_what_is_no_recording_is_refused_and_leaves_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=r"x\.mcap: not a recording"):
        recover(tmp_path / "x.mcap", tmp_path / "y.mcap")
    assert not (tmp_path / "y.mcap").exists()


def test_nothing_is_overwritten(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "there.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingError, match=r"there\.mcap: File exists"):
        recover(whole, tmp_path / "there.mcap")
    assert (tmp_path / "there.mcap").read_bytes() == b"precious"


def test_its_exit_status_tells_whole_from_lost_and_from_nothing(whole: Path, tmp_path: Path) -> None:
    command(whole, tmp_path / "all.mcap")
    content = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    (tmp_path / "none.mcap").write_bytes(b"nothing")
    for name, status in (("cut", 1), ("none", EXIT_FILE), ("absent", EXIT_FILE)):
        with pytest.raises(typer.Exit) as ended:
            command(tmp_path / f"{name}.mcap", tmp_path / f"{name}.new")
        assert ended.value.exit_code == status
        assert (tmp_path / f"{name}.new").exists() == (status == 1)
