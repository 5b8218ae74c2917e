"""python -m tests.sealed [--seed N] [--count 20] [--sound 200] [--folder F]: faults that nobody knows beforehand.

Draws the faults and seals them, runs each on a shipped rig in virtual time, reads the answers from the runs' events
alone, and only then opens the seal and compares. With --sound: runs without a fault, in which nothing may be told.
Exit status 1 where a bar is missed: of 20 faults the cause right in 18 and the axis in 19, each quiet fault told within
0.5 s of showing, no false alarm.
"""

import argparse
import random
import secrets
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.sim import simulate
from tests.sealed import seal
from tests.sealed.draw import Case, draw_fault, draw_sound
from tests.sealed.reader import Answer, read
from tests.sealed.score import Score, score
from tests.support.paths import RIGS

CAUSES, AXES, OF = 18, 19, 20


def run_case(case: Case, folder: Path) -> None:
    """The run as `hil sim --out FOLDER` leaves it: a recording that says nothing of what was injected."""
    folder.mkdir()
    rig = case.config
    recorder = LockstepRecorder(folder / "run.mcap", rig, RIGS / f"{case.rig}.toml")
    try:
        simulate(rig, RIGS, case.seconds, observer=recorder.observe, scenario=case.scenario, tell=recorder.tell)
    finally:
        recorder.close()


def answers(cases: Sequence[Case], folder: Path) -> list[Answer]:
    """Run all of them; what each run's events say, to whom knows nothing else. Recordings are removed again."""
    found = []
    for number, case in enumerate(cases):
        where = folder / f"{number:03}"
        run_case(case, where)
        found.append(read(where))
        (where / "run.mcap").unlink()
        print(f"{number}: {found[-1].line or 'nothing happened'}", flush=True)
    return found


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


def sound(seed: int, count: int, folder: Path) -> bool:
    """Whether nothing is told in any of the runs."""
    draw = random.Random(seed)
    cases = [draw_sound(draw) for _ in range(count)]
    said = answers(cases, folder)
    false = [(case, answer) for case, answer in zip(cases, said, strict=True) if answer.line]
    for case, answer in false:
        print(f"FALSE: {case.rig}, plant.seed={case.seed}: {answer.line}")
    print(f"seed {seed}: {len(false)} false alarms in {count} sound runs")
    return not false


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.sealed", description=(__doc__ or "").partition("\n")[2])
    parser.add_argument("--seed", type=int, default=secrets.randbits(31), help="of the drawing [another every time]")
    parser.add_argument("--count", type=int, default=OF, help="faults")
    parser.add_argument("--sound", type=int, default=0, help="runs without a fault, instead of faults")
    parser.add_argument("--folder", type=Path, help="where seal and truth are kept [a temporary one]")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil-sealed-") as scratch:
        folder: Path = asked.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        good = sound(asked.seed, asked.sound, folder) if asked.sound else faults(asked.seed, asked.count, folder)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
