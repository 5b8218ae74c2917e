"""Does the law push an axis back that is held off its setpoint, for as long as it is held?

Integrators put real poles near 1 into a loop, too slow for any answer that is short enough to compute. An axis that is
held shows them at once. The force of an integrator with the wrong sign goes the wrong way, tick by tick. The loop then
has a pole beyond 1, however small the gain is, as its characteristic polynomial is negative at z = 1.

Some filters and laws swing up by themselves while the axis is held, although the loop is stable. Then the loop stays
closed and a constant force pushes the axis. It goes to where the law's stiffness balances the push. An integrator of
the wrong sign lets it creep on from there, away, by equal steps.
Source: Astrom and Wittenmark, Computer-Controlled Systems (1997), section 3.3.
"""

from typing import Any

import numpy as np

from hil.analysis.pulse_loop import (
    CRUISE,
    PULSE,
    SETTLE,
    Plant,
    PlantAround,
    PulseLoop,
    loop_of,
    nominal_plant,
    try_together,
)
from hil.control.laws.base import Array
from hil.control.nominal_model import rig_model
from hil.rig.schema import RigConfig

HELD = 1200  # ticks
STEADY = 0.1  # of the trend: what changes by more is a filter that settles, while an integrator goes on and on
ROUNDING = 1e-9  # of the force that pushes back
BLOCK = 150  # ticks in which an axis is pushed; the averages of blocks are compared
FEWEST, MOST_BLOCKS = 8, 40
CREEPING = 4  # steps, from one mean to the next, that are alike
ALIKE = 0.3  # of the largest of them
LEAST, MOST = 1e-11, 1e-2  # a step of the distance gone: below it is rounding, above it the axis is still on its way


class HeldPlant:
    """Axes that follow the reference at a constant distance, whatever the force is."""

    def __init__(self, shape: tuple[int, ...], offset: Array) -> None:
        self.error, self.rate, self._offset = np.zeros(shape), np.zeros(shape), offset

    def advance(self, force: Array) -> None:
        """Nothing moves."""

    def place(self, error: Array, rate: Array) -> None:
        """Held from there on, an offset further."""
        self.error, self.rate = error + self._offset, np.zeros_like(rate)


class PushedPlant(PlantAround):
    """A plant under a constant force beside the law's, N, (rows, n_axes)."""

    def __init__(self, plant: Plant, push: Array) -> None:
        super().__init__(plant)
        self._push = push

    def advance(self, force: Array) -> None:
        """On by one period."""
        super().advance(force + self._push)


class Held:
    """A trial (hil.analysis.pulse_loop.Trial): every axis is held PULSE off its setpoint. `away`: whose force turns
    against them, steadily; `back`: whose force turns back, steadily; bool, (n_axes,) each.
    """

    copies = 1

    def __init__(self) -> None:
        self.speed: Array = np.full(1, CRUISE)
        self.away: Any = None
        self.back: Any = None

    def begin(self, pulse: Array, period: float) -> tuple[Plant, Array]:
        """See Trial."""
        self._force = np.zeros((HELD, pulse.shape[1]))
        return HeldPlant(pulse.shape, pulse), np.zeros(pulse.shape)

    def note(self, tick: int, loop: PulseLoop, errors: Array, own: slice) -> bool:
        """See Trial."""
        force = self._force
        force[tick] = loop.beyond(loop.force)[own][0]
        if tick + 1 < HELD:
            return False
        before, after = force[HELD * 3 // 4] - force[HELD // 2], force[-1] - force[HELD * 3 // 4]
        greatest = np.abs(loop.rows(loop.force, own)).max()
        shown = ROUNDING * np.abs(force[-1]) + 100.0 * np.finfo(float).eps * greatest / PULSE
        steady = np.abs(after - before) <= STEADY * np.abs(after)
        self.away, self.back = (after > shown) & steady, (after < -shown) & steady
        return True

    def verdict(self, rig: RigConfig) -> Any:
        """Which axes the law lets go or turns against, steadily and however slowly, after the trial: bool, (n_axes,).
        Axes of which holding shows nothing are pushed.
        """
        if np.all(self.away | self.back):
            return self.away
        return self.away | (_creeps(rig) & ~self.back)


def pushes_away(rig: RigConfig) -> Any:
    """Held.verdict of a rig's loop, tried alone."""
    held = Held()
    try_together(loop_of(rig, [held]), [held])
    return held.verdict(rig)


def _creeps(rig: RigConfig) -> Any:
    """Which axes creep away under a constant push: bool, (n_axes,)."""
    model = rig_model(rig)
    loop, averages = PulseLoop(rig, model), []
    quiet, plant = np.zeros(loop.shape), nominal_plant(model, loop.period, loop.shape)
    creeps = np.zeros(len(rig.axes), dtype=bool)
    with np.errstate(all="ignore"):
        for _ in range(SETTLE):
            loop.step(quiet)
        loop.change_plant(PushedPlant(plant, loop.pulse() * model.mass / loop.period**2))
        for _ in range(MOST_BLOCKS):
            averages.append(np.mean([loop.beyond(loop.step(quiet))[0] for _ in range(BLOCK)], axis=0))
            if len(averages) < FEWEST:
                continue
            steps = np.diff(averages[-CREEPING - 1 :], axis=0) / np.abs(averages[-1])
            alike = np.ptp(steps, axis=0) <= ALIKE * np.abs(steps).max(axis=0)
            creeps = alike & np.all((steps > LEAST) & (steps < MOST), axis=0)
            rests = ~(np.abs(steps).max(axis=0) > LEAST)  # also where it is not finite
            if np.all(rests | alike):
                break
    return creeps
