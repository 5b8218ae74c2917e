"""Drawn scenes as they come: each number one camera and one thing to see, anywhere and never twice the same."""

import math

import numpy as np

from sim_plant.nodes.picture import Optics, Scene

FULL = 40e-6  # m, radius of a full bolus


def drawn_scene(number: int) -> tuple[Optics, Scene]:
    """A third with a dimple, a third with a bolus; noise to 3 %, blur to 4.5 px, corners to half as bright."""
    draw = np.random.default_rng(number)
    optics = Optics(
        turn=draw.uniform(-math.pi, math.pi),
        shaft=draw.uniform(-0.17, 0.17),
        aside=(draw.uniform(-6e-5, 6e-5), draw.uniform(-6e-5, 6e-5)),
        blur=draw.uniform(0.6, 2.5),
        depth=draw.uniform(0.0, 2e4),
        light=draw.uniform(0.0, 0.5),
        noise=draw.uniform(0.005, 0.03),
        full=FULL,
        seed=number,
    )
    kind = int(draw.integers(3))
    scene = Scene(
        tip=(1e-3, 2e-3, draw.uniform(0.0, 1e-4)),
        cell=(1e-3 + draw.uniform(-8e-5, 8e-5), 2e-3 + draw.uniform(-8e-5, 8e-5)),
        radius=draw.uniform(4.2e-4, 5.2e-4),
        dimple=draw.uniform(4e-5, 3e-4) if kind == 1 else 0.0,
        bolus=draw.uniform(0.5, 1.3) if kind == 2 else 0.0,
        number=number,
    )
    return optics, scene
