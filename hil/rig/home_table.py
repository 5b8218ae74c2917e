"""[axes.NAME.home]: how an axis finds its position after power-up."""

from typing import Final, Literal, Protocol

from drivers.base.keys import REQUIRED, Table, key
from sim_plant.config import Positive

By = Literal["switch", "limit", "index", "stop", "drive", "absolute", "here"]
SEARCHING: Final = frozenset({"switch", "limit", "index", "stop"})  # the axis moves to find it
TOLD: Final = frozenset({"index", "drive"})  # the drive says so: its status bit `homed`
SPEED: Final = 0.1  # of limits.speed, where the search's is not stated
LATCH_SPEED: Final = 0.1  # of the search's speed
MOST_WAY: Final = 1.2  # of the travel: a planned way of twice the travel drives a table into the tool (LinuxCNC#4578)


class Limited(Protocol):
    """What an axis' [limits] say of it."""

    @property
    def position(self) -> list[float]:
        """Least and greatest, m (rad)."""

    @property
    def speed(self) -> float:
        """m/s (rad/s)."""

    @property
    def force(self) -> float:
        """N (N m)."""

    @property
    def switches(self) -> bool:
        """Whether there are limit switches."""


class HomeConfig(Table):
    """[axes.NAME.home]: how the axis finds its position. Until `hil home` has done it, the rig refuses to be ACTIVE."""

    by: By = key(
        REQUIRED,
        "switch: the home switch; limit: the limit switch in `direction`; index: the axis moves until its drive has "
        "latched its position at the encoder's index, or says homed, as it has counted from there since; stop: a hard "
        "stop, found by force; drive: the drive has found it by itself and says homed, or finds it now by `method`; "
        "absolute: the encoder knows; "
        "here: where the axis stands",
    )
    direction: Literal[-1, 1] = key(-1, "in which the axis moves to find it", "1")
    farthest: Positive | None = key(
        None,
        "greatest way from where the axis stands; required where it moves, at most 1.2 times the travel",
        "m (rad)",
    )
    speed: Positive | None = key(None, "of the search; not stated: a tenth of limits.speed", "m/s (rad/s)")
    latch_speed: Positive | None = key(None, "of the last approach; not stated: a tenth of `speed`", "m/s (rad/s)")
    force: Positive | None = key(
        None,
        "greatest force while the axis homes, above what friction and gravity take; required of a stop and with "
        "`method`; not stated: limits.force",
        "N (N m)",
    )
    method: int | None = key(
        None,
        "with by = drive: homing method that the drive is told (CiA 402: 6098h; ODrive: 11, its axis state), in the "
        "drive's own direction; not stated: it has homed by itself",
        "1",
        ge=-128,
        le=127,
        exclude_if=lambda method: method is None,
    )
    acceleration: Positive | None = key(
        None,
        "with `method`: that the drive is told",
        "m/s^2 (rad/s^2)",
        exclude_if=lambda acceleration: acceleration is None,
    )
    at: float = key(0.0, "position of what is found; of drive: where the drive counts 0", "m (rad)")
    move_to: float | None = key(None, "position where the axis goes at last; not stated: it stays there", "m (rad)")
    order: int = key(0, "axes with the lowest number home first, those of one number together", "1", ge=0, le=9)

    @property
    def moves(self) -> bool:
        """Whether the axis moves while it homes."""
        return self.by in SEARCHING or self.by_itself or self.move_to is not None

    @property
    def by_itself(self) -> bool:
        """Whether its drive moves it."""
        return self.method is not None

    def problem(self, limits: Limited, held: float) -> str:
        """What is wrong with it on an axis with these limits; empty where nothing is. held: N that friction and gravity
        may take.
        """
        low, high = limits.position
        if self.by == "limit" and not limits.switches:
            return 'home.by = "limit" needs limits.switches = true'
        if self.by_itself and self.by != "drive":
            return f'home.method = {self.method} goes with home.by = "drive", not "{self.by}"'
        if self.by_itself != (self.acceleration is not None):
            return "home.method and home.acceleration go together: m/s^2 (rad/s^2), that the drive is told"
        if self.moves and self.farthest is None:
            return f'home.farthest is required with home.by = "{self.by}": m (rad), the greatest way of the search'
        if self.farthest is not None and self.farthest > MOST_WAY * (high - low):
            most = MOST_WAY * (high - low)
            return f"home.farthest = {self.farthest:g}: at most {most:g}, {MOST_WAY:g} times the travel"
        speed = self.speed or SPEED * limits.speed
        if speed > limits.speed:
            return f"home.speed = {speed:g} exceeds limits.speed = {limits.speed:g}"
        if self.latch_speed is not None and self.latch_speed > speed:
            return f"home.latch_speed = {self.latch_speed:g} exceeds the speed of the search, {speed:g}"
        if (self.by == "stop" or self.by_itself) and self.force is None:
            with_what = "home.method" if self.by_itself else 'home.by = "stop"'
            return f"home.force is required with {with_what}: above {held:g}, at most {limits.force:g}"
        if self.force is not None and not held < self.force <= limits.force:
            return f"home.force = {self.force:g}: above {held:g} (coulomb and gravity), at most {limits.force:g}"
        if self.move_to is not None and not low <= self.move_to <= high:
            return f"home.move_to = {self.move_to:g}: inside limits.position, {low:g} to {high:g}"
        if self.by == "absolute" and self.at != 0.0:
            return "home.at: an absolute encoder is corrected by axes.NAME.offset"
        return ""
