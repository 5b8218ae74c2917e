"""How an attack is written down, tried and reported."""

import traceback
from collections.abc import Callable, Iterator
from typing import NamedTuple

from tests.attacks.before import before
from tests.attacks.target import Target

Attack = Callable[[Target], Iterator[str]]


class Listed(NamedTuple):
    """name, expected: for people. body: yields what was seen while the attack goes on; raises where it succeeded.
    moving, last: see `attack`.
    """

    name: str
    expected: str
    body: Attack
    moving: bool
    last: bool


class Result(NamedTuple):
    """What came of one. before, seen_before: on the code before (tests/attacks/before.py)."""

    attack: str
    expected: str
    seen: str
    held: bool
    before: str
    seen_before: str


def result(attack: str, expected: str, seen: str, *, held: bool) -> Result:
    """Beside what came of it on the code before."""
    earlier = before(attack)
    return Result(attack, expected, seen, held, earlier.fate, earlier.seen)


ATTACKS: list[Listed] = []


def attack(name: str, expected: str, *, moving: bool = False, last: bool = False) -> Callable[[Attack], Attack]:
    """List an attack. moving: stop is pressed on the moving rig while the attack goes on, which counts as another.
    last: the rig is not the same afterwards.
    """

    def add(body: Attack) -> Attack:
        ATTACKS.append(Listed(name, expected, body, moving, last))
        return body

    return add


def tried(listed: Listed, target: Target) -> list[Result]:
    """The attack, and the press of stop during it."""
    results = _made_ready(listed, target)
    course = listed.body(target)
    try:
        try:
            results.append(result(listed.name, listed.expected, next(course), held=True))
            if listed.moving:
                results.append(_pressed(listed, target))
        finally:
            for _ in course:  # the attack is over
                pass
    except Exception as error:
        results.append(result(listed.name, listed.expected, _told(error), held=False))
    return results


def _made_ready(listed: Listed, target: Target) -> list[Result]:
    """Empty; or, where the rig does not come back by itself, that, and a rig begun anew: the next attacks are tried."""
    begin = target.active if listed.moving else target.ready
    try:
        begin()
    except (AssertionError, OSError) as error:
        target.close()
        target.begin()
        begin()
        expected = "the rig comes back to READY by reset"
        return [result(f"{listed.name}: what came before it is over", expected, _told(error), held=False)]
    return []


def _told(error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({last.name}, line {last.lineno})"


def _pressed(listed: Listed, target: Target) -> Result:
    name, expected = f"stop pressed during: {listed.name}", "ESTOP latched by the loop at once"
    try:
        return result(name, expected, target.press(), held=True)
    except AssertionError as error:
        return result(name, expected, str(error), held=False)
