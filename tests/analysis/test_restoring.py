"""A law that pushes a held axis the wrong way is found, however slowly it does; one that settles is not blamed."""

from pathlib import Path

import numpy as np
import pytest

from hil.analysis.restoring import pushes_away
from hil.analysis.stability import check_stability, refuse_unstable
from hil.rig.file import build_rig, load_rig
from hil.rig.schema import RigConfig, RigError
from tests.support.paths import RIGS

WITH_LAWS = Path(__file__).parent.parent / "long_runs"
LIMITS = {"position": [-0.3, 0.3], "speed": 1.0, "force": 1e3, "force_rate": 1e7, "following_error": 0.01}


def loop(name: str, mass: float = 1.0, coulomb: float = 0.5, rate_hz: float = 100.0, **gains: float) -> RigConfig:
    axis = {
        "encoder_resolution": 1e-7,
        "rated_force": 1e3,
        "limits": LIMITS,
        "model": {"mass": mass, "coulomb": coulomb},
    }
    law, drives = {"name": name, "gains": gains}, {"watchdog_s": 3.0 / rate_hz}
    return build_rig(
        {"name": "one", "rate_hz": rate_hz, "axes": {"x": axis}, "law": law, "drives": drives}, folder=WITH_LAWS
    )


@pytest.mark.requirement(id="SR-5.5")
@pytest.mark.long
@pytest.mark.parametrize("ki", [1e-5, 0.05])
def test_an_integrator_of_the_wrong_sign_is_refused_however_small_it_is(ki: float) -> None:
    rig = loop("./wrong_sign.py:WrongSign", kp=20.0, kd=5.0, ki=ki)
    assert pushes_away(rig).tolist() == [True]
    assert check_stability(rig).axes["x"].offset_s == np.inf
    with pytest.raises(RigError, match="does not hold axis 'x' at 100 Hz: after a push it does not come back"):
        refuse_unstable(rig)
    right = loop("pid", kp=20.0, kd=5.0, ki=ki)
    assert pushes_away(right).tolist() == [False]
    refuse_unstable(right)


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate_hz", "mass", "kp", "kd", "ki"),
    [
        (100.0, 0.0273, 46.6, 3.075, 4e-4),  # filter and law swing up while the axis is held
        (250.0, 0.1217, 1406.0, 23.25, 2.6e-4),
        (500.0, 11.62, 9143.0, 336.3, 1.87e-6),  # a pole at 1 + 4e-13: the held force changes by less than it rounds
    ],
)
def test_a_loop_that_creeps_away_under_a_push_is_found_where_a_held_axis_shows_nothing(
    rate_hz: float, mass: float, kp: float, kd: float, ki: float
) -> None:
    gains = {"mass": mass, "coulomb": 0.0, "rate_hz": rate_hz, "kp": kp, "kd": kd}
    assert pushes_away(loop("./wrong_sign.py:WrongSign", **gains, ki=ki)).tolist() == [True]
    assert pushes_away(loop("pid", **gains, ki=ki)).tolist() == [False]
    assert pushes_away(loop("pd-feedforward", **gains)).tolist() == [False]


@pytest.mark.parametrize("kp", [0.0, 1e-6, 1e-3, 0.05])
def test_an_axis_that_is_slow_to_go_where_it_is_pushed_does_not_creep(kp: float) -> None:
    assert pushes_away(loop("pd-feedforward", kp=kp, kd=5.0)).tolist() == [False]


@pytest.mark.long
@pytest.mark.parametrize("law", ["presliding-kalman", "structured-kalman", "pid"])
def test_no_law_of_the_flagship_is_blamed(law: str) -> None:
    assert not pushes_away(load_rig(RIGS / "microscope.toml", [f"law.name={law}"])).any()


@pytest.mark.long
def test_a_swing_that_takes_longer_than_the_answer_has_its_time_too() -> None:
    """sqrt(ki / kd) is 0.125 rad/s, and kp / (2 kd) the rate at which it fades: 4.6 of that to 1 %."""
    kp, kd = 0.0034414920760480663, 0.24637497876386236
    rig = loop("pid", 0.020708078713939152, 0.0, kp=kp, kd=kd, ki=0.0038393881312363256)
    axis = check_stability(rig).axes["x"]
    assert axis.offset_s == pytest.approx(9.2 * kd / kp, rel=0.2)
    assert not axis.stable
