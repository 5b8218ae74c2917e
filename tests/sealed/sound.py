"""Sound runs, which take half a minute each: a part of them at a time, every answer kept at once, resumed by seed.

The file of answers has one JSON object a line: seed, number and what was told, empty where nothing was.
"""

import json
import random
import time
from pathlib import Path

from tests.sealed.draw import Case, draw_sound
from tests.sealed.run import answers


def sound(
    seed: int, count: int, scratch: Path, kept: Path | None = None, minutes: float = float("inf"), first: int = 0
) -> bool:
    """Whether nothing was told in any of so many runs. kept: answers of earlier calls, which are not run again, and of
    this one. minutes: no run is begun after so many, and what is still to come is no failure. first: number of the
    first run to make; those before it are drawn and left out.
    """
    draw = random.Random(seed)
    cases = [draw_sound(draw) for _ in range(count)]
    told = _read(kept, seed)
    until = time.monotonic() + 60.0 * minutes
    for number, case in enumerate(cases):
        if number >= first and number not in told and time.monotonic() < until:
            told[number] = answers([case], scratch)[0].line
            _keep(kept, seed, number, told[number])
    done = [number for number in told if number < count]
    false = [number for number in done if told[number]]
    for number in false:
        print(f"FALSE: {_named(cases[number])}: {told[number]}")
    print(f"seed {seed}: {len(false)} false alarms in {len(done)} of {count} sound runs")
    return not false


def _named(case: Case) -> str:
    return f"{case.rig}, plant.seed={case.seed}"


def _read(kept: Path | None, seed: int) -> dict[int, str]:
    """By the run's number; of another seed nothing."""
    if kept is None or not kept.exists():
        return {}
    rows = [json.loads(line) for line in kept.read_text().splitlines()]
    return {int(row["number"]): str(row["told"]) for row in rows if row["seed"] == seed}


def _keep(kept: Path | None, seed: int, number: int, told: str) -> None:
    if kept is not None:
        with kept.open("a") as file:
            file.write(json.dumps({"seed": seed, "number": number, "told": told}) + "\n")
