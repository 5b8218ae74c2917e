"""`hil runs`: a list of what a folder holds, from an index that may vanish, and whatever lies in that folder."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from hil.runs import listed
from hil.runs.facts import facts_of
from hil.runs.kept import kept_run, kept_runs
from hil.runs.summary import load_run, summarise
from tests.support.command_line import CommandLine
from tests.support.listed import EVIL, command, documents, known, put
from tests.support.paths import ROOT

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


def test_a_run_that_is_still_recorded_has_no_end_and_lacks_nothing(runs: Path, recording: Path) -> None:
    put(runs, "a", recording)
    file = runs / "a" / "run.mcap"
    file.write_bytes(file.read_bytes()[:-40])  # as it is while its recorder writes
    assert "still recorded" in command().output
    assert "ticks missing" not in command().output
    long_ago = file.stat().st_mtime - 10.0
    os.utime(file, (long_ago, long_ago))
    assert "still recorded" not in command().output
    assert "ACTIVE" in command().output
    assert "ticks missing" in command().output


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


def test_a_folder_without_runs_and_none_at_all(runs: Path, hil_here: CommandLine) -> None:
    assert command().output == "0 runs in runs\n"
    runs.rmdir()
    done = hil_here("runs")
    assert (done.returncode, done.stderr) == (74, "hil: runs/: no run here; make one: hil demo\n")


PAGES = "".join((ROOT / "docs" / name).read_text() for name in ("recording.md", "how-to.md"))
SHOWN = sorted(set(re.findall(r"`hil (runs\b[^`]*)`", PAGES)))


@pytest.mark.parametrize("text", SHOWN)
def test_a_command_shown_in_a_page_runs(text: str, runs: Path, recording: Path) -> None:
    folder = put(runs, "a", recording)
    done = command(*shlex.split(text.replace("RUN", str(folder)))[1:])
    assert done.exit_code == 0, done.output


def test_pages_show_commands() -> None:
    assert len(SHOWN) > 8
