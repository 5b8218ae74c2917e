"""What a lane leaves out: other cases with every commit, at least one of each test, and none for ever."""

from tests.support.lanes import SAME_IN_BOTH_BUILDS, drawn
from tests.support.paths import ROOT

CASES = [f"case {number}" for number in range(25)]


def test_a_slice_is_one_in_so_many_and_never_none() -> None:
    assert [len(drawn(CASES, one_in, "a")) for one_in in (1, 4, 25, 100)] == [25, 7, 1, 1]
    assert drawn(["the only one"], 4, "a") == {"the only one"}
    assert drawn(CASES, 4, "a") == drawn(CASES[::-1], 4, "a"), "whatever the order"


def test_commits_draw_different_slices_and_together_all() -> None:
    slices = [drawn(CASES, 4, f"commit {number}") for number in range(40)]
    assert len(set(map(frozenset, slices))) > 30
    assert set.union(*slices) == set(CASES)


def test_what_runs_once_is_named_by_folders_and_files_that_are_there() -> None:
    for folder, files in SAME_IN_BOTH_BUILDS.items():
        assert list((ROOT / folder).glob("test_*.py"))
        assert [name for name in files if not (ROOT / folder / name).exists()] == []
