"""What a sound run is like, by axis and phase, and what a later run is told when it is beyond it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.events.accuracy import AccuracyWatch, Loss
from hil.events.baseline import BANDS_HZ, BEYOND, bands, baseline_of, known_of, phase_of
from tests.events.test_accuracy import COUNT, MODELS, PERIOD, TICKS, noise, show, sound, stuck, vibration

NAMES = ("x", "theta")
SECONDS: NDArray[np.float64] = np.arange(TICKS) * np.float64(1e-3)


def made(records: NDArray[np.void]) -> dict[str, dict[str, dict[str, Any]]]:
    return baseline_of(records, NAMES, MODELS, PERIOD * 1e-9)


def beyond(records: NDArray[np.void], baseline: dict[str, dict[str, dict[str, Any]]]) -> list[Loss]:
    return AccuracyWatch(MODELS, PERIOD, [known_of(baseline[name]) for name in NAMES]).take(records)


def test_phases_are_told_apart_by_the_set_point() -> None:
    assert phase_of(np.zeros(5)) == "rest"
    assert phase_of(np.array([0.0, 1.0, 2.0])) == "move"
    assert phase_of(np.array([1.0, 0.0, -1.0])) == "reversal"


def test_figures_of_each_phase_are_those_that_were_put_in() -> None:
    found = made(sound(noise=4.0))
    for name, model in zip(NAMES, MODELS, strict=True):
        assert set(found[name]) == {"rest", "move", "reversal"}
        rest, move = found[name]["rest"], found[name]["move"]
        assert rest["windows"] > 10
        assert rest["fast"][0] == pytest.approx(4.0 * COUNT, rel=0.15)
        assert rest["rms"][0] == pytest.approx((4.0**2 + 32.0**2 / 2) ** 0.5 * COUNT, rel=0.05)
        assert rest["force"][0] == pytest.approx(abs(model.gravity))
        assert rest["drag_up"] is None
        assert move["drag_up"][1] == pytest.approx(model.dry, abs=0.05 * model.dry)
        assert move["drag_down"][1] == pytest.approx(model.dry, abs=0.05 * model.dry)
        assert move["counts"][0] > 0.9


def test_a_spectrum_has_its_power_where_the_swing_is() -> None:
    seconds = np.arange(128) * 1e-3
    found = bands(3e-6 * np.sin(2 * np.pi * 100 * seconds), 1e-3)
    assert BANDS_HZ[int(np.argmax(found))] == 125.0
    assert max(found) == pytest.approx(3e-6 / 2**0.5, rel=0.05)


@pytest.mark.parametrize("seed", range(2, 8))
def test_another_sound_run_is_not_beyond_it(seed: int) -> None:
    assert not beyond(sound(seed=seed), made(sound(seed=1)))


@pytest.mark.parametrize("change", [noise, vibration])
def test_what_is_wrong_from_the_first_tick_on_is_told_by_a_baseline_alone(
    change: Callable[[NDArray[Any], int, NDArray[np.bool_], NDArray[np.float64]], None],
) -> None:
    records = sound(seed=2)
    change(records, 0, SECONDS >= 0.0, SECONDS)
    told = beyond(records, made(sound()))
    assert told[0].axis == 0
    assert told[0].at * 1e-3 <= 1.0 + 0.5, "within half a second of the first rest"
    assert told[0].signature == ("noise" if change is noise else "oscillation")
    assert not [loss for loss in told if loss.axis == 1]


def test_an_error_that_stands_off_is_a_bias_and_a_stuck_encoder_stays_one() -> None:
    records = sound(seed=2)
    show(records, 1, records["position"][:, 1] + 100 * COUNT)
    (first, *_) = beyond(records, made(sound()))
    assert (first.axis, first.signature) == (1, "bias")
    assert "against the baseline, nearly all of it its mean" in first.measured
    assert first.value > first.limit
    records = sound(seed=2)
    stuck(records, 1, SECONDS >= 6.3, SECONDS)
    assert beyond(records, made(sound()))[0].signature == "encoder stuck"


def test_few_windows_bound_less_than_many() -> None:
    row = {"windows": 2, "rms": [1.0, 2.0], "drag_up": None}
    assert known_of({"rest": row}) == {"rest": {"rms": 2.0 * (BEYOND + 2.0)}}
    assert known_of({"rest": row | {"windows": 4000}})["rest"]["rms"] == pytest.approx(2.0 * BEYOND, rel=1e-2)
