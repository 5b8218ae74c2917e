"""What every law asks for has not changed, to the bit, and is the same on arrays as on floats (tests/golden/laws)."""

import math

import pytest

from tests.golden.golden import hold
from tests.golden.laws.tell import TICKS, laws, lines, models, play, stories


@pytest.mark.long
@pytest.mark.parametrize("name", stories())
def test_a_law_asks_for_what_it_always_did_on_arrays_and_on_floats(name: str) -> None:
    told = []
    for kind, model in models().items():
        arrays, floats = play(laws()[name], model)
        assert len(arrays) == TICKS
        assert all(math.isfinite(force) for forces in arrays for force in forces)
        assert arrays == floats
        told += lines(kind, arrays)
    hold("laws", name, told)
