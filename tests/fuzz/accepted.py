"""python -m tests.fuzz.accepted laws|rigs --count N --seed N --kept FILE: what check accepts, the others accept.

Laws and rigs are drawn, right ones and wrong ones. Each is checked; where check accepts it, short runs of the other
commands must neither refuse it nor end in a traceback. Where check refuses it, it says so in words. Prints what the
commands answered, and each draw that broke this with its folder and words; exit status 1 where one did.

The same command with the same file of answers goes on where it ended. A draw that broke is drawn again.
"""

import argparse
import contextlib
import functools
import io
import json
import os
import pickle
import random
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from hil.studies import crew
from hil.studies.tune import objective
from tests.fuzz.generated_laws import law_source
from tests.fuzz.generated_rigs import changes, new_words
from tests.support.command_line import exit_status

REFUSED = (2, 78)  # usage, and a rig file that is wrong
# What is refused of the words or the law's own choice, and not of what check accepts.
OTHERWISE = (
    "the law declares no gain with a range to search",
    "batches the layout stage_fd",
    "nothing is written; more --generations",  # a search of ten candidates that met no margins
)
SHORT = (
    ("sim", "{rig}", "--seconds", "0.3", "--record", "run.mcap"),
    ("events", "run.mcap"),
    ("replay", "run.mcap", "--run-its-code"),
    ("sweep", "{rig}", "--plants", "2", "--seconds", "1", "--workers", "1", "--worst", "0"),
    ("tune", "{rig}", "--population", "5", "--generations", "1", "--unseen", "1", "--trials", "task", "--dry-run"),
    ("compare", "{rig}", "--undisturbed", "--seconds", "1", "--workers", "1", "--laws", "{law}"),
)
WITH_SET = ("sim", "sweep", "tune", "compare")
TOO_SHORT = re.compile(r"--seconds \S+ the steady window begins at (\S+) s")
TUNED_S = 0.2  # of a trial of `hil tune` before its window, and of the window
ANSWER = 200  # ticks of the loops' answers in `hil tune`
WHOLE = 10  # one draw of so many has its pictures drawn; a law runs on the paper's rig there, else on one axis


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
        words += options if words[0] in WITH_SET else ()
        answer = _sound(hil(*words))
        if begins := TOO_SHORT.search(answer.text):
            answer = _sound(hil(*words, "--seconds", f"{float(begins[1]) + 0.1:g}"))
        if answer.status in REFUSED and not any(words in answer.text for words in OTHERWISE):
            raise BrokenError(f"check accepts, {' '.join(answer.words)}: status {answer.status}\n{answer.text}")
        yield answer


def one_law(number: int, chance: random.Random) -> Iterator[Answer]:
    """A drawn law, on the paper's rig or on one axis."""
    Path("drawn.py").write_text(law_source(chance), encoding="utf-8")
    rig, law = "paper", "./drawn.py:Drawn"
    if number % WHOLE:
        rig = "one.toml"
        Path(rig).write_text(_one_axis(), encoding="utf-8")
    yield from _answers(rig, law, [f"law.name={law}"])


@functools.cache
def _one_axis() -> str:
    """The rig file of `hil new --axes x`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "one.toml"
        _sound(hil("new", str(file), "--axes", "x"))
        return file.read_text(encoding="utf-8")


def one_rig(_: int, chance: random.Random) -> Iterator[Answer]:
    """A drawn rig; `hil new` may refuse its answers in words."""
    made = _sound(hil("new", "drawn.toml", *new_words(chance)))
    yield made
    if made.status == 0:
        yield from _answers("drawn.toml", "pd-feedforward", changes(chance))


KINDS = {"laws": one_law, "rigs": one_rig}


class _Here:
    """The worker pool of a study without processes. Jobs and results are pickled, as on their way to a worker."""

    def __init__(self, *_: object) -> None:
        """Whatever the pool would have."""

    def __enter__(self) -> "_Here":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""

    def shutdown(self, *, cancel_futures: bool) -> None:
        """No job of it is left to be done."""

    def map(self, function: Callable[[Any], Any], work: Sequence[Any]) -> Iterator[Any]:
        """Results in the order of the jobs."""
        for job in work:
            yield pickle.loads(pickle.dumps(function(pickle.loads(pickle.dumps(job)))))


@contextlib.contextmanager
def cheap(pictures: bool) -> Iterator[None]:
    """Studies in this process, and trials of `hil tune` of a fraction of a second: the same code, less of it."""
    from matplotlib import pyplot  # behind hil: it loads numpy, whose BLAS then would take every core

    with (
        contextlib.nullcontext() if pictures else patch.object(pyplot.Figure, "savefig"),
        patch.object(crew, "worker_pool", _Here),
        patch.object(objective, "ANSWER", ANSWER),
        patch.object(objective, "SETTLE_S", TUNED_S),
        patch.object(objective, "WINDOW_S", TUNED_S),
    ):
        yield


def tried(kind: str, number: int, seed: int) -> Counter[str]:
    """How often each command ended with which status in one draw, in an empty folder.

    Raises BrokenError with the draw's folder, which stays.
    """
    answered: Counter[str] = Counter()
    here = Path.cwd()
    folder = Path(tempfile.mkdtemp(prefix=f"accepted-{kind}-{number}-"))
    os.chdir(folder)
    try:
        with cheap(pictures=number % WHOLE == 0):
            for answer in KINDS[kind](number, random.Random(f"{kind} {seed} {number}")):
                answered[f"{answer.words[0]}: {answer.status}"] += 1
    except Exception as error:
        raise BrokenError(f"draw {number} of seed {seed}, in {folder}: {type(error).__name__}: {error}") from error
    finally:
        os.chdir(here)
    shutil.rmtree(folder)
    return answered


def _read(kept: Path | None, kind: str, seed: int) -> dict[int, Counter[str]]:
    """Answers of earlier calls by the draw's number."""
    if kept is None or not kept.exists():
        return {}
    rows = [json.loads(line) for line in kept.read_text().splitlines()]
    return {row["number"]: Counter(row["answers"]) for row in rows if (row["kind"], row["seed"]) == (kind, seed)}


def try_all(kind: str, count: int, seed: int, kept: Path | None = None) -> int:
    """Draw those that `kept` has not, and keep their answers there; how many broke."""
    done, broken = _read(kept, kind, seed), 0
    for number in range(count):
        if number in done:
            continue
        try:
            done[number] = tried(kind, number, seed)
        except BrokenError as error:
            broken += 1
            print(f"BROKEN: {error}", flush=True)
            continue
        if kept is not None:
            with kept.open("a") as file:
                file.write(json.dumps({"kind": kind, "seed": seed, "number": number, "answers": done[number]}) + "\n")
    found = sum((done[number] for number in sorted(done) if number < count), Counter[str]())
    print(f"{kind}, seed {seed}: {broken} broken in {count}:", ", ".join(f"{k} {n}" for k, n in sorted(found.items())))
    return broken


def main(arguments: Sequence[str]) -> int:
    """Try them, say what came of it."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.accepted", description=__doc__)
    parser.add_argument("kind", choices=sorted(KINDS))
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kept", type=Path, metavar="FILE", help="answers of earlier calls, not drawn again")
    options = parser.parse_args(arguments)
    return min(1, try_all(options.kind, options.count, options.seed, options.kept))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
