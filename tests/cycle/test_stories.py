"""What happens in random stories, of faults and orders on a rig and of nodes on a wire, is what always did, to a byte.
Where a change is meant, `python -m tests.support.reference stories` renews tests/reference/story_hashes.json.
"""

import json

import pytest

from hil.cycle.fault_table import Fault
from tests.support.story_reference import FILE, SETS, STORIES, WIRES, story_hash, wire_hash

KNOWN = json.loads(FILE.read_text(encoding="utf-8"))


def test_no_story_is_another_and_all_are_known() -> None:
    assert list(KNOWN["rigs"]) == list(SETS)
    every = [*KNOWN["wires"], *(found for stories in KNOWN["rigs"].values() for found in stories)]
    assert len(set(every)) == len(every) == WIRES + STORIES * len(SETS)


@pytest.mark.parametrize("name", SETS)
def test_what_happens_on_a_rig_is_what_always_did(name: str) -> None:
    stories = [story_hash(name, number) for number in range(STORIES)]
    assert [found for found, _ in stories] == KNOWN["rigs"][name]
    assert len({fault for _, latched in stories for fault in latched} - {Fault.NONE.name}) >= 3


def test_what_happens_on_a_wire_is_what_always_did() -> None:
    assert [wire_hash(number) for number in range(WIRES)] == KNOWN["wires"]
