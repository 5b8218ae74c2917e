"""What every layout's host sends, and makes of all it hears, has not changed over long conversations. Where a change is
meant, `python -m tests.support.reference conversations` renews tests/reference/conversations.json.
"""

import json

import pytest

from drivers.protocols.base import Reject
from tests.support.conversation_reference import FILE, digest
from tests.support.host_conversations import PIECES, TALKS, frames_in_words, talk

DOCUMENT = json.loads(FILE.read_text(encoding="utf-8"))
KNOWN, WORDS = DOCUMENT["hosts"], DOCUMENT["words"]


def test_there_are_hashes_of_every_conversation() -> None:
    assert set(KNOWN) == set(TALKS), "python -m tests.support.reference conversations"
    assert len({piece for pieces in KNOWN.values() for piece in pieces}) == PIECES * len(KNOWN), "they do differ"


@pytest.mark.parametrize("name", TALKS)
def test_a_host_says_and_hears_what_it_always_did(name: str) -> None:
    pieces = list(talk(name))
    heard = [line.split(" : ")[1] for lines in pieces for line in lines if " : " in line]
    assert sum(outcome not in Reject.__members__ for outcome in heard) > 1000, "samples"
    assert {"WRONG_LENGTH", "UNKNOWN_ID", "ERROR_FRAME"} <= set(heard), "and noise"
    assert [digest(lines) for lines in pieces] == KNOWN[name], (
        f"python -m tests.support.conversation_reference '{name}' PIECE"
    )


@pytest.mark.parametrize("name", TALKS)
def test_its_frames_are_told_to_people_in_the_words_they_always_were(name: str) -> None:
    told = frames_in_words(name)
    assert len(set(told)) > 150
    assert digest(told) == WORDS[name], "python -m tests.support.reference conversations"
