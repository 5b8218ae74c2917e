"""Any value of any key of a rig file is taken or refused as it always was, in the same words. Where a change is meant,
`python -m tests.support.reference refusals` renews tests/reference/refusal_hashes.json.
"""

import json

import pytest

from tests.support.refusal_reference import FILE, RIG_NAMES, VALUES, hashes, keys, outcomes


@pytest.mark.parametrize("name", RIG_NAMES)
def test_a_value_is_taken_or_refused_as_it_always_was(name: str) -> None:
    known, told = json.loads(FILE.read_text(encoding="utf-8"))[name], outcomes(name)
    assert list(known) == list(told) == keys()
    refused = sum(f"{name}.toml: " in text for texts in told.values() for text in texts)
    assert len(told) * len(VALUES) // 2 < refused < len(told) * len(VALUES)
    now = hashes(told)
    assert [key for key in now if now[key] != known[key]] == []
