"""The tables of a rig file that say what the stage is to do: [task], and [task.injection] in it.

Quantities are in SI units; where an axis is rotary, the unit in brackets holds.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import known, unknown
from hil.rig.task_file import MOST_ROWS, sample_problems
from hil.rig.task_kinds import KIND, TASKS, is_users
from sim_plant.config import NonNegative, Positive

Duration = Annotated[float, Field(gt=0, le=1e6)]  # s; a thousand cells of the longest still fit 64 bits of ns
Pause = Annotated[float, Field(ge=0, le=1e6)]  # s


class InjectionConfig(Table):
    """[task.injection]: the motion plan of the paper's section 2.1 over a row of cells.

    Positions are lists in the order of [axes].
    """

    home: list[float] = key(REQUIRED, "q_a: where the plan begins and ends", "m (rad)")
    focal: list[float] = key(REQUIRED, "q_b: within the focal range, beside the first cell", "m (rad)")
    start: list[float] = key(REQUIRED, "q_s of the first cell: where the pipette starts to accelerate", "m (rad)")
    contact: list[float] = key(REQUIRED, "q_c of the first cell; speed is greatest here", "m (rad)")
    end: list[float] = key(REQUIRED, "q_d of the first cell: at rest inside", "m (rad)")
    pitch: list[float] = key(REQUIRED, "from one cell to the next", "m (rad)")
    cells: int = key(3, "number of cells", "1", ge=1, le=1000)
    approach_s: Duration = key(2.0, "duration of q_a to q_b", "s")
    transfer_s: Duration = key(0.6, "duration of q_b to q_s, and from cell to cell", "s")
    strike_s: Duration = key(0.25, "duration of q_s to q_c to q_d", "s")
    contact_speed: Positive = key(0.01, "speed at q_c along the line from q_s to q_d", "m/s")
    dwell_s: Duration = key(1.0, "rest at q_d, while the injection takes place", "s")
    withdraw_s: Duration = key(0.6, "duration of the way back to q_s", "s")


TWO_AXES = ("circle", "lissajous", "spiral", "raster")  # kinds of task that need exactly two


class TaskConfig(Table):
    """[task]: what the stage is to do once ACTIVE."""

    kind: str = key(
        "hold",
        f"the kind of motion: {', '.join(TASKS)}; or a task of your own: its registered name, package.module:Class, or "
        "./file.py:Class beside the rig file",
    )
    parameters: dict[str, Any] = key({}, "of a task of your own: what its class takes")
    source: str = key("", "of such a task: its file's text, or its package's digest; filled in when the rig is loaded")
    axes: list[str] = key([], f"{', '.join(TWO_AXES)}: the two axes; others: those that move")
    radius: Positive = key(1.0, "circle: radius; lissajous: amplitude; spiral: radius at its end", "m (rad)")
    frequency_hz: float = key(0.5, "frequency of the first axis", "Hz", ge=1e-6, le=1e4)
    ratio: int = key(2, "lissajous: frequency of the second axis over that of the first", "1", ge=1, le=16)
    phase: float = key(0.0, "phase at the start of the figure", "rad")
    approach_s: Duration = key(2.0, "duration of the minimum-jerk approach to the figure", "s")
    settle_s: Pause = key(6.0, "after the approach; statistics start then", "s")
    target: list[float] = key([], "point_to_point: target per axis in `axes`", "m (rad)")
    move_s: Duration = key(1.0, "point_to_point: duration of one move; spiral: of all of it", "s")
    dwell_s: Pause = key(
        0.5, "point_to_point, waypoints, raster: rest between moves; with `blend`, and of a spline: at the end", "s"
    )
    file: str = key("", "path: CSV or NPZ beside the rig file, with time_s and a column for each axis that moves")
    samples: list[list[float]] = key(
        [],
        "path: rows of time and positions in the order of `axes`; read from `file`, or made by a task of your own",
        "s, then m (rad)",
    )
    between: Literal["smooth", "blended", "linear"] = key(
        "smooth",
        "path: what lies between two rows. smooth: a cubic spline, which may go beyond them a little; blended: without "
        "stopping, never beyond them; linear: at rest in every row. Two equal rows of an axis are always a rest",
    )
    beyond: NonNegative = key(
        0.01, "path: most that an axis may go beyond two neighbouring rows, in its longest step from row to row", "1"
    )
    waypoints: list[list[float]] = key([], "waypoints, spline: positions in the order of `axes`", "m (rad)")
    speed: Positive = key(0.1, "waypoints, spline, raster: greatest speed of an axis", "m/s (rad/s)")
    acceleration: Positive = key(1.0, "waypoints, spline, raster: greatest acceleration of an axis", "m/s^2 (rad/s^2)")
    jerk: Positive = key(100.0, "waypoints, spline, raster: greatest jerk of an axis", "m/s^3 (rad/s^3)")
    blend: NonNegative = key(
        0.0, "waypoints, raster: points are passed at no more than this, without stopping; 0: rest at each", "m (rad)"
    )
    corner: list[float] = key([], "raster: where the first line begins, in the order of `axes`", "m (rad)")
    size: list[float] = key([], "raster: along the lines (first axis), and across them (second axis)", "m (rad)")
    lines: int = key(10, "raster: number of lines, to and fro", "1", ge=2, le=5000)
    turns: float = key(3.0, "spiral: number of turns", "1", ge=0.25, le=300)
    repeat: bool = key(
        False,
        "path, waypoints, spline, raster, spiral: over and over again; what ends elsewhere than it begins goes back "
        "(a spiral the way it came; a path must end where it began)",
    )
    injection: InjectionConfig | None = key(None, "the injection plan; needed for kind = 'injection'")

    @model_validator(mode="after")
    def _complete(self) -> "TaskConfig":
        if not self.samples and not known(KIND, self.kind):  # with them, a recording of a package that is not here
            raise ValueError(unknown(KIND, self.kind))
        if self.kind == "injection" and self.injection is None:
            raise ValueError("kind = 'injection' needs a table [task.injection]")
        if self.kind == "point_to_point" and self.target and len(self.target) != len(self.axes):
            raise ValueError(f"target has {len(self.target)} values for {len(self.axes)} axes")
        if self.timed and (problems := sample_problems(self.axes, self.samples)):
            raise ValueError(f"samples: {problems[0]}")
        if self.kind in ("waypoints", "spline"):
            self._check_waypoints()
        if self.kind == "raster":
            self._check_raster()
        return self

    @property
    def timed(self) -> bool:
        """Whether it goes through `samples`: of a file, or of a program of users."""
        return self.kind == "path" or is_users(self.kind)

    def _check_raster(self) -> None:
        for name, values in (("corner", self.corner), ("size", self.size)):
            if len(values) != 2:
                raise ValueError(f"kind = 'raster' needs `{name}` with 2 values; it has {len(values)}")
        if not all(self.size):
            raise ValueError(f"size = {self.size}: allowed: two numbers other than 0")

    def _check_waypoints(self) -> None:
        if not self.axes or not 2 <= len(self.waypoints) <= MOST_ROWS:
            raise ValueError(f"kind = {self.kind!r} needs `axes` and from 2 to {MOST_ROWS} waypoints")
        if self.kind == "spline" and all(point == self.waypoints[0] for point in self.waypoints):
            raise ValueError("waypoints: every row is row 1 again; a spline needs two points")
        for number, point in enumerate(self.waypoints, 1):
            if len(point) != len(self.axes):
                raise ValueError(f"waypoints: row {number} has {len(point)} values for {len(self.axes)} axes")
