"""What every law asks for has not changed, to the bit, and is the same on arrays as on floats. Where a change is meant,
`python -m tests.support.reference laws` renews tests/reference/law_hashes.json.
"""

import json
import math

import pytest

from tests.support.law_reference import FILE, TICKS, hash_of, laws, models, play

KNOWN = json.loads(FILE.read_text(encoding="utf-8"))["forces"]


def test_there_is_a_hash_of_every_law() -> None:
    assert set(KNOWN) == set(laws()), "python -m tests.support.reference laws"
    assert len({hashes["stiff"] for hashes in KNOWN.values()}) > 0.9 * len(KNOWN), "they do differ"


@pytest.mark.parametrize("name", KNOWN)
def test_a_law_asks_for_what_it_always_did_on_arrays_and_on_floats(name: str) -> None:
    for kind, model in models().items():
        arrays, floats = play(laws()[name], model)
        assert len(arrays) == TICKS
        assert all(math.isfinite(force) for forces in arrays for force in forces)
        assert arrays == floats
        assert hash_of(arrays) == KNOWN[name][kind], kind
