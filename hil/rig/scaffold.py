"""The smallest commented rig file that runs: what a person knows of a stage, as text. `hil new` writes it.

What a data sheet does not say follows from what it does: limits from travel and force, the filter's noise from the
friction, a first move that asks for a fifth of the force. It is a place to begin from, not a tuned rig.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from drivers.config import LAYOUTS as OF_DRIVERS
from hil.rig.tables import MAX_AXES

LAYOUTS = tuple(name.partition(":")[0] for name in OF_DRIVERS)
MOTEUS_COUNTS = 100_000  # per turn of a controller's output shaft
GRAVITY = 9.81  # m/s^2
MOVE_SHARE, FORCE_SHARE, SPEED_SHARE = 0.1, 0.2, 0.5  # the first move: of the travel, the rated force, the speed limit
JERK_FREE_SPEED, JERK_FREE_ACCELERATION = 1.875, 5.7735  # peaks of a minimum-jerk move over d / T and d / T^2


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
    """A stage in a few words. layout: of LAYOUTS. dbc: name of the DBC file beside the rig file, for the layout dbc."""

    name: str
    axes: tuple[AxisSketch, ...]
    layout: str = "stage_fd"
    rate_hz: float = 1000.0
    watchdog_s: float = 0.01
    dbc: str = ""


def rig_text(sketch: Sketch) -> str:
    """The rig file, TOML."""
    names = ", ".join(f'"{axis.name}"' for axis in sketch.axes)
    brake = ", ".join(str(axis.vertical).lower() for axis in sketch.axes)
    move = [_rounded(MOVE_SHARE * axis.travel) for axis in sketch.axes]
    noise = [_rounded(max(4.0 * axis.friction, 1e-3 * axis.force)) for axis in sketch.axes]
    protocol = f"dbc:{sketch.dbc}" if sketch.layout == "dbc" else sketch.layout
    parts = [
        f"""\
# Made by `hil new`. Try it: hil check {sketch.name}.toml; hil sim {sketch.name}.toml
# `hil explain KEY` says what a key means; docs/rig-file.md has all of them.
name = "{sketch.name}"
rate_hz = {sketch.rate_hz:g}
""",
        *(_axis_text(axis, _gear(axis) if sketch.layout == "moteus" else "") for axis in sketch.axes),
        f"""\
# What the drives do by themselves, by their data sheet. Their watchdog must be switched on.
[drives]
watchdog_s = {sketch.watchdog_s:g}  # zero torque when no valid command came for this long
brake = [{brake}]  # at zero torque the axis is held by a brake

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
    if sketch.layout == "dbc":
        parts.append(_binding_text(sketch.axes))
    if sketch.layout == "moteus":
        nodes = _list([*range(1, len(sketch.axes) + 1)])
        parts.append(f"[bus.moteus]\nnodes = {nodes}  # id.id of each\nwatchdog_s = {sketch.watchdog_s:g}\n")
    parts.append("""\
# There is no [plant]: `hil sim` and `hil demo` emulate a stage that is exactly as the nominal model says. To see what
# another one does: hil sim ... --set plant.mass_scale=1.2 --set plant.friction_scale=1.5
""")
    return "\n".join(parts)


def _gear(axis: AxisSketch) -> str:
    """What a moteus makes of its torque, by the travel of a turn."""
    turn = MOTEUS_COUNTS * axis.encoder
    return f"\ngear = {_rounded(2.0 * math.pi / turn)!r}  # 2 pi over the {turn:g} of a turn of the output shaft"


def _axis_text(axis: AxisSketch, gear: str) -> str:
    length, force = ("rad", "N m") if axis.rotary else ("m", "N")
    mass = "kg m^2" if axis.rotary else "kg"
    end = _rounded(axis.travel / 2)
    gravity = f"\ngravity = {_rounded(axis.gravity)!r}" if axis.vertical else ""
    return f"""\
[axes.{axis.name}]
kind = "{"rotary" if axis.rotary else "linear"}"
encoder_resolution = {axis.encoder!r}  # {length} per count
rated_force = {axis.force!r}  # {force}{gear}

[axes.{axis.name}.limits]  # {length}, {length}/s, {force}, {force}/s, {length}
position = [{-end!r}, {end!r}]
speed = {_rounded(2.0 * axis.travel)!r}
force = {axis.force!r}
force_rate = {_rounded(2000.0 * axis.force)!r}
following_error = {_rounded(0.01 * axis.travel)!r}

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


def _binding_text(axes: tuple[AxisSketch, ...]) -> str:
    """[bus.dbc] for the DBC file of `dbc_text`."""

    def table(key: str, message: str, signal: str, scales: list[float] | None = None) -> str:
        rows = [
            f'    {{ message = "{message}_{axis.name}", signal = "{signal}"'
            + (f", scale = {scales[number]!r}" if scales else "")
            + " },"
            for number, axis in enumerate(axes)
        ]
        return "\n".join([f"{key} = [", *rows, "]"])

    checksums = [f'    {{ message = "{m}_{axis.name}", signal = "Checksum" }},' for m in _MESSAGES for axis in axes]
    return "\n".join(
        [
            "# Which signal of the DBC file is what, one per axis; put your drives' names here.",
            "# scale: encoder counts per unit of a position, N (N m) per unit of a torque.",
            "[bus.dbc]",
            table("position", "Feedback", "Position", [1.0] * len(axes)),
            table("torque", "Demand", "Torque", [_rounded(axis.force / 100.0) for axis in axes]),
            table("status", "Feedback", "State"),
            table("enable", "Demand", "Enable"),
            table("reset", "Demand", "Reset"),
            table("command_counter", "Demand", "Counter"),
            table("feedback_counter", "Feedback", "Counter"),
            "\n".join(["checksum = [", *checksums, "]"]),
            "",
        ]
    )


_MESSAGES = ("Demand", "Feedback")


def dbc_text(axes: tuple[AxisSketch, ...]) -> str:
    """A DBC file of drives such as a supplier might describe: a command and an answer per axis, torque in per cent of
    the rated force, position in counts.
    """
    if len(axes) > MAX_AXES:
        raise ValueError(f"{len(axes)} axes: at most {MAX_AXES}")
    lines = [
        'VERSION ""',
        "",
        "NS_ :",
        "",
        "BS_:",
        "",
        f"BU_: Controller {' '.join(f'Drive_{a.name}' for a in axes)}",
        "",
    ]
    for number, axis in enumerate(axes):
        lines += [
            f"BO_ {0x210 + number} Demand_{axis.name}: 6 Controller",
            f' SG_ Torque : 7|16@0- (0.01,0) [-327.68|327.67] "%" Drive_{axis.name}',
            f' SG_ Enable : 23|1@0+ (1,0) [0|1] "" Drive_{axis.name}',
            f' SG_ Reset : 22|1@0+ (1,0) [0|1] "" Drive_{axis.name}',
            f' SG_ Counter : 19|4@0+ (1,0) [0|15] "" Drive_{axis.name}',
            f' SG_ Checksum : 47|8@0+ (1,0) [0|255] "" Drive_{axis.name}',
            "",
            f"BO_ {0x310 + number} Feedback_{axis.name}: 8 Drive_{axis.name}",
            ' SG_ Position : 7|32@0- (1,0) [-2147483648|2147483647] "counts" Controller',
            ' SG_ Counter : 35|4@0+ (1,0) [0|15] "" Controller',
            ' SG_ State : 46|7@0+ (1,0) [0|127] "" Controller',
            ' SG_ Checksum : 63|8@0+ (1,0) [0|255] "" Controller',
            "",
        ]
    return "\n".join(lines)
