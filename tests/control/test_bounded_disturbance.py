"""The disturbance that an observer compensates stays within the force limit, whichever way an axis is held."""

import dataclasses

import numpy as np
import pytest

from hil.control.laws.base import Model, axis_inputs
from hil.control.laws.disturbance_observer import DisturbanceObserver
from tests.control.test_laws import PERIOD, model

LIMIT = 5.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_axis_held_far_from_its_setpoint_winds_nothing_up(sign: float) -> None:
    arrays = model()
    of_x = {field.name: float(np.ravel(getattr(arrays, field.name))[0]) for field in dataclasses.fields(Model)}
    law = DisturbanceObserver(Model(**of_x), PERIOD, LIMIT)
    x = axis_inputs()
    x.fresh, x.sample_interval, x.ahead = 1.0, PERIOD, PERIOD
    law.reset(0.0, of_x["gravity"])
    reached = []
    for _ in range(3000):
        x.position = sign * 0.05
        law.force(x)
        reached.append(law._disturbance)
    assert max(abs(value) for value in reached) == LIMIT
    assert {value for value in reached if abs(value) == LIMIT} <= {LIMIT, -LIMIT}
    assert sign * LIMIT in reached
