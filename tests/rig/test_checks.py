"""What a rig is told before anything runs, of its bus, its loop and its task, has not changed (tests/golden/checks)."""

import pytest

from tests.golden.checks.tell import stories
from tests.golden.golden import hold


@pytest.mark.long
@pytest.mark.parametrize("story", stories())
def test_a_rig_is_told_what_it_always_was(story: str) -> None:
    hold("checks", story)
