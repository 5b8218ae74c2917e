"""What the emulated plant does with any two of its effects: the same script of forces on all of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth
from tests.golden.golden import sha256

MS = 1_000_000
EFFECTS: dict[str, Any] = {
    "presliding": [1e-6, 1e-5],
    "torque_lag": [3e-4, 1e-4],
    "torque_noise": [1e-3, 0.0],
    "modes": [{"axis": "x", "frequency_hz": 200.0, "load": 0.3}],
    "friction_variation": [0.1, 0.3],
    "cogging": [{"amplitude": 0.02, "period": 0.024}, {"axis": "y", "amplitude": 0.01, "period": 0.004, "phase": 1.0}],
    "cable_stiffness": [0.1, 5.0],
    "cable_hysteresis": [0.05, 0.0],
    "bias": [0.1, -0.2],
    "bias_walk": [0.05, 0.1],
    "vibration": [{"axis": "x", "acceleration": 0.05, "frequency_hz": 31.0}],
    "backlash": [1e-6, 0.0],
    "drift": [1e-7, 0.0],
    "encoder_noise": [5e-9, 1e-9],
    "encoder_periodic_error": [2e-8, 0.0],
    "encoder_latency": [2e-5, 7e-4],
    "stribeck_scale": [0.1, 0.2],
    "ripple_amplitude": [0.03, 0.0],
    "gravity": [0.0, -0.4],
    "cells": [{"axis": "x", "surface": 2e-6, "direction": 1, "stiffness": 1e14, "puncture_depth": 1e-5, "drag": 2.0}],
}


def plant_with(*effects: str) -> PlantConfig:
    base: dict[str, Any] = {"mass": [0.5, 0.3], "coulomb": [0.3, 0.4], "viscous": [1.0, 2.0], "quadratic": [0.1, 0.0]}
    base["initial_position"] = [9e-6, 0.0]  # at rest, 7 um into the membrane
    return PlantConfig(**base, **{name: EFFECTS[name] for name in effects})


# A push that friction and membrane together just hold; then through the membrane, to a stop, and back again.
THERE_AND_BACK = [(0.32, 0.0)] + [(2.0, -1.5)] * 4 + [(0.0, 0.0)] * 2 + [(-2.0, 1.5)] * 4


def with_and_without(effect: str) -> tuple[list[PlantConfig], list[PlantConfig]]:
    """A plant for each pair that this effect is the first of, and one of it alone; and each of them without it."""
    others = [other for other in sorted(EFFECTS) if other > effect]
    pairs = [plant_with(effect, other) for other in others] + [plant_with(effect)]
    return pairs, [plant_with(other) for other in others] + [plant_with()]


def shown_by(batch: Stage) -> NDArray[np.float64]:
    """All that is to be seen of a batch now, a row a member."""
    return np.concatenate([batch.position, batch.velocity, batch.pierced, batch.read()], axis=1)


def stories() -> list[str]:
    """Their names."""
    return list(EFFECTS)


def tell(story: str) -> list[str]:
    """Of an effect: what is to be seen after the whole script, alone and with every other effect."""
    pairs, plain = with_and_without(story)
    batch = Stage(Truth.stack([Truth.from_config(plant, 2, ["x", "y"]) for plant in [*pairs, *plain]]))
    for piece in THERE_AND_BACK:
        batch.advance(MS, np.broadcast_to(piece, batch.truth.shape))
        batch.read()  # the encoders' noise goes on with every reading
    return lines(story, shown_by(batch))


def lines(effect: str, shown: NDArray[np.float64]) -> list[str]:
    """Of what `shown_by` shows of the batch of `with_and_without`: first those with the effect."""
    partners = [*(f"with {other}" for other in sorted(EFFECTS) if other > effect), "alone"]
    half, told = len(partners), []
    for name, row, without in zip(partners, shown[:half], shown[half:], strict=True):
        (x, y), (vx, vy) = row[:2], row[2:4]
        moved = ", ".join(f"{found:.4g}" for found in row[:2] - without[:2])
        hashed = sha256(row.astype("<f8").tobytes(), without.astype("<f8").tobytes())
        told.append(f"{name}: at {x:.6g}, {y:.6g} m, {vx:.4g}, {vy:.4g} m/s; by the effect {moved} m; sha256 {hashed}")
    return told
