"""A stage whose axes each carry two masses on springs, for what a law does on a resonance that no model knows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from hil import Plant

Array = NDArray[np.float64]
PIECE_S = 250e-6  # over which force and friction are held
CREEP = 1e-3  # m/s, over which the friction turns


class TwoResonances(Plant):
    """Of the first axis; the others are rigid. frequencies: Hz, at which each mass rings on the held motor. loads: of
    the moving mass, parts. sign: of its force; -1 is a drive that pushes the wrong way.
    """

    def __init__(
        self,
        truth: Any,
        frequencies: tuple[float, float] = (150.0, 300.0),
        loads: tuple[float, float] = (0.2, 0.1),
        damping: float = 0.01,
        sign: float = 1.0,
    ) -> None:
        super().__init__(truth)
        self._sign = np.where(np.arange(len(truth.mass)) == 0, sign, 1.0)
        omega, load = 2.0 * np.pi * np.asarray(frequencies), np.asarray(loads)
        motor = 1.0 - load.sum()
        whole = np.zeros((7, 7))  # motor, two masses: position and rate in turn; and the motor's force over the mass
        whole[1, 6] = 1.0 / motor
        for place in range(3):
            whole[2 * place, 2 * place + 1] = 1.0
        for place, (w, part) in enumerate(zip(omega, load, strict=True), 1):
            row = np.zeros(7)
            row[[0, 2 * place, 1, 2 * place + 1]] = w * w, -w * w, 2.0 * damping * w, -2.0 * damping * w
            whole[2 * place + 1] += row
            whole[1] -= part / motor * row
        self._step_of = expm(whole * PIECE_S)[:6]
        self._state = np.zeros(6)

    def begin(self, position: Array) -> None:
        super().begin(position)
        self._state[::2] = position[0]

    def acceleration(self, position: Array, velocity: Array, force: Array) -> Array:
        t = self.truth
        friction = t.coulomb * np.tanh(velocity / CREEP) + t.viscous * velocity
        found: Array = (self._sign * force + t.gravity - friction) / t.mass
        return found

    def advance(self, seconds: float, force: Array, held: Array) -> None:
        pieces = round(seconds / PIECE_S)
        for _ in range(pieces):
            pushed = self.acceleration(self.position, self.velocity, force)[0]
            super().advance(PIECE_S, force, held)
            self._state = self._step_of @ np.append(self._state, pushed)
            self.position[0], self.velocity[0] = self._state[:2]
