"""10^5 random and mutated frames: nothing raises, nothing invalid passes, every refusal is counted under its reason."""

import pytest

from tests.support.fuzz_frames import PROTOCOLS, fuzz

NEVER_THERE = {
    # Feedback without a reserved value has no invalid one; CANopen has neither checksum nor
    # sequence, so nothing tells a repeated answer from a late one: the newest wins.
    "stage_fd": {"SERVICE"},
    "stage_classic": {"INVALID_VALUE", "SERVICE"},
    "cia402": {"BAD_CHECKSUM", "STALE", "DUPLICATE"},
    "dbc:example_drive.dbc": {"INVALID_VALUE", "SERVICE"},
}


@pytest.mark.long
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_no_frame_gets_further_than_it_may(protocol: str) -> None:
    outcome = fuzz(protocol, 25_000, seed=1)
    assert outcome["frames"] == 25_000
    assert outcome["samples"] > 500  # the fuzzing reached the good path too
    missing = {name for name, number in outcome.items() if number == 0}
    assert missing == NEVER_THERE[protocol]
