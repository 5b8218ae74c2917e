"""A key that has to be held: touched, held, let go, and a terminal that is gone."""

import itertools

from hil.operate.dead_man import KEY, RELEASED_S, HeldKey

REPEATS_S, FIRST_S = 0.03, 0.5  # of a terminal: between presses, and before the second


def looked_at(presses_s: list[float], until_s: float, step_s: float = 0.02) -> list[float]:
    """When the key counted as held, s, looked at every step_s."""
    clock, waiting = [0.0], sorted(presses_s)

    def keys() -> str:
        come = [press for press in waiting if press <= clock[0]]
        del waiting[: len(come)]
        return KEY * len(come)

    held, seen = HeldKey(keys, lambda: clock[0]), []
    while clock[0] < until_s:
        if held():
            seen.append(clock[0])
        clock[0] += step_s
    return seen


def test_a_key_that_is_touched_is_not_held() -> None:
    assert looked_at([0.5], 3.0) == []
    assert looked_at([0.5, 1.2, 1.9], 3.0) == []


def test_it_is_held_from_its_first_repetition_until_it_is_let_go() -> None:
    repeats = [0.1 + FIRST_S + REPEATS_S * k for k in range(50)]
    seen = looked_at([0.1, *repeats], 4.0)
    assert repeats[1] <= seen[0] <= repeats[1] + 0.02
    assert repeats[-1] <= seen[-1] <= repeats[-1] + RELEASED_S + 0.02
    assert max(b - a for a, b in itertools.pairwise(seen)) < 0.03, "without a gap"


def test_presses_that_come_late_together_count_as_a_held_key() -> None:
    """Of a process that was held up, or a connection."""
    assert looked_at([0.5, 0.5, 0.5], 2.0)


def test_another_key_is_none() -> None:
    held = HeldKey(lambda: "\x04q", lambda: 0.0)
    assert not held()
    assert not held()
