"""What happens in stories of faults and orders on a rig, and of nodes on a wire, is what always did, to a byte
(tests/golden/stories, tests/golden/wires).
"""

import pytest

from hil.cycle.record import RECORD
from sim_plant.scenario.language import KINDS
from tests.golden.golden import hold
from tests.golden.stories import tell as rigs
from tests.golden.wires import tell as wires


def test_stories_name_every_kind_of_fault_there_was_when_they_were_drawn_and_none_that_is_not() -> None:
    named = {kind for story in rigs.stories() for kind in story.partition(": ")[2].split(", ")}
    assert named <= set(KINDS)
    assert len(named) >= 55
    assert set(rigs.FIELDS) <= set(RECORD.names or ())


LONG = ("microscope classic", "paper heartbeat")  # the stories of the other two on other rigs


@pytest.mark.parametrize(
    "base", [pytest.param(base, marks=pytest.mark.long) if base in LONG else base for base in rigs.RIGS_OF_STORIES]
)
def test_what_happens_on_a_rig_is_what_always_did(base: str) -> None:
    latched = set()
    for story in [story for story in rigs.stories() if story.startswith(f"{base}: ")]:
        lines, faults = rigs.tell_and_latched(story)
        hold("stories", story, lines)
        latched |= faults
    assert len(latched) >= 3


@pytest.mark.parametrize("story", wires.stories())
def test_what_happens_on_a_wire_is_what_always_did(story: str) -> None:
    hold("wires", story)
