"""The smallest commented rig file that runs: what a person knows of a stage, as text. `hil new` writes it.

What a data sheet does not say follows from what it does: limits from travel and force, the filter's noise from the
friction, a first move that asks for a fifth of the force. It is a place to begin from, not a tuned rig.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from drivers.base.plugins import load
from drivers.families import Sketched, SketchedAxis, families, layouts

LAYOUTS = tuple(name.partition(":")[0] for name in layouts())
GRAVITY = 9.81  # m/s^2
MOVE_SHARE, FORCE_SHARE, SPEED_SHARE = 0.1, 0.2, 0.5  # the first move: of the travel, the rated force, the speed limit
LEAST_COUNTS_A_TICK, LEAST_COUNTS_OFF = 10, 100  # of an encoder that is coarse for the travel: the least limits
JERK_FREE_SPEED, JERK_FREE_ACCELERATION = 1.875, 5.7735  # peaks of a minimum-jerk move over d / T and d / T^2
BRAKE_OPENING_S = 0.05  # of small brakes, by their data sheets


class AxisSketch(NamedTuple):
    """What one has to know of an axis; SI units, for a rotary axis rad, kg m^2 and N m.

    mass: moving mass. travel: from end to end, centred on zero. encoder: per count. force: the drive's rated force.
    friction: Coulomb. vertical: gravity pulls it down, and its drive has a brake.
    """

    name: str
    mass: float
    travel: float
    encoder: float
    force: float
    friction: float
    rotary: bool = False
    vertical: bool = False

    @property
    def gravity(self) -> float:
        """Constant force on the axis, N."""
        return -self.mass * GRAVITY if self.vertical else 0.0


class Sketch(NamedTuple):
    """A stage in a few words. layout: of LAYOUTS."""

    name: str
    axes: tuple[AxisSketch, ...]
    layout: str = LAYOUTS[0]
    rate_hz: float = 1000.0
    watchdog_s: float = 0.01

    @property
    def of_family(self) -> Sketched:
        """What the family of its drives adds."""
        family = next(f for f in families().values() if self.layout in {name.partition(":")[0] for name in f.layouts})
        if not family.sketch:
            return Sketched()
        axes = [SketchedAxis(axis.name, axis.encoder, axis.force, axis.travel) for axis in self.axes]
        added: Sketched = load(family.sketch)(self.name, axes, self.watchdog_s)
        return added

    @property
    def files(self) -> dict[str, str]:
        """Texts of the files that belong beside the rig file, by name."""
        added = self.of_family
        return {f"{self.name}{added.ending}": added.file} if added.file else {}


def rig_text(sketch: Sketch) -> str:
    """The rig file, TOML."""
    names = ", ".join(f'"{axis.name}"' for axis in sketch.axes)
    brake = ", ".join(str(axis.vertical).lower() for axis in sketch.axes)
    opening = f"\nbrake_opening_s = {BRAKE_OPENING_S:g}  # longest; the weight's force stands before"
    opening = opening if any(axis.vertical for axis in sketch.axes) else ""
    move = [_rounded(MOVE_SHARE * axis.travel) for axis in sketch.axes]
    added = sketch.of_family
    protocol = ":".join([sketch.layout, *sketch.files])
    lines = added.axes or [""] * len(sketch.axes)
    encoders = added.encoders or [axis.encoder for axis in sketch.axes]
    axes = [axis._replace(encoder=encoder) for axis, encoder in zip(sketch.axes, encoders, strict=True)]
    coarser = [math.sqrt(axis.encoder / asked.encoder) for axis, asked in zip(axes, sketch.axes, strict=True)]
    # Coarse counts make a filter slow, which costs phase, and so does mass: the more the force may change, the quicker
    # it is. 5 N/sqrt(s) for each kg leaves more than 6 dB, with counts of 0.1 um or finer.
    changes = [max(4.0 * axis.friction, 1e-3 * axis.force, 5.0 * axis.mass) for axis in axes]
    noise = [_rounded(k * change) for k, change in zip(coarser, changes, strict=True)]
    parts = [
        f"""\
# Made by `hil new`. Try it: hil check {sketch.name}.toml; hil sim {sketch.name}.toml
# `hil explain KEY` says what a key means; docs/rig-file.md has all of them.
name = "{sketch.name}"
rate_hz = {sketch.rate_hz:g}
""",
        *(
            _axis_text(axis, f"\n{line}" if line else "", sketch.rate_hz)
            for axis, line in zip(axes, lines, strict=True)
        ),
        f"""\
# What the drives do by themselves, by their data sheet. Their watchdog must be switched on.
[drives]
watchdog_s = {sketch.watchdog_s:g}  # zero torque when no valid command came for this long
brake = [{brake}]  # at zero torque the axis is held by a brake{opening}

[law]
name = "pd-feedforward"  # its gains follow from mass and rate; `hil tune` finds better ones

[estimator]
disturbance_noise = {_list(noise)}  # N/sqrt(s): how quickly friction and load may change

[task]
kind = "point_to_point"  # back and forth
axes = [{names}]
target = {_list(move)}
move_s = {_move_s(sketch.axes):g}
approach_s = 0.5
settle_s = 0.5

[bus]
channel = "can0"
protocol = "{protocol}"
""",
    ]
    if added.tables:
        parts.append(added.tables)
    parts.append("""\
# There is no [plant]: `hil sim` and `hil demo` emulate a stage that is exactly as the nominal model says. To see what
# another one does: hil sim ... --set plant.mass_scale=1.2 --set plant.friction_scale=1.5
""")
    return "\n".join(parts)


def _axis_text(axis: AxisSketch, added: str, rate_hz: float) -> str:
    speed = max(2.0 * axis.travel, LEAST_COUNTS_A_TICK * axis.encoder * rate_hz)
    following_error = max(0.01 * axis.travel, LEAST_COUNTS_OFF * axis.encoder)
    length, force = ("rad", "N m") if axis.rotary else ("m", "N")
    mass = "kg m^2" if axis.rotary else "kg"
    end = _rounded(axis.travel / 2)
    gravity = f"\ngravity = {_rounded(axis.gravity)!r}" if axis.vertical else ""
    return f"""\
[axes.{axis.name}]
kind = "{"rotary" if axis.rotary else "linear"}"
encoder_resolution = {axis.encoder!r}  # {length} per count
rated_force = {axis.force!r}  # {force}{added}

[axes.{axis.name}.limits]  # {length}, {length}/s, {force}, {force}/s, {length}
position = [{-end!r}, {end!r}]
speed = {_rounded(speed)!r}
force = {axis.force!r}
force_rate = {_rounded(2000.0 * axis.force)!r}
following_error = {_rounded(following_error)!r}

[axes.{axis.name}.model]  # the nominal model: {mass}, {force}
mass = {axis.mass!r}
coulomb = {_rounded(axis.friction)!r}{gravity}
"""


def _move_s(axes: tuple[AxisSketch, ...]) -> float:
    """Duration of a move that keeps every axis within its shares of force and speed, s: also of the first one, which
    may begin at an end of the travel.
    """
    slowest = 0.5
    for axis in axes:
        distance = (0.5 + MOVE_SHARE) * axis.travel
        by_force = math.sqrt(JERK_FREE_ACCELERATION * distance * axis.mass / (FORCE_SHARE * axis.force))
        by_speed = JERK_FREE_SPEED * distance / (SPEED_SHARE * 2.0 * axis.travel)
        slowest = max(slowest, by_force, by_speed)
    return math.ceil(slowest * 10.0) / 10.0


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(repr(value) for value in values)}]"
