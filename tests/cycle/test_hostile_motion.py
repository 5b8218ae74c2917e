"""Hostile references from a motion: a few thousand here, by the million in tests/benchmarks/hostile_motion.py."""

import pytest

from hil.control.plans.axis_plan import MotionLimits
from tests.benchmarks import hostile_motion
from tests.benchmarks.hostile_motion import RIGS, Trial

RIG = RIGS / "microscope.toml"


@pytest.mark.requirement(id="SR-4.2")
def test_thousands_of_hostile_answers_break_no_limit_and_each_that_is_none_ends_at_rest() -> None:
    trial = Trial(RIG, seed=7)
    trial.run(1000)
    assert trial.limited > 900
    assert trial.rests == trial.hostile.useless >= 1


@pytest.mark.parametrize("key", ["speed", "acceleration", "jerk", "fence"])
def test_limits_that_are_a_hundredth_tighter_are_seen_to_be_broken(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = hostile_motion.motion_limits

    def tighter(rig: hostile_motion.RigConfig) -> list[MotionLimits]:
        share = {name: 0.99 if name == key else 1.0 for name in ("speed", "acceleration", "jerk", "fence")}
        return [
            MotionLimits(
                li.speed * share["speed"], li.acceleration * share["acceleration"], li.jerk * share["jerk"],
                li.low * share["fence"], li.high * share["fence"],
            )
            for li in honest(rig)
        ]  # fmt: skip

    monkeypatch.setattr(hostile_motion, "motion_limits", tighter)
    trial = Trial(RIG, seed=7)
    with pytest.raises(AssertionError, match=r"above|outside"):
        trial.run(1000)
