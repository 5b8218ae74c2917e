"""Goal moves at the rig's own limits, of stages that are off their model by what their tolerances allow."""

import numpy as np
import pytest

from tests.benchmarks.goal_moves import drawn_rig, moved


@pytest.mark.long
@pytest.mark.parametrize("number", [0, 5, 8])
def test_a_rigid_axis_keeps_to_its_fastest_moves(number: int) -> None:
    """Weights that took what a step of the force leaves for friction made the first stroke diverge."""
    error, ended = moved(drawn_rig(77, number, 0.0), {"x": 5e-3})
    assert ended == ""
    assert np.all(error < 20e-6), "the following error may be 500 um"
