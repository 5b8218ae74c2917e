"""Position demand and following error of a drive in cyclic synchronous position, at their exact thresholds."""

from typing import cast

import pytest

from sim_plant.drives.following import Demand, FollowingError
from sim_plant.drives.object_dictionary import ObjectDictionary, key_of

MS = 1_000_000


class Numbers:
    """An object dictionary of two numbers, of which each may be absent."""

    def __init__(self, **numbers: int) -> None:
        self._numbers = {key_of(int(name[1:], 16)): value for name, value in numbers.items()}

    def number(self, key: int, absent: int = 0) -> int:
        return self._numbers.get(key, absent)


def watched(**numbers: int) -> FollowingError:
    return FollowingError(cast(ObjectDictionary, Numbers(**numbers)))


def test_a_demand_is_a_straight_line_to_its_target_and_stays_there() -> None:
    demand = Demand(100.0, 300.0, 2 * MS, 4 * MS)
    assert [demand.at(at) for at in (2 * MS, 5 * MS // 2, 3 * MS, 4 * MS - 1, 4 * MS, 9 * MS)] == [
        100.0, 150.0, 200.0, pytest.approx(299.9999), 300.0, 300.0,
    ]  # fmt: skip


def test_an_error_beyond_the_window_for_its_time_is_told_once_until_it_is_cleared() -> None:
    following = watched(x6065=10, x6066=3)
    assert not following.look(110.4, 100.0, 0)
    assert following.error == 10
    seen = [(at, following.look(111.0, 100.0, at * MS), following.exceeded) for at in range(1, 7)]
    assert seen == [(1, False, False), (2, False, False), (3, False, False), (4, True, True), (5, False, True),
                    (6, False, True)]  # fmt: skip
    following.clear()
    assert (following.error, following.exceeded) == (0, False)
    assert not following.look(89.0, 100.0, 7 * MS)
    assert following.look(89.0, 100.0, 10 * MS), "the other way as well"


def test_an_error_that_breaks_off_begins_anew() -> None:
    following = watched(x6065=10, x6066=3)
    for at in range(20):
        assert not following.look(100.0 if at % 4 == 3 else 120.0, 100.0, at * MS)
    assert [following.look(120.0, 100.0, at * MS) for at in range(20, 24)][-1], "and is as long as ever"


def test_without_a_time_it_is_told_at_once_and_without_a_window_never() -> None:
    assert watched(x6065=0).look(101.0, 100.0, 0)
    for numbers in ({}, {"x6065": 0xFFFFFFFF, "x6066": 0}):
        following = watched(**numbers)
        assert not any(following.look(1e9, 0.0, at * MS) for at in range(100))
        assert following.error == 10**9
