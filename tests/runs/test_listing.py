"""`hil runs`: a list of what a folder holds, from an index that may vanish, and whatever lies in that folder."""

import json
import os
import re
import shlex
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

import hil
from hil.cli.app import build_app
from hil.runs import listed
from hil.runs.facts import facts_of
from hil.runs.index import index_file
from hil.runs.kept import KeptRun, kept_run, kept_runs
from hil.runs.listed import listed_runs
from hil.runs.note import LONGEST, Note, note_of, write_note
from hil.runs.summary import load_run, summarise
from tests.support.paths import RIGS, ROOT

QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
DEAD = '[[fault]]\nkind = "encoder_silent"\naxis = "x"\nat_s = 0.6\n'
EVIL = "a\x1b[31m\x07\u202eb"
# The process ends with 9 where it opens a recording.
OPENS_NO_RECORDING = """
import os, sys
def watch(event, arguments):
    if event == "open" and str(arguments[0]).endswith(".mcap"):
        os._exit(9)
sys.addaudithook(watch)
from hil.cli.app import main
main()
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    hil.simulate(RIGS / "paper.toml", 0.5, overrides=QUICK, record=path)
    return path


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("faulty")
    (folder / "dead.toml").write_text(DEAD)
    hil.simulate(
        RIGS / "paper.toml", 1.0, overrides=QUICK, scenario=folder / "dead.toml", law="pid", record=folder / "run.mcap"
    )
    return folder / "run.mcap"


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    return tmp_path / "runs"


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the folders whose recordings were read."""
    found: list[str] = []

    def counted(run: KeptRun) -> tuple[dict[str, Any], bool]:
        found.append(run.folder.name)
        return facts_of(run)

    monkeypatch.setattr(listed, "facts_of", counted)
    return found


def put(runs: Path, name: str, recording: Path, file: str = "run.mcap") -> Path:
    (runs / name).mkdir(exist_ok=True)
    os.link(recording, runs / name / file)
    return runs / name


def command(*words: str) -> Result:
    return CliRunner().invoke(build_app("runs"), ["runs", *words])


def documents(*words: str) -> dict[str, Any]:
    done = command("--json", "-", *words)
    assert done.exit_code == 0, done.output
    return {Path(row["run"]).name: row for row in json.loads(done.stdout)}


def known(folder: Path) -> list[dict[str, Any]]:
    return [run.facts for run in listed_runs(folder, lambda total: lambda: None)]


def test_the_list_says_what_each_run_was_and_how_it_ended(runs: Path, recording: Path, faulty: Path) -> None:
    put(runs, "a", recording)
    put(runs, "b", faulty)
    summary = summarise(load_run(recording))
    lines = {line.split()[0]: line for line in command().output.splitlines()}
    assert "ACTIVE" in lines["a"]
    assert "FAULT encoder" in lines["b"]
    found = documents()
    assert found["a"]["outcome"] == "sound"
    assert found["a"]["axes"]["x"]["rms_error"] == summary["axes"]["x"]["rms_error"]
    assert found["b"]["outcome"] == "fault"
    assert found["b"]["fault"].startswith("ENCODER")


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("--rig paper", "ab"),
        ("--rig p*r", "ab"),
        ("--rig microscope", ""),
        ("--law pid", "b"),
        ("--state fault", "b"),
        ("--state sound --state unread", "ac"),
        ("--label good", "a"),
        ("--above 1um", "b"),
        ("--below 1um", "a"),
        ("--below 1nm", ""),
        ("--above 1um --axis x", ""),
        ("--above 1urad", ""),
        ("--state sound --label bad", ""),
        ("--last 1", "c"),
    ],
)
def test_filters(words: str, names: str, runs: Path, recording: Path, faulty: Path) -> None:
    for age, (name, file) in enumerate({"a": recording, "b": faulty}.items()):
        put(runs, name, file)
        os.utime(file, ns=(age, age))
    (runs / "c").mkdir()
    (runs / "c" / "run.mcap").write_text("nothing")
    assert command("note", "runs/a", "--label", "good").exit_code == 0
    assert "".join(documents(*words.split())) == names


@pytest.mark.parametrize(
    ("words", "said"), [("--state lost", "sound, fault, estop, unread"), ("--above 1kg", "a length or an angle")]
)
def test_a_filter_that_cannot_be_meant_is_refused(words: str, said: str, runs: Path) -> None:
    done = command(*words.split())
    assert (done.exit_code, said in " ".join(done.output.replace("│", "").split())) == (2, True)


@pytest.mark.long
def test_a_thousand_runs_are_listed_without_opening_a_recording(
    runs: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(1000):
        put(runs, f"{number:04}", recording)
    facts = facts_of(kept_run(recording))
    monkeypatch.setattr(listed, "facts_of", lambda run: facts)
    assert len(known(runs)) == 1000
    words = [sys.executable, "-c", OPENS_NO_RECORDING, "runs", "--rig", "paper", "--below", "1um", "--last", "1000"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 1002
    (runs / "0007" / "run.mcap").unlink()
    (runs / "0007" / "run.mcap").write_bytes(recording.read_bytes())
    assert subprocess.run(words, capture_output=True, check=False).returncode == 9


def test_only_what_is_new_or_has_changed_is_read(runs: Path, recording: Path, read: list[str]) -> None:
    for name in "abc":
        put(runs, name, recording)
    known(runs)
    put(runs, "d", recording)
    (runs / "b" / "run.mcap").unlink()
    (runs / "b" / "run.mcap").write_bytes(recording.read_bytes()[:-100])
    (runs / "a" / "run.mcap").unlink()
    (runs / "a").rmdir()
    read.clear()
    assert len(known(runs)) == 3
    assert sorted(read) == ["b", "d"]
    base = sqlite3.connect(index_file())
    assert base.execute("SELECT count(*) FROM runs").fetchone() == (3,)  # none of what is gone
    base.close()


def missing() -> None:
    index_file().unlink()


def damaged() -> None:
    index_file().write_bytes(b"no database" * 1000)


def of_another_format() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("DROP TABLE runs; CREATE TABLE runs (other TEXT); PRAGMA user_version = 999")
    base.close()


def with_another_table() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("DROP TABLE runs; CREATE TABLE runs (other TEXT)")
    base.close()


def of_another_version_of_hil() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("UPDATE runs SET stamp = 'x' || stamp")
    base.close()


def with_facts_that_are_none() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("UPDATE runs SET facts = '[1'")
    base.close()


@pytest.mark.parametrize(
    "spoil",
    [missing, damaged, of_another_format, with_another_table, of_another_version_of_hil, with_facts_that_are_none],
)
def test_an_index_that_is_no_use_is_made_anew(
    spoil: Callable[[], None], runs: Path, recording: Path, read: list[str]
) -> None:
    put(runs, "a", recording)
    first = known(runs)
    spoil()
    assert known(runs) == known(runs) == first
    assert read == ["a", "a"]


def test_without_a_place_for_the_index_runs_are_read_each_time(
    runs: Path, recording: Path, read: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(runs, "a", recording)
    monkeypatch.setenv("XDG_CACHE_HOME", str(recording))  # a file: no folder can be made in it
    assert known(runs) == known(runs)
    assert read == ["a", "a"]


def test_an_index_that_others_may_write_to_is_not_believed(runs: Path, recording: Path, read: list[str]) -> None:
    put(runs, "a", recording)
    known(runs)
    index_file().parent.chmod(0o777)
    known(runs)
    assert read == ["a", "a"]


def test_a_list_writes_nothing_into_the_folder_of_the_runs(runs: Path, recording: Path) -> None:
    put(runs, "a", recording)
    before = sorted(runs.rglob("*")), [path.stat().st_mtime_ns for path in (runs, runs / "a")]
    assert command().exit_code == 0
    assert (sorted(runs.rglob("*")), [path.stat().st_mtime_ns for path in (runs, runs / "a")]) == before


def test_what_cannot_be_read_is_listed_with_the_reason(runs: Path, recording: Path) -> None:
    put(runs, "good", recording)
    for name in ("junk", "pipe", "folder", "gone", "empty", "cut", "20260101-120000", "other"):
        (runs / name).mkdir()
    (runs / "junk" / "run.mcap").write_bytes(os.urandom(5000))
    os.mkfifo(runs / "pipe" / "run.mcap")
    (runs / "folder" / "run.mcap").mkdir()
    (runs / "gone" / "run.mcap").symlink_to(runs / "nowhere")
    (runs / "empty" / "run.mcap").touch()
    (runs / "cut" / "run.mcap").write_bytes(recording.read_bytes()[:30_000])
    done = command()
    assert done.exit_code == 0
    assert "Traceback" not in done.output
    lines = {line.split()[0]: line for line in done.output.splitlines()}
    assert "not read: not a recording of a control process" in lines["junk"]
    assert "not a file but a pipe" in lines["pipe"]
    assert "not a file but a directory" in lines["folder"]
    assert "run.mcap: No such file or directory" in lines["gone"]
    assert "not read" in lines["empty"]
    assert "it holds no recording" in lines["20260101-120000"]
    assert "other" not in lines  # nobody made it for a run
    assert "ACTIVE" in lines["good"]


def test_a_recording_that_lacks_ticks_says_so(runs: Path, recording: Path) -> None:
    (runs / "cut").mkdir()
    (runs / "cut" / "run.mcap").write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    (facts,) = known(runs)
    assert facts["missing"] or facts["outcome"] == "unread"


def test_whatever_breaks_in_one_recording_does_not_hide_the_others(
    runs: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(runs, "a", recording)

    def breaks(path: Path) -> None:
        raise IndexError(f"{path}: {EVIL}")

    monkeypatch.setattr("hil.runs.summary.load_run", breaks)
    done = command()
    assert done.exit_code == 0
    assert "not read: a?[31m??b" in done.output


def test_each_control_process_of_a_folder_is_a_run_and_its_parts_are_one(runs: Path, recording: Path) -> None:
    put(runs, "a", recording)
    for name in ("run-2.mcap", "run-2.part-2.mcap", "run-2.part-10.mcap", "run-2.part-9.mcap", "fault-X-1-2.mcap"):
        put(runs, "a", recording, name)
    put(runs, "a", recording, "blackbox.mcap")
    put(runs, "", recording)
    assert {str(run.path.relative_to(runs)): len(run.files) for run in kept_runs(runs)} == {
        ".": 1, "a": 1, "a/run-2.mcap": 4, "a/blackbox.mcap": 1
    }  # fmt: skip
    (second,) = (run for run in kept_runs(runs) if run.stem == "run-2")
    assert [path.name for path in second.files][1:] == [f"run-2.part-{number}.mcap" for number in (2, 9, 10)]


def test_names_from_a_disk_do_not_command_a_terminal(runs: Path, recording: Path) -> None:
    put(runs, EVIL, recording)
    (runs / os.fsdecode(b"\xff\xfe")).mkdir()
    os.link(recording, runs / os.fsdecode(b"\xff\xfe") / "run.mcap")
    (runs / EVIL / "run.note.json").write_text(json.dumps({"note": f"one\n{EVIL}", "labels": []}))
    for words in ((), ("note", str(runs / EVIL))):
        done = command(*words)
        assert done.exit_code == 0, done.output
        assert not set(done.output) & set("\x1b\x07\u202e")
    assert len(command().output.splitlines()) == 4
    assert len(json.loads(command("--json", "-").stdout)) == 2


def test_a_folder_without_runs_and_none_at_all(runs: Path) -> None:
    assert command().output == "0 runs in runs\n"
    runs.rmdir()
    done = subprocess.run([sys.executable, "-m", "hil", "runs"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (74, "hil: runs/: no run here; make one: hil demo\n")


def test_a_note_goes_where_its_folder_goes(runs: Path, recording: Path) -> None:
    folder = put(runs, "a", recording)
    put(runs, "a", recording, "run-2.mcap")
    assert command("note", "runs/a", "new guide, 20 N preload", "--label", "good", "--label", "ours").exit_code == 0
    assert command("note", "runs/a/run-2.mcap", "again").exit_code == 0
    assert command("note", "runs/a", "--without", "ours").exit_code == 0
    folder.rename(runs / "moved")
    assert command("note", "runs/moved").output == "[good] new guide, 20 N preload\n"
    found = documents()
    assert (found["moved"]["note"], found["moved"]["labels"]) == ("new guide, 20 N preload", ["good"])
    assert found["run-2.mcap"]["note"] == "again"
    assert "[good] new guide" in command().output


@pytest.mark.parametrize(
    ("note", "said"),
    [
        (Note("x" * (LONGEST + 1)), "at most 2000"),
        (Note(labels=("two words",)), "letters, digits"),
        (Note(labels=(EVIL,)), "label 'a\\\\x1b"),
        (Note(labels=tuple(map(str, range(21)))), "at most 20"),
    ],
)
def test_a_note_that_is_refused_leaves_the_old_one(note: Note, said: str, runs: Path, recording: Path) -> None:
    run = kept_run(put(runs, "a", recording))
    write_note(run, Note("old"))
    with pytest.raises(ValueError, match=said):
        write_note(run, note)
    assert note_of(run) == Note("old")
    assert sorted(path.name for path in run.folder.iterdir()) == ["run.mcap", "run.note.json"]


def test_a_note_does_not_write_through_a_link(runs: Path, recording: Path) -> None:
    folder = put(runs, "a", recording)
    (runs / "mine.txt").write_text("mine")
    (folder / "run.note.json").symlink_to(runs / "mine.txt")
    assert command("note", "runs/a").exit_code == 74
    assert command("note", "runs/a", "text").exit_code == 0
    assert (runs / "mine.txt").read_text() == "mine"
    assert not (folder / "run.note.json").is_symlink()


@pytest.mark.parametrize("text", ["", "[]", '{"note": 1, "labels": []}', '{"note": "", "labels": [1]}', "[" * 60_000])
def test_a_damaged_note_is_said(text: str, runs: Path, recording: Path) -> None:
    folder = put(runs, "a", recording)
    (folder / "run.note.json").write_text(text)
    assert "its note cannot be read: it is damaged" in command().output
    done = command("note", "runs/a")
    assert done.exit_code == 74


def test_a_note_on_what_is_no_run_is_refused(runs: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hil", "runs", "note", "runs", "x"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (74, "hil: runs: no run.mcap or blackbox.mcap of a run\n")


PAGES = "".join((ROOT / "docs" / name).read_text() for name in ("recording.md", "how-to.md"))
SHOWN = sorted(set(re.findall(r"`hil (runs\b[^`]*)`", PAGES)))


@pytest.mark.parametrize("text", SHOWN)
def test_a_command_shown_in_a_page_runs(text: str, runs: Path, recording: Path) -> None:
    folder = put(runs, "a", recording)
    done = command(*shlex.split(text.replace("RUN", str(folder)))[1:])
    assert done.exit_code == 0, done.output


def test_pages_show_commands() -> None:
    assert len(SHOWN) > 8
