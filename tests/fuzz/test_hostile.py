"""What is no file at all, or one made to do harm: a clear error that names it, at once and in little memory."""

import gzip
import os
import resource
import socket
import sqlite3
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from hil.rig.schema import RigError
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.recorder import RUN_ATTACHMENT, Recorder
from tests.fuzz.__main__ import LONGEST_S, MOST_MB, at_most
from tests.fuzz.kinds import KINDS, Kind
from tests.support.paths import RIGS, ROOT


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))


def _device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _loop(path: Path) -> None:
    path.symlink_to(path)


def _huge(path: Path) -> None:
    """Without a block on the disk."""
    with path.open("wb") as file:
        file.truncate(2**42)


def _text(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


HOSTILE: dict[str, Callable[[Path], object]] = {
    "missing": lambda path: None,
    "directory": Path.mkdir,
    "pipe": _pipe,
    "socket": _socket,
    "device": _device,
    "loop of links": _loop,
    "terabytes": _huge,
    "empty": _text(b""),
    "NUL": _text(bytes(4096)),
    "no UTF-8": _text(b"\xff\xfe\x00" * 100),
    "a key of 200 kB": _text(b"a." * 100_000 + b"a = 1\n"),
    "deep lists": _text(b"a = " + b"[" * 100_000 + b"]" * 100_000),
    "deep tables": _text(b"".join(b"[" + b".".join([b"a"] * deep) + b"]\n" for deep in range(1, 300))),
    "an endless integer": _text(b"rate_hz = " + b"9" * 200_000 + b"\n"),
    "an endless hexadecimal": _text(b"rate_hz = 0x" + b"f" * 200_000 + b"\n"),
    "infinity": _text(b"rate_hz = 1e99999\nname = nan\n"),
    "one long line": _text(b"," * 2_000_000),
    "many lines": _text(b"\n" * 2_000_000),
}
EMPTY_IS_RIGHT = {"trace-log", "trace-asc", "trace-csv", "trace-trc"}  # a trace without a frame is a trace


def _refusal(kind: Kind, path: Path) -> str:
    """Empty where it was read."""
    try:
        with at_most(LONGEST_S):
            kind.read(path)
    except kind.refusals as refusal:
        return str(refusal)
    return ""


@pytest.mark.requirement(id="SR-9.4")
@pytest.mark.long
@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.parametrize("name", KINDS)
def test_a_hostile_file_is_refused_by_name(name: str, what: str, tmp_path: Path) -> None:
    kind = KINDS[name]
    path = tmp_path / f"x.{kind.suffix}"
    HOSTILE[what](path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    said = _refusal(kind, path)
    if said:
        assert str(path) in said
        assert len(said) < 2_000
    else:
        assert name in EMPTY_IS_RIGHT or (name, what) == ("scenario", "empty"), "it was read"
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024 < MOST_MB


def test_a_law_that_is_no_file_is_refused_by_name(tmp_path: Path) -> None:
    text = (RIGS / "paper.toml").read_text()
    for what in ("missing", "directory", "pipe", "device", "loop of links", "terabytes", "no UTF-8"):
        folder = tmp_path / what
        folder.mkdir()
        HOSTILE[what](folder / "law.py")
        (folder / "rig.toml").write_text(text)
        with pytest.raises(RigError, match=r"law\.py: "), at_most(LONGEST_S):
            load_rig(folder / "rig.toml", ["law.name=./law.py:Law"])


# recordings that unfold ----------------------------------------------------------------------------------------------


def _described(path: Path) -> Recorder:
    rig = load_rig(RIGS / "paper.toml")
    return Recorder(path, describe_run(rig, RIGS))


def _of_messages(path: Path) -> None:
    """Messages of half a megabyte, each of which a chunk holds in some bytes."""
    recorder = _described(path)
    data = pb.Status(rig="a" * 500_000).SerializeToString()
    for _ in range(200):
        recorder.write("status", 0, data)
    recorder.close()


def _of_one_chunk(path: Path) -> None:
    """A chunk that says to hold a few bytes, and whose compressed data unfolds to 1 GB."""
    _described(path).close()
    whole = path.read_bytes()
    compressor = zstandard.ZstdCompressor().compressobj(size=2**30)
    data = b"".join(compressor.compress(bytes(2**22)) for _ in range(2**8)) + compressor.flush()
    record = struct.pack("<QQQII", 0, 0, 100, 0, 4) + b"zstd" + struct.pack("<Q", len(data)) + data
    footer = whole.rindex(b"\x0f", 0, len(whole))
    path.write_bytes(whole[:footer] + b"\x06" + struct.pack("<Q", len(record)) + record + whole[footer:])


def _of_description(path: Path) -> None:
    """A description of nothing but brackets."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_attachment(0, 0, RUN_ATTACHMENT, "application/json", b"[" * 2**20)
        writer.finish()  # type: ignore[no-untyped-call]


@pytest.mark.long
@pytest.mark.parametrize(
    ("make", "expected"), [(_of_messages, "unfold to"), (_of_one_chunk, "damaged"), (_of_description, "run.mcap")]
)
def test_a_recording_that_unfolds_is_refused_or_read_up_to_there_in_little_memory(
    make: Callable[[Path], None], expected: str, tmp_path: Path
) -> None:
    make(tmp_path / "run.mcap")
    assert expected in _limited("-m", "hil", "replay", str(tmp_path / "run.mcap"))
    assert "run." in _limited("-m", "hil", "report", str(tmp_path / "run.mcap"))


def _limited(*words: str) -> str:
    """What a Python process of MOST_MB beside its libraries says; it must not end in a traceback."""
    limits = lambda: resource.setrlimit(resource.RLIMIT_DATA, (2**20 * 500,) * 2)  # noqa: E731
    line = [sys.executable, *words]
    done = subprocess.run(line, capture_output=True, text=True, timeout=60, cwd=ROOT, preexec_fn=limits)
    text = done.stdout + done.stderr
    assert "Traceback" not in text, text
    assert "MemoryError" not in text, text
    return text


@pytest.mark.long
def test_a_task_archive_that_unfolds_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time_s.npy", bytes(2**28))
    assert (tmp_path / "x.npz").stat().st_size < 2**19
    with pytest.raises(KINDS["task-npz"].refusals, match="unfold to"), at_most(LONGEST_S):
        KINDS["task-npz"].read(tmp_path / "x.npz")
    with pytest.raises(KINDS["export"].refusals, match="unfold to"), at_most(LONGEST_S):
        KINDS["export"].read(tmp_path / "x.npz")


def test_a_trace_whose_block_unfolds_is_refused(tmp_path: Path) -> None:
    [whole] = KINDS["trace-blf"].originals(tmp_path)
    content = whole.read_bytes()
    block = zlib.compress(bytes(2**27))
    size = 32 + len(block)
    header = struct.pack("<4sHHII", b"LOBJ", 16, 1, size, 10) + struct.pack("<H6xL4x", 2, 2**27)
    (tmp_path / "x.blf").write_bytes(content[:144] + header + block)
    with pytest.raises(KINDS["trace-blf"].refusals, match="unfolds to"), at_most(LONGEST_S):
        KINDS["trace-blf"].read(tmp_path / "x.blf")


@pytest.mark.long
def test_a_database_that_never_ends_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "x.db") as made:
        made.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i, i, 0, 0, 0, 0, NULL FROM n WHERE i < 0"
        )
    made.close()
    told = "interrupted|no frame within"  # whichever of the two clocks of a second is first
    with pytest.raises(KINDS["trace-db"].refusals, match=told), at_most(LONGEST_S):
        KINDS["trace-db"].read(tmp_path / "x.db")


@pytest.mark.long
def test_a_compressed_trace_of_one_line_is_refused(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "x.log.gz", "wb") as file:
        for _ in range(64):
            file.write(b"x" * 2**22)
    with pytest.raises(KINDS["trace-log"].refusals, match="a line of more than"), at_most(LONGEST_S):
        KINDS["trace-log"].read(tmp_path / "x.log.gz")
