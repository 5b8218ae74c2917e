"""Does the law push an axis back that is held off its setpoint, for as long as it is held?

Integrators put real poles near 1 into a loop, too slow for any answer that is short enough to compute. An axis that is
held shows them at once. The force of an integrator with the wrong sign goes the wrong way, tick by tick. The loop then
has a pole beyond 1, however small the gain is, as its characteristic polynomial is negative at z = 1.
Source: Astrom and Wittenmark, Computer-Controlled Systems (1997), section 3.3.
"""

from typing import Any

import numpy as np

from hil.analysis.pulse_loop import PULSE, SETTLE, PulseLoop
from hil.control.laws.base import Array
from hil.control.nominal_model import rig_model
from hil.rig.schema import RigConfig

HELD = 1200  # ticks
STEADY = 0.1  # of the trend: what changes by more is a filter that settles, while an integrator goes on and on
ROUNDING = 1e-9  # of the force that pushes back


class HeldPlant:
    """Axes that follow the reference at a constant distance, whatever the force is."""

    def __init__(self, shape: tuple[int, ...], offset: Array) -> None:
        self.error, self.rate, self._offset = np.zeros(shape), np.zeros(shape), offset

    def advance(self, force: Array) -> None:
        """Nothing moves."""

    def place(self, error: Array, rate: Array) -> None:
        """Held from there on, an offset further."""
        self.error, self.rate = error + self._offset, np.zeros_like(rate)


def pushes_away(rig: RigConfig) -> Any:
    """Which axes' force turns against them, steadily, while they are held PULSE off their setpoint: bool, (n_axes,)."""
    loop = PulseLoop(rig, rig_model(rig))
    quiet, force = np.zeros(loop.shape), np.zeros((HELD, len(rig.axes)))
    with np.errstate(all="ignore"):
        for _ in range(SETTLE):
            loop.step(quiet)
        loop.change_plant(HeldPlant(loop.shape, loop.pulse()))
        for tick in range(HELD):
            loop.step(quiet)
            force[tick] = loop.beyond(loop.force)[0]
        before, after = force[HELD * 3 // 4] - force[HELD // 2], force[-1] - force[HELD * 3 // 4]
        shown = ROUNDING * np.abs(force[-1]) + 100.0 * np.finfo(float).eps * np.abs(loop.force).max() / PULSE
        return (after > shown) & (np.abs(after - before) <= STEADY * after)
