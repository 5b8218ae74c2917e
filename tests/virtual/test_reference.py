"""What runs do has not changed (tests/golden/traces, tests/golden/campaigns): a few in every test run, all of them in
the slow lane.
"""

import pytest

from tests.golden.campaigns import tell as campaigns
from tests.golden.golden import hold
from tests.golden.traces.tell import stories

EVERY_TIME = ("microscope-ideal, structured-kalman", "paper, robust-pd", "paper, pd-feedforward, learning")


@pytest.mark.long
@pytest.mark.parametrize("name", EVERY_TIME)
def test_a_run_sends_and_receives_the_frames_it_always_did(name: str) -> None:
    hold("traces", name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in stories() if name not in EVERY_TIME])
def test_every_law_sends_and_receives_the_frames_it_always_did(name: str) -> None:
    hold("traces", name)


@pytest.mark.slow
@pytest.mark.parametrize("rig", campaigns.stories())
def test_every_cell_of_the_fault_campaign_is_as_it_was(rig: str) -> None:
    hold("campaigns", rig)
