"""Any value of any key is taken or refused as it always was, in the same words (tests/golden/refusals)."""

import pytest

from tests.golden.golden import hold
from tests.golden.refusals.tell import RIG_NAMES, VALUES, keys, lines, outcomes, stories


@pytest.mark.long
@pytest.mark.parametrize("story", stories())
def test_a_value_is_taken_or_refused_as_it_always_was(story: str) -> None:
    told = {key: [outcomes(key, rig) for rig in RIG_NAMES] for key in keys()[story]}
    hold("refusals", story, [line for key in keys()[story] for line in lines(key, *told[key])])
    refused = sum(text.startswith("refused: ") for texts in told.values() for text in texts[0])
    assert refused > 0.4 * len(told) * len(VALUES), "most of the values fit no key"
