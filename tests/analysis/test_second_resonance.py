"""A light second resonance swept over the loop: its verdict is that of a loop around such a stage, tick by tick."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from hil.analysis.flexible_plant import AxisDynamics
from hil.analysis.loop_corners import Corner, CornerTrial
from hil.analysis.pulse_loop import PulseLoop, responses
from hil.analysis.second_resonance import (
    DAMPING,
    LOADS,
    SecondResonance,
    _response,
    second_notes,
    second_resonances,
)
from hil.analysis.stability import check_stability, is_stable, realise_poles
from hil.control.nominal_model import rig_model
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS

Array = NDArray[np.float64]
AXIS = AxisDynamics(0.9, 1.9e-4, 196.0, 0.02, 0.3, 3.0)


class TwoMasses:
    """A hil.analysis.pulse_loop.Plant: the masses of an axis as columns of a state space, written independently."""

    def __init__(self, axes: list[AxisDynamics], load: float, hertz: float, period: float, rows: int) -> None:
        self.steps = [self.matrices(axis, load, hertz, period) for axis in axes]
        self.state = np.zeros((rows, len(axes), 7))

    @staticmethod
    def matrices(axis: AxisDynamics, load: float, hertz: float, period: float) -> Array:
        """[a b] of force, motor, rate, mass, rate, mass, rate."""
        parts = [(axis.mode_load if axis.mode_hz else 0.0, axis.mode_hz, axis.mode_damping), (load, hertz, DAMPING)]
        motor = axis.mass * (1.0 - sum(part for part, _, _ in parts))
        a = np.zeros((8, 8))
        if axis.lag:
            a[0, 0], a[0, 7], a[2, 0] = -1.0 / axis.lag, 1.0 / axis.lag, 1.0 / motor
        else:
            a[2, 7] = 1.0 / motor
        a[1, 2], a[2, 2] = 1.0, -axis.viscous / motor
        for at, (part, frequency, damping) in zip((3, 5), parts, strict=True):
            spring = np.zeros(8)
            omega = 2.0 * math.pi * frequency
            spring[[1, 2, at, at + 1]] = omega**2, 2.0 * damping * omega, -(omega**2), -2.0 * damping * omega
            a[at, at + 1] = 1.0
            a[at + 1] += spring
            a[2] -= part * axis.mass / motor * spring
        whole: Array = expm(a * period)
        return whole[:7]

    @property
    def error(self) -> Array:
        found: Array = self.state[..., 1]
        return found

    @property
    def rate(self) -> Array:
        found: Array = self.state[..., 2]
        return found

    def advance(self, force: Array) -> None:
        for at, step in enumerate(self.steps):
            self.state[:, at] = self.state[:, at] @ step[:, :7].T + force[:, at, None] * step[:, 7]

    def place(self, error: Array, rate: Array) -> None:
        self.state[:] = 0.0
        self.state[..., 1::2], self.state[..., 2::2] = error[..., None], rate[..., None]


def found_of(rig: RigConfig) -> list[SecondResonance]:
    trial = CornerTrial(rig)
    check_stability(rig, beside=[trial])
    return second_resonances(trial)


def rings(rig: RigConfig, load: float, hertz: float) -> list[bool]:
    """Of each axis, by the loop itself."""
    loop = PulseLoop(rig, rig_model(rig))
    axes = [Corner().dynamics(axis.model) for axis in rig.axes.values()]
    plant: Any = TwoMasses([axis for axis in axes if axis], load, hertz, loop.period, loop.shape[0])
    _, motion = responses(loop, plant, 4000)
    return [not is_stable(column, realise_poles(column[:240])) for column in motion[:, 0].T]


@pytest.mark.parametrize(
    "axis", [AXIS, AXIS._replace(mode_hz=0.0, lag=0.0), AXIS._replace(stiffness=1e5, damping=40.0)]
)
def test_without_the_second_mass_the_response_is_that_of_the_axis(axis: AxisDynamics) -> None:
    frequency = np.geomspace(2.0, 495.0, 300)
    exact = axis.response(2.0 * np.pi * frequency, 1e-3)
    off = np.abs(_response(axis, frequency, 1e-3) / exact - 1.0)
    assert off.max() < 0.05, "images of the frequency are left out"
    assert off[frequency < 300.0].max() < 0.01


def test_with_it_the_response_is_that_of_three_masses() -> None:
    frequency = np.geomspace(2.0, 300.0, 400)
    step = TwoMasses.matrices(AXIS, 0.05, 140.0, 1e-3)
    z = np.exp(2j * np.pi * frequency * 1e-3)
    exact = np.array([np.linalg.solve(one * np.eye(7) - step[:, :7], step[:, 7])[1] for one in z])
    assert np.abs(_response(AXIS, frequency, 1e-3, 0.05, 140.0) / exact - 1.0).max() < 0.02


@pytest.mark.long
def test_a_loop_that_rings_is_told_with_the_frequencies_at_which_it_does() -> None:
    rig = load_rig(RIGS / "paper.toml")
    found = {(one.axis, one.load): one for one in found_of(rig)}
    assert set(found) == {(axis, load) for axis in rig.axes for load in LOADS}
    for axis in rig.axes:
        assert found[axis, LOADS[0]].unstable_hz is None
        assert 0.3 < found[axis, LOADS[0]].gain_db < 1.5
    worst = found["x", LOADS[1]].unstable_hz
    assert worst is not None
    low, high = worst
    assert all(rings(rig, LOADS[1], hertz)[0] for hertz in (low, 0.5 * (low + high), high))
    assert not any(rings(rig, LOADS[1], hertz)[0] for hertz in (0.9 * low, 1.1 * high))
    assert not any(rings(rig, LOADS[0], hertz)[0] for hertz in (low, found["x", LOADS[0]].frequency_hz, high))
    notes = second_notes(list(found.values()))
    assert len(notes) == 2 * len(rig.axes)
    assert (
        f"with 5% of its mass on another spring: the loop rings at a resonance of {low:.0f} to {high:.0f} Hz"
        in notes[1]
    )


@pytest.mark.long
def test_a_flexible_axis_is_tried_sliding_and_at_rest() -> None:
    rig = load_rig(RIGS / "microscope.toml")
    found = [one for one in found_of(rig) if one.axis == "x"]
    assert {(one.at_rest, one.load) for one in found} == {(rest, load) for rest in (False, True) for load in LOADS}
    [heavy] = [one for one in found if one.load == LOADS[1] and not one.at_rest]
    assert heavy.unstable_hz is None
    assert 0.0 < heavy.gain_db < 1.5
    assert not any(rings(rig, LOADS[1], heavy.frequency_hz))
    assert any(rings(rig, 1.6 * LOADS[1], heavy.frequency_hz)), "where the margin is gone"
    assert heavy.as_json()["unstable_hz"] is None
    [note] = second_notes(found)
    assert note == heavy.text()
