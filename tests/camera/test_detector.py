"""The detector against images that are drawn by other code: where things are is known, to a part of a pixel."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.camera.contract import Seen
from hil.camera.detector import Detector
from sim_plant.nodes.picture import Optics, Scene, picture
from tests.camera.scenes import FULL, drawn_scene

ABOVE = Scene((1e-3, 2e-3, 0.0), cell=(1.02e-3, 1.97e-3))


def off(number: int, detector: Detector) -> tuple[float, float]:
    """By how much tip and cell of a drawn scene are missed, px; inf where they are not seen."""
    optics, scene = drawn_scene(number)
    seen = detector.of(picture(optics, scene, number), 0)
    true = optics.cell(scene)
    assert true is not None
    return (
        math.dist(seen.tip, optics.tip(scene)) if seen.tip else math.inf,
        math.dist(seen.cell, true) if seen.cell else math.inf,
    )


def seen_of(optics: Optics, scene: Scene, detector: Detector | None = None) -> Seen:
    return (detector or Detector()).of(picture(optics, scene, 1), 0)


def test_tip_and_cell_are_found_between_pixels() -> None:
    detector = Detector()
    for number in (1, 2, 3):
        tip, cell = off(number, detector)
        assert tip < 1.5, number
        assert cell < 0.5, number


@pytest.mark.long
def test_in_95_of_100_images_both_are_within_a_pixel() -> None:
    detector = Detector()
    tips, cells = zip(*(off(1000 + number, detector) for number in range(60)), strict=True)
    print("px, median and 95 %: tip", np.percentile(tips, [50, 95]), "cell", np.percentile(cells, [50, 95]))
    assert np.percentile(tips, 95) < 1.0
    assert np.percentile(cells, 95) < 1.0


@pytest.mark.parametrize("shaft", [90.0, 180.0, -60.0])
def test_the_pipette_may_come_from_any_side(shaft: float) -> None:
    optics = Optics(shaft=math.radians(shaft + 5.0))
    seen = seen_of(optics, ABOVE, Detector(shaft=shaft))
    assert seen.tip is not None
    assert math.dist(seen.tip, optics.tip(ABOVE)) < 1.0


@pytest.mark.long
def test_a_broken_pipette_ends_elsewhere() -> None:
    whole, broken = (seen_of(Optics(), ABOVE._replace(missing=missing)) for missing in (0.0, 5e-4))
    assert whole.tip is not None
    assert broken.tip is not None
    assert broken.tip.column - whole.tip.column == pytest.approx(0.2 * 5e-4 / 2.5e-6, abs=1.0)


@pytest.mark.long
def test_a_bolus_and_a_dimple_are_told_apart_and_measured() -> None:
    empty, dented, full = (
        seen_of(Optics(), ABOVE._replace(dimple=dimple, bolus=bolus))
        for dimple, bolus in ((0.0, 0.0), (1.5e-4, 0.0), (0.0, 1.0))
    )
    assert (empty.dimple, empty.bolus) == (0.0, 0.0)
    assert dented.dimple == pytest.approx(1.5e-4 / 2.5e-6, rel=0.3)
    assert dented.bolus == 0.0
    assert full.bolus == pytest.approx(math.pi * (FULL / 2.5e-6) ** 2, rel=0.15)
    assert full.dimple == 0.0


@pytest.mark.long
def test_defocus_widens_the_edge_and_moves_nothing() -> None:
    sharp, soft = (Optics(blur=blur, noise=0.005) for blur in (0.8, 4.0))
    first, second = seen_of(sharp, ABOVE), seen_of(soft, ABOVE)
    assert first.tip is not None
    assert second.tip is not None
    assert math.dist(first.tip, second.tip) < 1.0
    assert first.tip_blur is not None
    assert second.tip_blur is not None
    assert second.tip_blur > 2.0 * first.tip_blur


def test_what_is_not_there_is_not_seen() -> None:
    nothing = np.random.default_rng(1).normal(150.0, 4.0, (480, 640))
    assert Detector().of(nothing, 0) == Seen()
    assert Detector().of(np.zeros((480, 640), np.uint8), 0) == Seen()
    alone = seen_of(Optics(), ABOVE._replace(cell=None))
    assert alone.cell is None
    assert alone.tip is not None
    beside = seen_of(replace(Optics(), centre=(1e-3 - 2e-3, 2e-3)), ABOVE._replace(cell=None))
    assert beside.tip is None


def test_two_images_of_one_scene_differ_by_noise_alone() -> None:
    first, again, other = (picture(Optics(), ABOVE, number) for number in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).mean() > 0.5


@pytest.mark.parametrize(
    ("parameters", "key"),
    [
        ({"shaft": math.nan}, "shaft"), ({"shaft": True}, "shaft"), ({"widest": 2.0}, "widest"),
        ({"radius": (0.4, 0.2)}, "radius"),
    ],
)  # fmt: skip
def test_a_parameter_that_cannot_be_is_refused_by_name(parameters: dict[str, float], key: str) -> None:
    with pytest.raises(ValueError, match=rf"camera.parameters.{key} = .*allowed"):
        Detector(**parameters)  # type: ignore[arg-type]
