"""Axes to identify, integrated here in small steps: no code of the emulated stage, none of the fits."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PERIOD, FINE = 1e-3, 20


Hung = tuple[float, float, float]  # a mass on a spring: Hz on the held motor, damping ratio, part of the mass


def _spring(mass: float, hertz: float, damping: float, part: float) -> tuple[float, float, float]:
    """kg, N/m, N s/m."""
    load, omega = part * mass, 2.0 * np.pi * hertz
    return load, load * omega * omega, 2.0 * damping * load * omega


class Bristle:
    """LuGre's friction with one bristle; coulomb N, length m."""

    def __init__(self, coulomb: float, length: float, damping: float = 0.0) -> None:
        self.coulomb, self.stiffness, self.damping, self.state = coulomb, coulomb / length, damping, 0.0

    def force(self, speed: float, step: float) -> float:
        rate = speed - abs(speed) * self.state * self.stiffness / self.coulomb
        self.state += rate * step
        return self.stiffness * self.state + self.damping * rate


class MaxwellSlip:
    """Elements that stick until their spring reaches their limit."""

    def __init__(self, limits: Array, stiffness: Array) -> None:
        self.limits, self.stiffness, self.force_of = limits, stiffness, np.zeros_like(limits)

    def force(self, speed: float, step: float) -> float:
        self.force_of = np.clip(self.force_of + self.stiffness * speed * step, -self.limits, self.limits)
        return float(self.force_of.sum())


class Coulomb:
    """The textbook's, smoothed over 0.1 mm/s."""

    def __init__(self, coulomb: float) -> None:
        self.coulomb = coulomb

    def force(self, speed: float, step: float) -> float:
        return self.coulomb * float(np.tanh(speed / 1e-4))


def record(
    friction: Bristle | MaxwellSlip | Coulomb,
    asked: Callable[[float, float, float], float],
    seconds: float,
    mass: float = 0.9,
    viscous: float = 3.0,
    constant: float = 0.0,
    count: float = 5e-9,
    *,
    hung: Sequence[Hung] = (),
) -> tuple[Array, Array]:
    """Force (N) and position (m) at 1 kHz, of an axis under asked(time, position, speed) N, held for each period."""
    x = v = 0.0
    motor = mass * (1.0 - sum(part for *_, part in hung))
    springs = [_spring(mass, *each) for each in hung]
    places, speeds = [0.0] * len(hung), [0.0] * len(hung)
    step = PERIOD / FINE
    forces, positions = [], []
    for k in range(round(seconds / PERIOD)):
        measured = round(x / count) * count
        u = asked(k * PERIOD, measured, v)
        forces.append(u)
        positions.append(measured)
        for _ in range(FINE):
            x += 0.5 * v * step  # half a drift, the forces, half a drift: springs take no damping from such steps
            places = [y + 0.5 * w * step for y, w in zip(places, speeds, strict=True)]
            pulls = [k * (y - x) + c * (w - v) for (_, k, c), y, w in zip(springs, places, speeds, strict=True)]
            v += (u - friction.force(v, step) - viscous * v - constant + sum(pulls)) / motor * step
            speeds = [w - pull / load * step for (load, *_), w, pull in zip(springs, speeds, pulls, strict=True)]
            places = [y + 0.5 * w * step for y, w in zip(places, speeds, strict=True)]
            x += 0.5 * v * step
    return np.array(forces), np.array(positions)
