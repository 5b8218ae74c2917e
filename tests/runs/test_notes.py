"""Notes on runs: where they go, what is refused, and what a damaged one costs."""

from pathlib import Path

import pytest

from hil.runs.kept import kept_run
from hil.runs.note import LONGEST, Note, note_of, write_note
from tests.support.command_line import CommandLine
from tests.support.listed import EVIL, command, documents, put


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


def test_a_note_on_what_is_no_run_is_refused(runs: Path, hil_here: CommandLine) -> None:
    done = hil_here("runs", "note", "runs", "x")
    assert (done.returncode, done.stderr) == (74, "hil: runs: no run.mcap or blackbox.mcap of a run\n")
