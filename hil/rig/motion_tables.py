"""The tables of a rig file about goals to a running rig: [motion] and [axes.NAME.motion]."""

from typing import Any

from pydantic import model_validator

from drivers.base.keys import Table, key
from drivers.base.plugins import Kind, known, unknown
from sim_plant.config import Positive

MOTIONS: dict[str, str] = {"cells": "hil.control.motion.injection.cells:CellInjection"}
MOTION_KIND = Kind("motion", "motions", "motion", "name", "hil.motions", MOTIONS, ("begin", "step"))


class AxisMotionConfig(Table):
    """[axes.NAME.motion]: what goals (jog, moves, streams) hold the axis to."""

    speed: Positive | None = key(None, "greatest speed of goals; not stated: 0.8 of limits.speed", "m/s (rad/s)")
    acceleration: Positive | None = key(
        None,
        "greatest acceleration; not stated: 0.6 of what 85 % of limits.force leaves after friction and gravity",
        "m/s^2 (rad/s^2)",
    )
    jerk: Positive | None = key(
        None,
        "greatest jerk; not stated: acceleration in 10 ms, or in two periods of the resonance",
        "m/s^3 (rad/s^3)",
    )
    window: Positive | None = key(
        None,
        "distance from its set-point within which the axis counts as in position; not stated: the "
        "larger of 1 um (10 urad) and 10 encoder counts",
        "m (rad)",
    )

    def problem(self, speed: float, reach: float) -> str:
        """What it says that cannot be, "" where all is well. speed: limits.speed; reach: force over mass, m/s^2."""
        if self.speed is not None and self.speed > speed:
            return f"motion.speed = {self.speed}: at most limits.speed = {speed}"
        if self.acceleration is not None and self.acceleration > 0.5 * reach:  # a damped stop is shorter than a plan's
            return f"motion.acceleration = {self.acceleration}: at most limits.force / (2 mass) = {0.5 * reach:g}"
        return ""


class MotionConfig(Table):
    """[motion]: goals to a running rig, and what decides its motion in place of a task."""

    interrupt: bool = key(True, "a goal stops the task along its path and takes over; false: it is refused")
    name: str = key(
        "",
        f"what decides the motion tick by tick, once ACTIVE: {', '.join(MOTIONS)}; or a motion of your own: its "
        "registered name, package.module:Class, or ./file.py:Class beside the rig file; none: [task] is followed",
    )
    parameters: dict[str, Any] = key({}, "of that motion: what its class takes")
    source: str = key(
        "", "of a motion of your own: its file's text, or its package's digest; filled in when the rig is loaded"
    )

    @model_validator(mode="after")
    def _known(self) -> "MotionConfig":
        if self.name and not self.source and not known(MOTION_KIND, self.name):  # with it: of a package not here
            raise ValueError(unknown(MOTION_KIND, self.name))
        if self.parameters and not self.name:
            raise ValueError("parameters: of a motion; name = '' names none")
        return self
