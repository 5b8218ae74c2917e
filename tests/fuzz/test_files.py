"""Damaged files: a clear error or a right answer, soon, in little memory, no traceback."""

import pytest

from tests.fuzz.__main__ import MOST_MB, tried
from tests.fuzz.kinds import KINDS

FEW, MANY = 60, 600  # 10 000 of a kind: python -m tests.fuzz KIND --files 10000


@pytest.mark.requirement(id="SR-9.4")
@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_damaged_files_are_read_or_refused(kind: str) -> None:
    counts = tried(kind, FEW, seed=1)
    assert counts["read"] + counts["refused"] == FEW
    assert min(counts["read"], counts["refused"]) > 0  # damage in a comment does no harm


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files_are_read_or_refused_in_little_memory(kind: str) -> None:
    counts = tried(kind, MANY, seed=2)
    assert counts["read"] + counts["refused"] == MANY
    assert counts["grown_mb"] < MOST_MB
