"""What is written to a drive, in which order, and what refuses it, in full, for drives that differ in one thing each
(tests/golden/plans).
"""

import pytest

from drivers.eds.reader import Entry
from drivers.families.cia402.drive_plan import FULL_SCALE
from drivers.families.cia402.profile import rated_torque
from tests.golden.golden import hold
from tests.golden.plans.tell import stories


@pytest.mark.parametrize("story", stories())
def test_a_drive_is_told_what_it_always_was(story: str) -> None:
    hold("plans", story)


@pytest.mark.parametrize(("data_type", "size"), [(2, 1), (5, 1), (3, 2), (6, 2), (4, 4), (7, 4), (9, 0)])
def test_an_object_holds_the_numbers_of_its_size(data_type: int, size: int) -> None:
    """CiA 301, table 44; 9 is a string."""
    entry = Entry("object", data_type, "rw", None, None, None, mappable=False)
    least, most = -(256**size // 2), 256**size - 1
    assert [entry.holds(value) for value in (least - 1, least, most, most + 1)] == [False, size > 0, size > 0, False]


@pytest.mark.parametrize("rated_force", [1e-9, 0.032767, 0.0327671, 0.5, 3.0, 32.767, 1000.0])
def test_a_rated_force_is_said_in_the_finest_unit_that_can_say_it(rated_force: float) -> None:
    unit, most = rated_torque(rated_force)
    assert 1 <= most <= FULL_SCALE or rated_force < 1e-6
    assert most * unit <= rated_force * 1e6 < (most + 1) * unit or most == FULL_SCALE
    assert unit == 1 or rated_force * 1e6 / (unit - 1) > FULL_SCALE, "a finer unit could not say it"
