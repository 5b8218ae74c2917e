"""What every layout's host sends, and makes of all it hears, has not changed over long conversations
(tests/golden/hosts).
"""

import pytest

from drivers.protocols.base import Reject
from tests.golden.golden import hold
from tests.golden.hosts.tell import frames_in_words, lines, outcomes, stories, talk, words


@pytest.mark.long
@pytest.mark.parametrize("name", stories())
def test_a_host_says_and_hears_what_it_always_did_and_people_read_the_same_words(name: str) -> None:
    pieces, told = list(talk(name)), frames_in_words(name)
    heard = [what for piece in pieces for what in outcomes(piece)]
    assert sum(what not in Reject.__members__ for what in heard) > 1000, "samples"
    assert {"WRONG_LENGTH", "UNKNOWN_ID", "ERROR_FRAME"} <= set(heard), "and noise"
    assert len(set(told)) > 150
    hold("hosts", name, [*lines(pieces), *words(told)])
