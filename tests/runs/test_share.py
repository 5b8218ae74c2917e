"""What goes to somebody else is said before, holds no code unasked, and replaces nothing."""

import json
import os
import re
import shlex
import zipfile
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

import hil
from hil.cli.app import build_app
from hil.cycle.tick import CommandKind
from hil.runs.without_code import carried_sources, copy_without_code
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.recorder import Recorder
from hil.telemetry.recording import Recording, RecordingError
from hil.virtual.replay import replay_run
from tests.support.paths import RIGS, ROOT

SECRET = "the gains of our competitor"
LAW = f"""
from hil import Law

class Mine(Law):
    '''{SECRET}'''
    def __init__(self, model, period, force_limit):
        self.model = model
    def reset(self, position, force): pass
    def force(self, inputs):
        return self.model.gravity - 40.0 * (inputs.position_estimate - inputs.start.position)
"""


@pytest.fixture(scope="module")
def coded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that carries the source of its law."""
    folder = tmp_path_factory.mktemp("coded")
    (folder / "law.py").write_text(LAW)
    (folder / "rig.toml").write_text((RIGS / "paper.toml").read_text())
    sets = ["law.name=./law.py:Mine", "task.kind=hold"]
    hil.simulate(folder / "rig.toml", 0.4, overrides=sets, record=folder / "run.mcap")
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plain") / "run.mcap"
    hil.simulate(RIGS / "paper.toml", 0.4, overrides=["task.kind=hold"], record=path)
    return path


@pytest.fixture
def folder(tmp_path: Path, coded: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run as a demo and its reader leave it."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "a run"
    folder.mkdir()
    os.link(coded, folder / "run.mcap")
    for name in ("summary.json", "run.note.json", "tracking.png", "run.html", "control.log", "law.py"):
        (folder / name).write_text(name if name in ("summary.json", "run.note.json", "tracking.png") else SECRET)
    (tmp_path / "key").write_text(SECRET)
    (folder / "link.png").symlink_to(tmp_path / "key")
    os.mkfifo(folder / "pipe.png")
    return folder


def command(*words: str) -> Result:
    return CliRunner().invoke(build_app("share"), ["share", *words])


def inside(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def holds(data: bytes, text: str, scratch: Path) -> bool:
    """Whether a file, or a recording unfolded, holds a text."""
    scratch.write_bytes(data)
    try:
        items = [json.dumps(Recording(scratch).metadata).encode(), *(item.data for item in Recording(scratch))]
    except RecordingError:
        items = []
    return any(text.encode() in item for item in [data, *items])


def test_the_source_of_a_law_stays_here_unless_asked(folder: Path, tmp_path: Path) -> None:
    done = command("a run")
    assert done.exit_code == 0, done.output
    found = inside(tmp_path / "a_run.zip")
    names = ("INSIDE.txt", "run.mcap", "run.note.json", "summary.json", "tracking.png")
    assert sorted(found) == [f"a_run/{name}" for name in names]
    assert not any(holds(data, SECRET, tmp_path / "scratch") for data in found.values())
    assert "the source of law.source is left out" in done.output
    whole = command("a run", "--with-code", "--out", "whole.zip")
    assert whole.exit_code == 0, whole.output
    assert "and the source of law.source" in whole.output
    found = inside(tmp_path / "whole.zip")
    assert found["a_run/run.mcap"] == (folder / "run.mcap").read_bytes()
    told = {name for name, data in found.items() if holds(data, SECRET, tmp_path / "scratch")}
    assert told == {f"a_run/{name}" for name in ("run.mcap", "run.html", "control.log", "law.py")}
    assert not any("link" in name or "pipe" in name for name in found)


def test_it_says_what_is_inside_before_it_writes(folder: Path, tmp_path: Path) -> None:
    done = command("a run", "--list")
    assert done.exit_code == 0
    assert not list(tmp_path.glob("*.zip"))
    lines = [line.strip() for line in done.output.splitlines()]
    assert lines.index("inside:") < lines.index("left out:") < len(lines) - 5
    for name in ("run.html", "control.log", "law.py"):
        assert f"{name}: may hold code or names of this computer; --with-code takes it" in lines
    assert "link.png: a link" in lines
    command("a run")
    told = inside(tmp_path / "a_run.zip")["a_run/INSIDE.txt"].decode()
    assert done.output.rstrip("\n") in told


def test_the_copy_is_a_run_to_look_at_and_not_to_replay(coded: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    copy_without_code(coded, copy)
    first, second = hil.Recording(coded), hil.Recording(copy)
    assert second.summary()["axes"] == first.summary()["axes"]
    assert {name: values.tobytes() for name, values in second.columns.items()} == {
        name: values.tobytes() for name, values in first.columns.items()
    }
    assert "left out when this run was shared" in second.report(tmp_path / "x.html").read_text()
    assert carried_sources(copy) == ({"law.source"}, True)  # of which one line is left
    with pytest.raises(Exception, match="came with the file, and is not run"):
        replay_run(copy)


def test_a_recording_without_code_goes_byte_for_byte(plain: Path, tmp_path: Path) -> None:
    assert carried_sources(plain) == (set(), True)
    copy_without_code(plain, tmp_path / "copy.mcap")
    assert (tmp_path / "copy.mcap").read_bytes() == plain.read_bytes()


def test_a_damaged_recording_is_copied_as_far_as_it_is_whole(plain: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(plain.read_bytes()[:-2000] + SECRET.encode())
    copy_without_code(cut, tmp_path / "copy.mcap")
    assert not holds((tmp_path / "copy.mcap").read_bytes(), SECRET, tmp_path / "scratch")


def test_the_source_of_a_task_that_was_loaded_stays_here_too(plain: Path, tmp_path: Path) -> None:
    path = tmp_path / "loaded.mcap"
    recorder = Recorder(path, Recording(plain).metadata)
    task = json.dumps({"kind": "./task.py:plan", "source": SECRET, "samples": []}).encode()
    for document in (task, b"[1", b""):
        entry = pb.CommandEntry(kind=int(CommandKind.LOAD_TASK), task=document)
        recorder.write("commands", 1, entry.SerializeToString())
    recorder.close()
    assert holds(path.read_bytes(), SECRET, tmp_path / "scratch")
    assert carried_sources(path) == ({"task.source"}, False)
    copy_without_code(path, tmp_path / "copy.mcap")
    assert not holds((tmp_path / "copy.mcap").read_bytes(), SECRET, tmp_path / "scratch")
    kept = [item for item in Recording(tmp_path / "copy.mcap") if item.topic == "commands"]
    assert len(kept) == 2  # that whose task cannot be read is left out


def test_nothing_is_replaced_and_a_failure_leaves_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a_run.zip").write_text("mine")
    done = command("a run")
    assert isinstance(done.exception, FileExistsError)
    assert (tmp_path / "a_run.zip").read_text() == "mine"

    def full(source: Path, target: Path) -> None:
        raise RecordingError("no room")

    monkeypatch.setattr("hil.runs.share.copy_without_code", full)
    done = command("a run", "--out", "x.zip")
    assert (done.exit_code, (tmp_path / "x.zip").exists()) == (74, False)
    assert "hil share: no room" in done.output


def test_what_is_no_run_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "junk.mcap").write_text("junk")
    for name in ("empty", "junk.mcap"):
        done = command(name)
        assert done.exit_code == 74
        assert f"{name}: nothing to share" in done.output
    assert not list(tmp_path.glob("*.zip"))


def test_a_single_recording_is_shared(coded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(str(coded)).exit_code == 0
    assert sorted(inside(tmp_path / "run.zip")) == ["run/INSIDE.txt", "run/run.mcap"]


def test_the_files_that_a_recording_carries_are_named(
    plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    metadata = {**Recording(plain).metadata, "files": {"maker.dbc": "VERSION", "a.eds": "[x]"}}
    Recorder(tmp_path / "dbc.mcap", metadata).close()
    assert "rig, the text of a.eds, the text of maker.dbc, ticks" in command("dbc.mcap", "--list").output


PAGES = "".join((ROOT / "docs" / name).read_text() for name in ("recording.md", "how-to.md"))
SHOWN = sorted(set(re.findall(r"`hil (share\b[^`]*)`", PAGES)))


@pytest.mark.parametrize("text", SHOWN)
def test_a_command_shown_in_a_page_runs(text: str, folder: Path) -> None:
    done = command(*shlex.split(text.replace("RUN", "'a run'"))[1:])
    assert done.exit_code == 0, done.output


def test_pages_show_commands() -> None:
    assert len(SHOWN) == 3
