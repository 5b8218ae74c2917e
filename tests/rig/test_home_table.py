"""[axes.NAME.home]: what is just allowed, and the first that is not."""

import math

import pytest

from hil.rig.home_table import MOST_WAY, HomeConfig
from hil.rig.schema import LimitsConfig

LIMITS = LimitsConfig(position=[-0.05, 0.05], speed=0.2, force=10.0, force_rate=1e4, following_error=1e-3)
WAY = MOST_WAY * 0.1


@pytest.mark.parametrize(("key", "most"), [("speed", 0.2), ("farthest", WAY), ("latch_speed", 0.1)])
def test_the_limit_itself_is_allowed(key: str, most: float) -> None:
    stated = {"farthest": 0.05, "speed": 0.1, "latch_speed": 0.001}
    assert HomeConfig.model_validate({"by": "switch", **stated, key: most}).problem(LIMITS, 0.0) == ""
    beyond = HomeConfig.model_validate({"by": "switch", **stated, key: math.nextafter(most, math.inf)})
    assert f"home.{key} = " in beyond.problem(LIMITS, 0.0)
