"""A person's note on a run, and its labels: a small file beside the recording, which moves with the folder."""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from drivers.base.runtime import write_private
from drivers.base.text_file import UnsuitableFileError, printable, read_bounded, words_of
from hil.runs.kept import KeptRun

LONGEST = 2000  # characters of a note
MOST_LABELS = 20
LABEL = re.compile(r"\w[\w.+-]{0,39}")
_LARGEST = 2**16  # bytes
_MODE = 0o640  # as recordings have it


class Note(NamedTuple):
    """text: may be empty. labels: in the order of the alphabet. problem: why they cannot be read; else empty."""

    text: str = ""
    labels: tuple[str, ...] = ()
    problem: str = ""


def note_file(run: KeptRun) -> Path:
    """Where the note of a run is."""
    return run.folder / f"{run.stem}.note.json"


def note_of(run: KeptRun) -> Note:
    """The note as it may be shown; empty where there is none."""
    try:
        found = json.loads(read_bounded(note_file(run), _LARGEST))
        text, labels = found["note"], found["labels"]
        if not isinstance(text, str) or not all(isinstance(label, str) and LABEL.fullmatch(label) for label in labels):
            raise ValueError("a note of another form")
    except FileNotFoundError:
        return Note()
    except OSError as error:
        return Note(problem=words_of(error))
    except (UnsuitableFileError, ValueError, KeyError, TypeError, RecursionError):
        return Note(problem="it is damaged")
    return Note(printable(text[:LONGEST]), tuple(sorted(set(labels)))[:MOST_LABELS])


def write_note(run: KeptRun, note: Note) -> Path:
    """Replace the run's note; a reader meets the old one or the new one. Raises OSError, ValueError."""
    if len(note.text) > LONGEST:
        raise ValueError(f"the note has {len(note.text)} characters; at most {LONGEST} are kept")
    labels = sorted(set(_checked(note.labels)))
    if len(labels) > MOST_LABELS:
        raise ValueError(f"{len(labels)} labels; at most {MOST_LABELS} are kept")
    path = note_file(run)
    write_private(path, json.dumps({"note": printable(note.text), "labels": labels}, indent=1) + "\n")
    path.chmod(_MODE)
    return path


def _checked(labels: Iterable[str]) -> Iterable[str]:
    for label in labels:
        if not LABEL.fullmatch(label):
            raise ValueError(f"label {label!a}: expected 1 to 40 letters, digits or . _ + -, a letter or digit first")
        yield label
