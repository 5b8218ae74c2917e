"""[motion.parameters] of name = "cells", held against their ranges, the rig, and the laws that there are."""

from dataclasses import fields
from typing import Any

from hil.control.motion.contract import Surroundings
from hil.control.motion.injection.settings import Settings
from hil.control.motion.injection.z_laws import Z_LAWS

Range = tuple[float, float]
_RANGES: dict[str, Range] = {
    "start_above": (1e-6, 0.01),
    "transfer_speed": (1e-5, 1.0),
    "turn_speed": (1e-4, 100.0),
    "seek_speed": (1e-6, 0.05),
    "press_speed": (1e-6, 0.05),
    "withdraw_speed": (1e-5, 0.5),
    "deposit": (1e-6, 0.01),
    "deepest": (1e-6, 0.02),
    "force_limit": (1e-9, 1.0),
    "puncture_force": (0.0, 1.0),
    "pull_limit": (1e-9, 1.0),
    "force_rate": (1e-9, 10.0),
    "admittance": (1e-6, 1e3),
    "stiffness": (1e-3, 1e6),
    "hold_force": (1e-9, 1.0),
    "hold_s": (0.01, 600.0),
    "freeze_s": (0.0, 1.0),
    "pulse_s": (0.001, 10.0),
    "dwell_s": (0.0, 60.0),
    "settle_s": (0.0, 10.0),
    "camera_latency_s": (0.0, 0.5),
    "camera_age_s": (0.01, 2.0),
    "roll_limit": (1e-7, 1e-3),
    "tip_limit": (1e-7, 1e-3),
    "bolus_least": (0.0, 1.0),
}


def settings(rig: Surroundings, parameters: dict[str, Any]) -> Settings:
    """Raises ValueError naming key, value and allowed range."""
    known = [field.name for field in fields(Settings)]
    for name in parameters:
        if name not in known:
            raise ValueError(f"motion.parameters.{name}: 'cells' has {', '.join(known)}")
    for name in ("cells", "safe"):
        if name not in parameters:
            raise ValueError(f"motion.parameters.{name}: 'cells' needs it")
    made = Settings(**parameters)
    for name, (low, high) in _RANGES.items():
        value = getattr(made, name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise ValueError(f"motion.parameters.{name} = {value!r:.40}; allowed: from {low:g} to {high:g}")
    _check_names(rig, made)
    _check_places(rig, made)
    return made


def _check_names(rig: Surroundings, made: Settings) -> None:
    for name, value, there in (
        ("along", made.along, rig.axes), ("force", made.force, rig.sensors), ("shift", made.shift, rig.sensors),
        ("tip", made.tip, rig.sensors), ("bolus", made.bolus, rig.sensors), ("dimple", made.dimple, rig.sensors),
        ("valve", made.valve, rig.outputs),
    ):  # fmt: skip
        optional = name in ("shift", "tip", "bolus", "dimple", "valve")
        if value not in there and not (optional and value == ""):
            raise ValueError(f"motion.parameters.{name} = {value!r:.40}; the rig has {', '.join(there) or 'none'}")
    if made.z_law not in Z_LAWS:
        raise ValueError(f"motion.parameters.z_law = {made.z_law!r:.40}; allowed: {', '.join(Z_LAWS)}")
    if made.z_law == "hold" and made.hold_force >= made.force_limit:
        raise ValueError(
            f"motion.parameters.hold_force = {made.hold_force:g}; allowed: below force_limit = {made.force_limit:g}"
        )
    if made.z_law == "visual" and not made.dimple:
        raise ValueError("motion.parameters.dimple = '': z_law = 'visual' needs a sensor of the cell's dimple")
    if len(made.across) != 2 or any(name not in rig.axes or name == made.along for name in made.across):
        raise ValueError(f"motion.parameters.across = {list(made.across)!r:.60}; allowed: two other axes of the rig")
    if made.turn and (made.turn not in rig.axes or made.turn in (*made.across, made.along)):
        raise ValueError(f"motion.parameters.turn = {made.turn!r:.40}; allowed: another axis of the rig")
    if made.direction not in (-1, 1):
        raise ValueError(f"motion.parameters.direction = {made.direction!r:.20}; allowed: -1 or 1")
    if not rig.noise[rig.sensors.index(made.force)] > 0.0:
        raise ValueError(f"sensors.{made.force}.noise = 0: what a touch is cannot be told; state the sensor's noise")


def _check_places(rig: Surroundings, made: Settings) -> None:
    """Every way that the motion takes is inside the fence."""
    if not made.cells:
        raise ValueError("motion.parameters.cells = []: expected rows of three numbers")
    if type(made.first) is not int or not 1 <= made.first <= len(made.cells):
        raise ValueError(f"motion.parameters.first = {made.first!r:.40}; allowed: 1 to {len(made.cells)}")
    axes = [*made.across, made.along, *([made.turn] if made.turn else [])]
    fences = [(rig.limits[rig.axes.index(name)].low, rig.limits[rig.axes.index(name)].high) for name in axes]
    for number, row in enumerate(made.cells, 1):
        if len(row) != len(axes) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in row):
            expected = "four numbers: m, m, m, rad" if made.turn else "three numbers, m"
            raise ValueError(f"motion.parameters.cells: row {number} is {row!r:.60}; expected {expected}")
        bottom = row[2] + made.direction * made.deepest
        for name, value, (low, high) in zip([*axes, made.along], [*row, bottom], [*fences, fences[2]], strict=True):
            if not low <= value <= high:
                unit = "rad" if name == made.turn else "m"
                takes = f"motion.parameters.cells: row {number} takes {name} to {value:g} {unit}"
                raise ValueError(f"{takes}; allowed: {low:g} to {high:g}")
        if (row[2] - made.safe) * made.direction < made.start_above:
            raise ValueError(
                f"motion.parameters.safe = {made.safe:g}: the top of row {number} is not start_above = "
                f"{made.start_above:g} m below it"
            )
    low, high = fences[2]
    if not low <= made.safe <= high:
        raise ValueError(f"motion.parameters.safe = {made.safe:g}; allowed: {low:g} to {high:g}")
