"""What `hil check` accepts, every command accepts: drawn laws, drawn rigs."""

import pytest

from tests.fuzz.accepted import KINDS, tried

FEW = 4  # a law to tune takes 40 s; a thousand of each kind: python -m tests.fuzz.accepted laws


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_drawn_ones(kind: str) -> None:
    answered = tried(kind, FEW, seed=2)
    assert answered["check: 0"], "one at least was accepted, and went through the other commands"
