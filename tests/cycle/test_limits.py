"""What the detectors hold an axis against, from its keys in the rig file."""

from hil.cycle.limits import axis_limits
from hil.rig.file import load_rig
from tests.support.paths import RIGS


def test_the_thresholds_are_those_of_the_rig_file() -> None:
    rig = load_rig(
        RIGS / "paper.toml",
        ["axes.x.limits.position=[-0.5, 0.25]", "axes.x.limits.speed=2.0", "axes.x.limits.following_error=0.01",
         "axes.x.limits.force=4.0", "axes.x.model.mass=0.5", "axes.x.encoder_resolution=1e-5",
         "axes.y.limits.oscillation=3e-3", "safety.jump_margin=4.0", "safety.stuck_force_fraction=0.25"],
    )  # fmt: skip
    x, y = axis_limits(rig)
    assert (x.position_low, x.position_high, x.speed, x.following_error, x.force) == (-0.5, 0.25, 2.0, 0.01, 4.0)
    assert x.jump_step == 4.0 * 2.0 * 1e-3 + 2.0 * 1e-5, "four times what the speed limit covers in a tick, two counts"
    assert (x.stuck_force, x.braking) == (1.0, 4.0), "a quarter of the force; half of it brakes the mass"
    assert (x.oscillation, y.oscillation) == (0.1 * 0.01, 3e-3), "a tenth of the following error where none is stated"
