"""The tables of a rig file about goals to a running rig: [motion] and [axes.NAME.motion]."""

from drivers.base.keys import Table, key
from sim_plant.config import Positive


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
    """[motion]: goals to a running rig."""

    interrupt: bool = key(True, "a goal stops the task along its path and takes over; false: it is refused")
