"""When an image was exposed, and whether it is new: cameras with and without a clock, with jitter, that repeat."""

from random import Random

import numpy as np
import pytest

from hil.camera.clock import Exposures
from hil.camera.contract import Image

MS = 1_000_000
LATENCY = 50 * MS


def image(number: int, stamp_ns: int, arrived_ns: int, shade: int | None = None) -> Image:
    pixels = np.full((16, 16), number % 251 if shade is None else shade, np.uint8)
    return Image(pixels, number, stamp_ns, arrived_ns)


def test_without_a_stamp_the_arrival_counts() -> None:
    assert Exposures(LATENCY).of(image(1, -1, 900 * MS)) == 850 * MS


def test_a_cameras_own_clock_takes_the_jitter_of_arrival_away() -> None:
    draw, exposures, offset = Random(1), Exposures(LATENCY), 77_000 * MS
    errors = []
    for number in range(300):
        exposed_ns = 1000 * MS + number * 33 * MS
        arrived_ns = exposed_ns + LATENCY + (0 if number == 20 else draw.randrange(1 * MS, 20 * MS))
        told = exposures.of(image(number, exposed_ns + offset, arrived_ns))
        assert told is not None
        errors.append(told - exposed_ns)
    assert max(errors[:20]) >= 1 * MS  # not learnt yet
    assert all(0 <= error < 1.1 * MS for error in errors[20:])


def test_clocks_that_drift_are_followed() -> None:
    exposures = Exposures(0)
    for number in range(20_000):
        exposed_ns = number * 33 * MS
        told = exposures.of(image(number, round(exposed_ns * (1.0 - 50e-6)), exposed_ns, shade=number % 2))
    assert told is not None
    assert abs(told - exposed_ns) < 0.1 * MS


def test_no_image_is_told_before_it_arrived_nor_later() -> None:
    exposures, draw = Exposures(LATENCY), Random(2)
    for number in range(500):
        arrived_ns = 1000 * MS + number * 33 * MS + draw.randrange(30 * MS)
        told = exposures.of(image(number, 5 * MS + number * 33 * MS, arrived_ns))
        assert told is not None
        assert told <= arrived_ns - LATENCY


@pytest.mark.parametrize(
    "again",
    [
        image(5, 1000 * MS, 1100 * MS),  # the same once more
        image(4, 990 * MS, 1100 * MS, shade=99),  # an older one
        image(5, 1033 * MS, 1100 * MS, shade=99),  # the same number with other pixels
        image(6, 1000 * MS, 1100 * MS, shade=99),  # the same stamp
        image(6, 1033 * MS, 1100 * MS, shade=5),  # all is new but the pixels
        image(-1, -1, 1100 * MS, shade=5),
    ],
)
def test_an_image_that_was_there_before_is_never_told_as_new(again: Image) -> None:
    exposures = Exposures(LATENCY)
    assert exposures.of(image(5, 1000 * MS, 1050 * MS)) == 1000 * MS
    assert exposures.of(again) is None
    assert exposures.old == 1
    assert exposures.of(image(7, 1066 * MS, 1116 * MS)) is not None


def test_a_camera_that_begins_anew_is_believed_after_eight_images() -> None:
    exposures = Exposures(0)
    exposures.of(image(1000, 90_000 * MS, 90_000 * MS))
    told = [exposures.of(image(number, number * 33 * MS, 91_000 * MS + number * 33 * MS)) for number in range(1, 12)]
    assert told[:7] == [None] * 7
    assert told[7:] == [91_000 * MS + number * 33 * MS for number in range(8, 12)]
