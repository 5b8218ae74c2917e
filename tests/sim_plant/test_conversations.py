"""What the emulated drives say and do in long conversations has not changed, bit by bit (tests/golden/drives)."""

import pytest

from drivers.protocols.base import DriveStatus
from tests.golden.drives.tell import lines, pieces, statuses, stories
from tests.golden.golden import hold


@pytest.mark.long
@pytest.mark.parametrize("name", stories())
def test_a_drive_says_and_does_what_it_always_did(name: str) -> None:
    told = pieces(name)
    status = [bits for piece in told for bits in statuses(piece)]
    worked = sum(bool(bits & DriveStatus.ENABLED) for bits in status)
    failed = sum(bool(bits & (DriveStatus.FAULT | DriveStatus.WATCHDOG)) for bits in status)
    assert min(worked, failed) >= 50, "a conversation that says nothing of operation or of faults"
    hold("drives", name, lines(told))
