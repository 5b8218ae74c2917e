"""What `hil check` accepts, every command accepts: drawn laws, drawn rigs."""

import pytest

from tests.fuzz.accepted import KINDS, tried

FEW, MANY = 4, 60  # a thousand: python -m tests.fuzz.accepted laws


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_drawn_ones(kind: str) -> None:
    answered = tried(kind, FEW, seed=2)
    assert answered["check: 0"], "one at least was accepted, and went through the other commands"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_drawn_ones(kind: str) -> None:
    answered = tried(kind, MANY, seed=3)
    assert answered["check: 0"] >= MANY // 6
