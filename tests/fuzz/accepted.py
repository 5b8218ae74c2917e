"""python -m tests.fuzz.accepted laws|rigs --count N --seed N: what `hil check` accepts, the other commands accept.

Laws and rigs are drawn, right ones and wrong ones. Each is checked; where check accepts it, short runs of the other
commands must neither refuse it nor end in a traceback. Where check refuses it, it says so in words. Prints what each
command answered; exit status 1 at the first that broke this, with its files and words.
"""

import argparse
import contextlib
import io
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.fuzz.generated_laws import law_source
from tests.fuzz.generated_rigs import changes, new_words
from tests.support.command_line import exit_status

REFUSED = (2, 78)  # usage, and a rig file that is wrong
# What is refused of the words or the law's own choice, and not of what check accepts.
OTHERWISE = ("--seconds", "the law declares no gain with a range to search", "batches the layout stage_fd")
SHORT = (
    ("sim", "{rig}", "--seconds", "0.3", "--record", "run.mcap"),
    ("events", "run.mcap"),
    ("replay", "run.mcap", "--run-its-code"),
    ("sweep", "{rig}", "--plants", "2", "--seconds", "9", "--workers", "1", "--worst", "0"),
    ("tune", "{rig}", "--population", "5", "--generations", "1", "--unseen", "1", "--trials", "task", "--dry-run"),
    ("compare", "{rig}", "--undisturbed", "--seconds", "1", "--workers", "1", "--laws", "{law}"),
)
WITH_SET = ("sim", "sweep", "tune", "compare")


class Answer(NamedTuple):
    """Of one command: its words, exit status and everything it wrote."""

    words: tuple[str, ...]
    status: int
    text: str


def hil(*words: str) -> Answer:
    """`hil WORDS` in this process. Raises what the command raises."""
    written = io.StringIO()
    with contextlib.redirect_stdout(written), contextlib.redirect_stderr(written):
        status = exit_status(*words)
    return Answer(words, status, written.getvalue())


class BrokenError(Exception):
    """What check had accepted was refused, or a command ended in a traceback."""


def _sound(answer: Answer) -> Answer:
    """The answer, unless it is a traceback or says nothing of a refusal."""
    if "Traceback" in answer.text or (answer.status and not answer.text.strip()):
        raise BrokenError(f"{' '.join(answer.words)}: status {answer.status}\n{answer.text}")
    return answer


def _answers(rig: str, law: str, sets: Sequence[str]) -> Iterator[Answer]:
    """Those of check, and, where it accepts, of the other commands."""
    options = [word for key in sets for word in ("--set", key)]
    checked = _sound(hil("check", rig, *options))
    yield checked
    if checked.status:
        return
    for short in SHORT:
        words = [word.format(rig=rig, law=law) for word in short]
        answer = _sound(hil(*words, *(options if words[0] in WITH_SET else ())))
        if answer.status in REFUSED and not any(words in answer.text for words in OTHERWISE):
            raise BrokenError(f"check accepts, {' '.join(answer.words)}: status {answer.status}\n{answer.text}")
        yield answer


def one_law(chance: random.Random) -> Iterator[Answer]:
    """A drawn law on the paper's rig."""
    Path("drawn.py").write_text(law_source(chance), encoding="utf-8")
    law = "./drawn.py:Drawn"
    yield from _answers("paper", law, [f"law.name={law}"])


def one_rig(chance: random.Random) -> Iterator[Answer]:
    """A drawn rig; `hil new` may refuse its answers in words."""
    made = _sound(hil("new", "drawn.toml", *new_words(chance)))
    yield made
    if made.status == 0:
        yield from _answers("drawn.toml", "pd-feedforward", changes(chance))


KINDS = {"laws": one_law, "rigs": one_rig}


def tried(kind: str, count: int, seed: int, first: int = 0) -> Counter[str]:
    """How often each command ended with which status, over `count` draws, each in an empty folder.

    Raises BrokenError with the draw's number and folder, which stays.
    """
    answered: Counter[str] = Counter()
    here = Path.cwd()
    for number in range(first, first + count):
        folder = Path(tempfile.mkdtemp(prefix=f"accepted-{kind}-{number}-"))
        os.chdir(folder)
        try:
            for answer in KINDS[kind](random.Random(f"{kind} {seed} {number}")):
                answered[f"{answer.words[0]}: {answer.status}"] += 1
        except Exception as error:
            raise BrokenError(f"draw {number} of seed {seed}, in {folder}: {type(error).__name__}: {error}") from error
        finally:
            os.chdir(here)
        shutil.rmtree(folder)
    return answered


def main(arguments: Sequence[str]) -> int:
    """Try them, say what came of it."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.accepted", description=__doc__)
    parser.add_argument("kind", choices=sorted(KINDS))
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args(arguments)
    for done in range(options.first, options.first + options.count, 10):
        count = min(10, options.first + options.count - done)
        found = tried(options.kind, count, options.seed, done)
        print(
            f"{options.kind} {done} to {done + count - 1}: ",
            ", ".join(f"{k} {n}" for k, n in sorted(found.items())),
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
