"""A recording with a hole or a flipped bit anywhere: only the chunks it touches are lost, and that is told."""

import json
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.runs.summary import load_run
from hil.telemetry.mcap_items import McapItems
from hil.telemetry.recorder import Recorder, write_batch
from hil.telemetry.recording import Gap, Gaps, Recording, loss_text
from hil.telemetry.recover import recover
from tests.support.paths import RIGS
from tests.telemetry.test_recorder import METADATA, _records
from tests.telemetry.test_recover import chunks
from tests.telemetry.test_run_recorder import rings_of

CHUNKS, TICKS = 25, 10  # of each chunk
TRIES = 200


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    records = _records([([], [], [], 0)] * (CHUNKS * TICKS))
    records["index"] = np.arange(len(records))
    recorder = Recorder(path, METADATA)
    for first in range(0, len(records), TICKS):
        write_batch(recorder, records[first : first + TICKS], first=first, lost=0)
        recorder.flush(first, at_once=True)
    recorder.close()
    assert len(chunks(path)) == CHUNKS
    return path


def damaged(content: bytes, draw: random.Random) -> tuple[bytes, list[tuple[int, int]]]:
    """One to three holes, of zeros or noise, or flipped bits; and where they are."""
    data, places = bytearray(content), []
    for _ in range(draw.randint(1, 3)):
        begin = draw.randrange(len(data))
        end = min(len(data), begin + draw.choice((1, 1, 8, 300, 3000)))
        if end == begin + 1:
            data[begin] ^= 1 << draw.randrange(8)
        else:
            data[begin:end] = bytes(end - begin) if draw.random() < 0.5 else draw.randbytes(end - begin)
        places.append((begin, end))
    return bytes(data), places


@pytest.mark.parametrize(
    "seeds",
    [
        range(10),
        pytest.param(range(10, 40), marks=pytest.mark.long),
        pytest.param(range(40, TRIES), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_only_the_chunks_that_were_touched_are_lost(seeds: range, whole: Path, tmp_path: Path) -> None:
    content, spans = whole.read_bytes(), [(start, start + length) for start, length in chunks(whole)]
    first = content.find(b"run.json")
    second = content.find(b"run.json", first + 100)
    size = len(json.dumps(METADATA)) + 100
    told = 0
    for seed in seeds:
        data, places = damaged(content, random.Random(seed))
        (tmp_path / "x.mcap").write_bytes(data)
        touched = {number for number, (start, end) in enumerate(spans) if any(a < end and b > start for a, b in places)}
        if all(any(a < at + size and b > at - 40 for a, b in places) for at in (first, second)):
            continue  # both descriptions of the rig
        kept = set(range(CHUNKS * TICKS)) - {
            tick for number in touched for tick in range(number * TICKS, (number + 1) * TICKS)
        }
        found = set(rings_of(tmp_path / "x.mcap"))
        assert kept <= found, (seed, places)
        (tmp_path / "y.mcap").unlink(missing_ok=True)
        recovered = recover(tmp_path / "x.mcap", tmp_path / "y.mcap")
        assert set(rings_of(tmp_path / "y.mcap")) == found
        assert bool(recovered.loss) or len(found) == CHUNKS * TICKS, (seed, places)
        told += bool(recovered.loss)
    assert told > len(seeds) // 2


def test_a_chunk_is_found_whatever_stands_before_it(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    start, length = chunks(whole)[3]
    for before in [b"", b"\6", bytes(1000), random.Random(1).randbytes(2**20 - 5)]:
        (tmp_path / "x.mcap").write_bytes(before + content[start : start + length])
        items = McapItems(tmp_path / "x.mcap")
        assert len(list(items)) == TICKS + 1  # and their Cycle
        assert items.damaged


def test_gaps_are_counted_by_ring_index() -> None:
    gaps = Gaps()
    for first, ticks, lost in ((5, 10, 5), (15, 10, 0), (30, 5, 5), (32, 10, 0)):
        gaps.add(first, ticks, lost, damaged=False)
    assert gaps.found == [Gap(-1, 5), Gap(24, 5)]
    assert gaps.ticks == 10
    assert loss_text(gaps.found, 0.001, damaged=False) == (
        "10 ticks (0.010 s) are missing: the first 5, 5 after tick 24; the recorder could not keep up"
    )
    later = Gaps()
    later.add(100, 10, 0, damaged=False)
    assert later.found == []  # a recorder that came later
    assert loss_text([], 0.001, damaged=True)
    assert not loss_text([], 0.001, damaged=False)


@pytest.mark.requirement(id="SR-9.2")
@pytest.mark.long
def test_every_command_says_what_is_missing_and_does_not_end_with_status_0(tmp_path: Path) -> None:
    import hil

    path = tmp_path / "run.mcap"
    hil.simulate(RIGS / "paper.toml", 1.6, record=path)
    data = bytearray(path.read_bytes())
    start, length = chunks(path)[1]
    data[start + length // 2] ^= 4
    path.write_bytes(data)
    run = load_run(path)
    assert run.lost == 500
    assert not Recording(path).truncated  # until it is read
    for words in (["events"], ["replay"], ["recover"], ["export", "-o", str(tmp_path / "x.csv")]):
        done = subprocess.run([sys.executable, "-m", "hil", *words, str(path)], capture_output=True, text=True)
        said = " ".join((done.stdout + done.stderr).split())
        assert done.returncode in (1, 74), (words, said)
        assert "500 ticks (0.500 s) are missing: 500 after tick 499; the file is damaged" in said
