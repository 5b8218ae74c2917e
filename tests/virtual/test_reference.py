"""What runs do has not changed: the hashes of tests/reference/trace_hashes.json, a few in every test run, all of them
in the slow lane. Where a change is meant, `python -m tests.support.reference` renews the file (traces or campaigns: a
half of it).
"""

import pytest

from tests.support.reference import CAMPAIGNS, campaign, known, runs, trace_hash

EVERY_TIME = ("microscope-ideal, structured-kalman", "paper, robust-pd", "paper, pd-feedforward, learning")


def test_there_is_a_hash_for_every_law_on_both_rigs() -> None:
    assert set(known()["traces"]) == set(runs()), "python -m tests.support.reference traces"
    assert set(EVERY_TIME) <= set(runs())
    assert len(set(known()["traces"].values())) == len(runs())


@pytest.mark.parametrize("name", EVERY_TIME)
def test_a_run_sends_and_receives_the_frames_it_always_did(name: str) -> None:
    assert trace_hash(*runs()[name]) == known()["traces"][name]


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in runs() if name not in EVERY_TIME])
def test_every_law_sends_and_receives_the_frames_it_always_did(name: str) -> None:
    assert trace_hash(*runs()[name]) == known()["traces"][name]


@pytest.mark.slow
@pytest.mark.parametrize("rig", CAMPAIGNS)
def test_every_cell_of_the_fault_campaign_is_as_it_was(rig: str) -> None:
    assert campaign(rig) == known()["campaigns"][rig]
