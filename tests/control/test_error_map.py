"""The correction of an encoder's scale: along lines, the same bits for one number and for many, refused where wrong."""

import numpy as np
import pytest

from hil.control.error_map import ErrorMap
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from tests.support.batch_equality import assert_batch_is_single
from tests.support.paths import RIGS

PLACES, CORRECTIONS = [-0.02, 0.0, 0.01], [1e-6, 0.0, -5e-7]
ON_X = f"axes.x.error_map={{position={PLACES}, correction={CORRECTIONS}}}"


def test_it_follows_straight_lines_and_keeps_the_ends_values_beyond() -> None:
    of = ErrorMap(PLACES, CORRECTIONS)
    for place, correction in ((-1.0, 1e-6), (-0.02, 1e-6), (-0.01, 5e-7), (0.0, 0.0), (0.005, -2.5e-7), (0.3, -5e-7)):
        assert of.corrected(place) - place == pytest.approx(correction, abs=1e-15)


def test_many_positions_get_the_bits_of_each() -> None:
    of = ErrorMap(PLACES, CORRECTIONS)
    positions = np.random.default_rng(4).uniform(-0.03, 0.03, 1000)
    assert of.corrected_array(positions).tolist() == [of.corrected(place) for place in positions.tolist()]


def test_a_batch_corrects_as_the_cycle_does() -> None:
    sets = [
        "wire.stuffing=worst",
        ON_X,
        "plant.initial_position=[0.004,0]",
        "axes.x.encoder_resolution=1e-7",
        "plant.encoder_resolution=[1.0002e-7,1e-7]",
    ]
    assert_batch_is_single(load_rig(RIGS / "paper.toml", sets), RIGS)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("{position=[0.0,1e-3], correction=[0.0]}", "correction"),
        ("{position=[1e-3,0.0], correction=[0.0,0.0]}", "each above the one before"),
        ("{position=[0.0,1e-3], correction=[0.0,2e-5]}", "allowed: 1% of the way"),
    ],
)
def test_what_no_scale_does_is_refused(table: str, says: str) -> None:
    with pytest.raises(RigError, match=says):
        load_rig(RIGS / "microscope-ideal.toml", [f"axes.x.error_map={table}"])
