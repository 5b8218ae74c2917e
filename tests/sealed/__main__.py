"""python -m tests.sealed [--seed N] [--count 20] [--folder F]: faults that nobody knows beforehand.
python -m tests.sealed --sound 200 --seed N --kept FILE --minutes 10: a part of the sound runs; again, and it goes on.

Draws the faults and seals them, runs each on a shipped rig in virtual time, reads the answers from the runs' events
alone, and only then opens the seal and compares. With --sound: runs without a fault, in which nothing may be told.
Exit status 1 where a bar is missed: of 20 faults the cause right in 18 and the axis in 19, each quiet fault told within
0.5 s of showing, no false alarm.
"""

import argparse
import math
import random
import secrets
import sys
import tempfile
from pathlib import Path

from tests.sealed import seal
from tests.sealed.draw import Case, draw_fault
from tests.sealed.reader import Answer
from tests.sealed.run import answers
from tests.sealed.score import Score, score
from tests.sealed.sound import sound

CAUSES, AXES, OF = 18, 19, 20


def faults(seed: int, count: int, folder: Path) -> bool:
    """Whether all bars are met."""
    draw = random.Random(seed)
    drawn = [draw_fault(draw) for _ in range(count)]
    print(f"sealed: {seal.close(folder, seed, drawn)}", flush=True)
    said = answers(drawn, folder)
    cases = seal.opened(folder)
    scores = [score(case, answer) for case, answer in zip(cases, said, strict=True)]
    for number, (case, answer, got) in enumerate(zip(cases, said, scores, strict=True)):
        _show(number, case, answer, got)
    causes, axes = sum(got.cause for got in scores), sum(got.axis for got in scores)
    late = [got.late_s for got in scores if not got.in_time]
    print(f"seed {seed}: cause {causes} of {count}, axis {axes} of {count}, quiet faults told late: {len(late)}")
    return causes * OF >= CAUSES * count and axes * OF >= AXES * count and not late


def _show(number: int, case: Case, answer: Answer, got: Score) -> None:
    words = "right" if got.cause and got.axis and got.in_time else "WRONG"
    size = "" if case.value is None else f" {case.value:.4g}"
    truth = f"{case.rig}: {case.kind}{size} on {case.axis} at {case.at_s} s, shows at {case.shows_s} s"
    print(f"{number}: {words}: {truth}; said {answer.axis or 'no axis'} at {answer.at_s:.3f} s: {answer.line or '-'}")


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.sealed", description=(__doc__ or "").partition("\n")[2])
    parser.add_argument("--seed", type=int, default=secrets.randbits(31), help="of the drawing [another every time]")
    parser.add_argument("--count", type=int, default=OF, help="faults")
    parser.add_argument("--sound", type=int, default=0, help="runs without a fault, instead of faults")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="answers of sound runs, which are not run again")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no sound run after so many")
    parser.add_argument("--first", type=int, default=0, help="number of the first sound run to make [0]")
    parser.add_argument("--folder", type=Path, help="where seal and truth are kept [a temporary one]")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil-sealed-") as scratch:
        folder: Path = asked.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if asked.sound:
            good = sound(asked.seed, asked.sound, folder, asked.kept, asked.minutes, asked.first)
        else:
            good = faults(asked.seed, asked.count, folder)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
