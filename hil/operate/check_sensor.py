"""Whether a rig's force sensor can do what its injection asks: noise, the mass that it carries, and whether it can hold
a constant reading. Each with its number.

- A puncture is a drop by more than 7 times the noise, of which a force of LEAST_RATIO times the noise leaves enough.
- A sensor on the pipette's side feels the mass between itself and the tip: at a sudden acceleration a reading of m a.
  What is below the drift of the contact detector is never taken for a touch.
- A reading that fades with a time constant T is too low by 1 - exp(-t/T) after t, so the force limit is above what is
  stated, and a force cannot be held by it.
"""

import math
from typing import Final, NamedTuple

from hil.control.motion.asked import surroundings
from hil.control.motion.injection.checked import settings
from hil.control.motion.injection.settings import Settings
from hil.control.motion.injection.z_laws import CONTACT_DRIFT
from hil.cycle.limits import motion_limits
from hil.rig.schema import RigConfig
from sim_plant.cell_presets import PRESETS

LEAST_RATIO: Final = 12.0  # of the puncture force to the noise
MOST_LOST: Final = 0.1  # of the force, until the deepest place
HELD_S: Final = 1.0


class Finding(NamedTuple):
    """text: for people, with the number. refused: the rig may not inject like this."""

    text: str
    refused: bool


def check_sensor(rig: RigConfig) -> list[Finding]:
    """Of a rig that injects cells; nothing for any other. Raises ValueError naming a parameter that cannot be."""
    if rig.motion.name != "cells":
        return []
    asked = settings(surroundings(rig, motion_limits(rig)), rig.motion.parameters)
    return [*_noise(rig, asked), *_mass(rig, asked), *_decay(rig, asked)]


def _emulated(rig: RigConfig, name: str, key: str) -> float:
    """Of the emulated sensor of that name; 0.0 where there is none."""
    return max((float(getattr(entry, key)) for entry in rig.plant.sensors if entry.sensor == name), default=0.0)


def puncture_force(rig: RigConfig, stated: float) -> float:
    """N: what is stated, else the mean of the emulated dish's weakest membrane; 0.0: not known."""
    dish = rig.plant.dish
    if stated or dish is None:
        return stated
    return min(layer.force for layer in dish.layers or PRESETS[dish.preset].layers) * dish.tip


def _noise(rig: RigConfig, asked: Settings) -> list[Finding]:
    noise, force = rig.sensors[asked.force].noise, puncture_force(rig, asked.puncture_force)
    least = LEAST_RATIO * noise
    if not force:
        return [
            Finding(
                f"sensors.{asked.force}.noise = {noise:g} N: cells are seen to be pierced from {least:.3g} N on; state "
                "motion.parameters.puncture_force to have yours checked",
                False,
            )
        ]
    text = (
        f"sensors.{asked.force}.noise = {noise:g} N: the puncture force of {force:.3g} N is {force / noise:.1f} times "
        f"the noise; at least {LEAST_RATIO:g}"
    )
    found = [Finding(text, force < least)]
    if force > asked.force_limit:
        limit = f"motion.parameters.force_limit = {asked.force_limit:g} N: below the puncture force of {force:.3g} N"
        found.append(Finding(f"{limit}: no cell would be pierced", True))
    return found


def _mass(rig: RigConfig, asked: Settings) -> list[Finding]:
    mass = max(rig.sensors[asked.force].tool_mass, _emulated(rig, asked.force, "tool_mass"))
    if not mass:
        return []
    limits = motion_limits(rig)[rig.axis_names.index(asked.along)]
    most = CONTACT_DRIFT * rig.sensors[asked.force].noise / mass
    way = asked.press_speed**2 / (2.0 * most)
    refused = limits.acceleration > most
    text = (
        f"sensors.{asked.force}: a mass of {mass:g} kg between sensor and tip reads as a touch above {most:.3g} m/s^2; "
        f"axes.{asked.along}.motion.acceleration = {limits.acceleration:.3g} m/s^2"
    )
    if refused:
        text += (
            f"; at most {most:.3g}, with which the tip needs {way * 1e6:.0f} um to stop from press_speed = "
            f"{asked.press_speed:g} m/s, or a sensor on the cell's side"
        )
    return [Finding(text, refused)]


def _decay(rig: RigConfig, asked: Settings) -> list[Finding]:
    decay = rig.sensors[asked.force].decay or _emulated(rig, asked.force, "decay")
    if not decay:
        return []
    seconds = asked.deepest / asked.press_speed
    hold_s = asked.hold_s if asked.z_law == "hold" else HELD_S
    lost, held = 1.0 - math.exp(-seconds / decay), 1.0 - math.exp(-hold_s / decay)
    text = (
        f"sensors.{asked.force}: its reading fades in {decay:g} s. A force held for {hold_s:g} s reads {held:.0%} too "
        f"low, so none can be held. In a press of {seconds:.3g} s the cell may feel {lost:.0%} more than "
        f"force_limit = {asked.force_limit:g} N; at most {MOST_LOST:.0%}"
    )
    return [Finding(text, lost > MOST_LOST or asked.z_law == "hold")]
