"""The telemetry ring: nothing is lost silently, nothing torn is believed, and it outlives a killed writer."""

import multiprocessing
import os
import shutil
import signal
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.cycle.record import FRAME, MAX_RECEIVED, RECORD
from hil.live.ring import RingError, RingReader, RingWriter, previous_path


def _record(index: int, received: int = 4) -> np.void:
    record = np.zeros(1, RECORD)[0]
    record["index"] = index
    record["position"] = [index * 1e-6, -index, 0.5, np.pi]
    record["n_received"] = received
    record["received"]["timestamp_ns"][:received] = index * 1000 + np.arange(received)
    return record


def test_what_is_written_is_read_in_order_and_bit_for_bit(tmp_path: Path) -> None:
    written = [_record(index, received=index % (MAX_RECEIVED + 1)) for index in range(100)]
    with RingWriter(tmp_path / "ring", 256) as writer, RingReader(tmp_path / "ring") as reader:
        for record in written:
            writer.append(record)
        batch = reader.read()
    assert (batch.first, batch.lost, len(batch.records)) == (0, 0, 100)
    assert [bytes(record) for record in batch.records] == [bytes(record) for record in written]


@pytest.mark.parametrize("text", ["", "x", "long" * 4000])
def test_a_reader_learns_what_run_it_is(text: str, tmp_path: Path) -> None:
    metadata = {"rig": text, "version": 3}
    with RingWriter(tmp_path / "ring", 16, metadata=metadata) as writer, RingReader(tmp_path / "ring") as reader:
        writer.append(_record(0))
        assert reader.metadata == metadata
        assert [bytes(record) for record in reader.read().records] == [bytes(_record(0))]


def test_a_few_fields_can_be_read_alone(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "ring", 16) as writer, RingReader(tmp_path / "ring") as reader:
        for index in range(20):
            writer.append(_record(index))
        batch = reader.read(fields=("index", "position"))
    assert (batch.first, batch.lost) == (5, 5)
    assert batch.records.dtype.names == ("index", "position")
    assert batch.records["index"].tolist() == list(range(5, 20))
    assert batch.records["position"][:, 1].tolist() == [-float(index) for index in range(5, 20)]


def test_a_record_object_that_is_reused_is_copied_each_time(tmp_path: Path) -> None:
    record = _record(0)
    with RingWriter(tmp_path / "ring", 16) as writer, RingReader(tmp_path / "ring") as reader:
        for index in range(10):
            record["index"] = index
            record["n_received"] = index
            writer.append(record)
        records = reader.read().records
    assert records["index"].tolist() == list(range(10))
    assert records["n_received"].tolist() == list(range(10))


@pytest.mark.requirement(id="SR-7.2")
@settings(max_examples=60, deadline=None)
@given(slots=st.integers(2, 9), steps=st.lists(st.tuples(st.integers(0, 25), st.integers(0, 12)), max_size=12))
def test_every_record_is_either_delivered_once_or_counted_as_lost(
    tmp_path_factory: pytest.TempPathFactory, slots: int, steps: list[tuple[int, int]]
) -> None:
    path = tmp_path_factory.mktemp("ring") / "ring"
    seen: list[int] = []
    lost = 0
    with RingWriter(path, slots) as writer, RingReader(path) as reader:
        for appended, limit in [*steps, (0, 1000)]:
            for _ in range(appended):
                writer.append(_record(writer.written))
            batch = reader.read(limit)
            assert batch.records["index"].tolist() == list(range(batch.first, batch.first + len(batch.records)))
            seen += batch.records["index"].tolist()
            lost += batch.lost
        assert len(seen) + lost == writer.written
    assert seen == sorted(set(seen))


def test_a_slot_that_the_writer_may_be_filling_is_never_handed_out(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "ring", 8) as writer, RingReader(tmp_path / "ring") as reader:
        for index in range(8):
            writer.append(_record(index))
        batch = reader.read()  # slot 0 is where record 8 is being written, unpublished
    assert (batch.first, batch.lost) == (1, 1)


def _write_fast(path: str, go: int) -> None:
    with RingWriter(path, 8) as writer:
        record = _record(0, received=MAX_RECEIVED)
        os.write(go, b"x")
        for index in range(60_000):
            record["index"] = index
            record["received"]["timestamp_ns"] = index
            record["position"] = index
            writer.append(record)


@pytest.mark.live
def test_a_reader_overtaken_by_a_racing_writer_never_sees_a_mixed_record(tmp_path: Path) -> None:
    ready, go = os.pipe()
    process = multiprocessing.get_context("fork").Process(target=_write_fast, args=(str(tmp_path / "ring"), go))
    process.start()
    os.read(ready, 1)
    seen = lost = 0
    with RingReader(tmp_path / "ring") as reader:
        while reader.writer_alive or reader.next < reader.written:
            batch = reader.read(7)
            records = batch.records
            seen += len(records)
            lost += batch.lost
            assert (records["index"] == np.arange(batch.first, batch.first + len(records))).all()
            assert (records["position"] == records["index"][:, None]).all()
            assert (records["received"]["timestamp_ns"] == records["index"][:, None]).all()
        assert reader.ended
    process.join()
    assert seen + lost == 60_000
    assert seen > 0
    assert process.exitcode == 0


def _write_until_killed(path: str, ready: int) -> None:
    writer = RingWriter(path, 64, metadata={"rig": "x"})
    for index in range(100):
        writer.append(_record(index))
    os.write(ready, b"x")
    signal.pause()


@pytest.mark.live
def test_a_killed_writer_is_noticed_and_its_ring_is_kept_as_the_black_box(tmp_path: Path) -> None:
    path = tmp_path / "ring"
    waiting, ready = os.pipe()
    process = multiprocessing.get_context("fork").Process(target=_write_until_killed, args=(str(path), ready))
    process.start()
    os.read(waiting, 1)
    with RingReader(path) as reader:
        assert reader.writer_alive
        with pytest.raises(RingError, match=f"another control process .*{process.pid}"):
            RingWriter(path, 64)
        process.kill()
        process.join()
        assert not reader.writer_alive
        assert not reader.ended
        with RingWriter(path, 32):
            assert reader.replaced
            assert reader.read().records["index"].tolist() == list(range(37, 100))
    with RingReader(previous_path(path)) as box:
        assert box.metadata == {"rig": "x"}
        assert box.read().records["index"][-1] == 99


def test_a_clean_end_leaves_no_black_box_and_frees_the_ring(tmp_path: Path) -> None:
    for _ in range(2):
        with RingWriter(tmp_path / "rig" / "ring", 4) as writer:
            writer.append(_record(0))
        with RingReader(tmp_path / "rig" / "ring") as reader:
            assert reader.ended
            assert not reader.writer_alive
    assert [entry.name for entry in (tmp_path / "rig").iterdir()] == ["ring"]


def test_a_ring_in_use_is_refused_with_whose_it_is_and_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "rig" / "ring"
    with RingWriter(path, 4) as writer:
        with pytest.raises(RingError, match=rf"ring: another control process .* \(pid {os.getpid()}\)"):
            RingWriter(path, 4)
        writer.append(_record(7))
        with RingReader(path) as reader:
            assert reader.writer_alive
            assert (reader.pid, reader.read().records["index"].tolist()) == (os.getpid(), [7])
    assert [entry.name for entry in path.parent.iterdir()] == ["ring"]


def test_the_layout_is_that_of_its_version(tmp_path: Path) -> None:
    """A black box outlives an update: another layout needs another version."""
    with RingWriter(tmp_path / "ring", 4, period_ns=1_000_000, metadata={"rig": "x"}) as writer:
        for index in range(3):
            writer.append(_record(index))
        raw = (tmp_path / "ring").read_bytes()
        header = ("<8sIIQQQQQ", b"HILRING1", 4, 5376, 4, 8192, 12, 1_000_000, os.getpid())
        assert struct.unpack_from(header[0], raw) == header[1:]
        assert [struct.unpack_from("<Q", raw, place)[0] for place in (128, 192)] == [3, 0]
        assert raw[4096:8192].rstrip(b"\0") == b'{"rig": "x"}'
        assert raw[8192 + 5376 :][:5376] == bytes(_record(1))
        assert len(raw) == 8192 + 4 * 5376
    ended = (tmp_path / "ring").read_bytes()
    assert struct.unpack_from("<Q", ended, 192) == (1,)


@pytest.mark.parametrize("written", [0, 1, 5])
def test_what_a_dead_writer_left_is_a_black_box_if_there_is_a_record_in_it(written: int, tmp_path: Path) -> None:
    path = tmp_path / "dead"
    with RingWriter(tmp_path / "ring", 4) as writer:
        for index in range(written):
            writer.append(_record(index))
        shutil.copy(tmp_path / "ring", path)  # as it stands when its writer is killed now
    with RingWriter(path, 4), RingReader(path) as reader:
        assert not len(reader.read().records)
    assert previous_path(path).exists() == (written > 0)


@pytest.mark.parametrize("content", [b"", b"HILRING1", b"\0" * 8192, b"HILRING1" + b"\xff" * 8192], ids=range(4))
def test_a_file_that_is_no_ring_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "ring").write_bytes(content)
    with pytest.raises(RingError, match="ring"):
        RingReader(tmp_path / "ring")


def test_closing_again_closes_nobody_else_s_file(tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "ring", 4)
    for end in (RingReader(tmp_path / "ring"), writer):
        end.close()
        with open(os.devnull) as other:  # which gets the number that was given back
            end.close()
            os.fstat(other.fileno())


def test_a_ring_of_one_slot_could_hand_out_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="slots = 1: a ring needs at least 2"):
        RingWriter(tmp_path / "ring", 1)


def test_a_missing_ring_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RingError, match="nowhere: No such file"):
        RingReader(tmp_path / "nowhere")


def test_the_used_part_of_a_record_ends_with_its_last_received_frame(tmp_path: Path) -> None:
    full, short = _record(0, received=MAX_RECEIVED), _record(1, received=2)
    full["received"]["can_id"] = 0x123
    with RingWriter(tmp_path / "ring", 2) as writer, RingReader(tmp_path / "ring") as reader:
        for record in (full, short, short):
            writer.append(record)
        last = reader.read().records[-1]
    assert last["n_received"] == 2
    assert last["received"][:2].tobytes() == short["received"][:2].tobytes()
    assert FRAME.itemsize * MAX_RECEIVED + RECORD.fields["received"][1] <= RECORD.itemsize


def test_a_dead_writers_ring_that_a_recording_holds_is_no_black_box_any_more(tmp_path: Path) -> None:
    dead = tmp_path / "dead"
    with RingWriter(tmp_path / "ring", 4) as writer, RingReader(tmp_path / "ring") as living:
        writer.append(_record(0))
        shutil.copy(tmp_path / "ring", dead)
        living.mark_saved()
        assert not living.saved
    with RingReader(dead) as reader:
        reader.mark_saved()
        assert (reader.saved, reader.ended) == (True, False)
    RingWriter(dead, 4).close()
    assert not previous_path(dead).exists()
