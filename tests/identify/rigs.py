"""A one-axis rig whose emulated stage is 30 % off its nominal model."""

from typing import Any

from hil.runs.rigs import Rig

MASS, COULOMB, VISCOUS, LENGTH = 1.3, 0.8, 4.0, 5e-6


def one_axis(**tables: Any) -> Rig:
    limits = {"position": [-0.02, 0.02], "speed": 0.08, "force": 15.0, "force_rate": 3e4, "following_error": 5e-4}
    model = {"mass": 1.0, "coulomb": 0.6, "viscous": 3.0, "torque_lag": 2e-4}
    axis = {"encoder_resolution": 5e-9, "rated_force": 20.0, "limits": limits, "model": model}
    plant = {"mass": [MASS], "coulomb": [COULOMB], "viscous": [VISCOUS], "presliding": [LENGTH], "torque_lag": [2e-4]}
    document = {"name": "one", "axes": {"x": axis}, "plant": plant, **tables}
    return Rig.build(document)
