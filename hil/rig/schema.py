"""The rig file: one TOML document, validated whole before any bus is opened, frozen afterwards.

Its tables are in hil/rig/tables.py (nominal model, task, law, service), drivers/config.py (bus and drives) and
sim_plant/config.py (the emulated stage). What is checked here is what concerns more than one of them. A key that
[plant] does not state is taken from [axes] (hil/rig/plant.py), so that a whole rig always has a whole plant.
"""

import math
from collections.abc import Sequence
from typing import Annotated, get_args, get_origin

from pydantic import BaseModel, Field, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import load
from drivers.base.toml_file import short
from drivers.config import BusConfig, DrivesConfig, WireConfig
from drivers.families import Circumstances, family_of
from drivers.outputs.config import MAX_OUTPUTS, OutputConfig, clashes
from drivers.protocols.mounting import Mounting
from drivers.sensors.config import MAX_SENSORS, SensorConfig
from hil.rig.camera import CameraConfig
from hil.rig.plant import completed
from hil.rig.tables import (
    AXIS_NAME,
    LEAST_RATE_HZ,
    MAX_AXES,
    AxisConfig,
    EstimatorConfig,
    LawConfig,
    LimitsConfig,
    ModelConfig,
    MotionConfig,
    SafetyConfig,
    TelemetryConfig,
    TimingConfig,
)
from hil.rig.task_tables import TWO_AXES, InjectionConfig, TaskConfig
from sim_plant.config import PlantConfig

__all__ = [
    "LEAST_RATE_HZ", "MAX_AXES", "AxisConfig", "BusConfig", "DrivesConfig", "EstimatorConfig", "InjectionConfig",
    "LawConfig", "LimitsConfig", "ModelConfig", "PlantConfig", "RigConfig", "RigError", "SafetyConfig", "TaskConfig",
    "TelemetryConfig", "TimingConfig", "WireConfig",
]  # fmt: skip

LONGEST_PROBLEM = 1000  # characters


class RigError(Exception):
    """A rig file (or an override of it) that cannot be used; `problems` holds one line per problem, however long the
    values in it are.
    """

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = [short(problem, LONGEST_PROBLEM) for problem in problems]
        super().__init__("\n".join(self.problems))

    def of_file(self, path: object) -> "RigError":
        """The same, each line with the file it is about."""
        return RigError([f"{path}: {line}" for line in self.problems])

    def __reduce__(self) -> tuple[type["RigError"], tuple[list[str]]]:
        """As it travels from a worker process: by its problems, not their text."""
        return type(self), (self.problems,)


LEAST_RING_SLOTS = 256


class RigConfig(Table):
    """A rig file: one stage, its drives, its bus, and how it is controlled."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$")] = key(
        REQUIRED, "name of the rig; its runtime directory and recordings are named after it"
    )
    description: str = key("", "a line for people")
    rate_hz: float = key(1000.0, "control rate", "Hz", ge=LEAST_RATE_HZ, le=10_000)
    axes: Annotated[
        dict[Annotated[str, Field(pattern=AXIS_NAME)], AxisConfig], Field(min_length=1, max_length=MAX_AXES)
    ] = key(REQUIRED, "the axes by name, one to four, in bus order")
    drives: DrivesConfig = key(DrivesConfig(), "what the drives do by themselves")
    law: LawConfig = key(LawConfig(), "the control law")
    estimator: EstimatorConfig = key(EstimatorConfig(), "the Kalman filter of each axis")
    motion: MotionConfig = key(MotionConfig(), "goals to a running rig")
    task: TaskConfig = key(TaskConfig(), "what the stage is to do once ACTIVE")
    bus: BusConfig = key(BusConfig(), "the CAN bus and its frame layout")
    sensors: Annotated[dict[Annotated[str, Field(pattern=AXIS_NAME)], SensorConfig], Field(max_length=MAX_SENSORS)] = (
        key({}, "nodes that measure something else than a position, by name", exclude_if=lambda sensors: not sensors)
    )
    outputs: Annotated[dict[Annotated[str, Field(pattern=AXIS_NAME)], OutputConfig], Field(max_length=MAX_OUTPUTS)] = (
        key({}, "what a motion can switch, by name", exclude_if=lambda outputs: not outputs)
    )
    camera: CameraConfig | None = key(None, "the camera of `hil camera`", exclude_if=lambda camera: camera is None)
    wire: WireConfig = key(WireConfig(), "the simulated bus of runs in virtual time")
    timing: TimingConfig = key(TimingConfig(), "what the control process asks of the kernel")
    safety: SafetyConfig = key(SafetyConfig(), "thresholds of the fault detectors")
    telemetry: TelemetryConfig = key(TelemetryConfig(), "ring, Zenoh and recording")
    plant: PlantConfig = key(PlantConfig(), "the emulated stage; a rig file for a real stage needs no such table")

    @property
    def period_ns(self) -> int:
        """Control period, ns."""
        return round(1e9 / self.rate_hz)

    @property
    def ring_slots(self) -> int:
        """Ticks that the ring holds: telemetry.blackbox_s of them, and as many as a sidecar may be late."""
        return max(LEAST_RING_SLOTS, math.ceil(self.telemetry.blackbox_s * self.rate_hz))

    @property
    def opening_ticks(self) -> int:
        """Ticks from the first torque until every brake has opened; 0: none has to, or it takes no time."""
        brakes = self.drives.brake
        if not (any(brakes) if isinstance(brakes, list) else brakes):
            return 0
        return math.ceil(self.drives.brake_opening_s * 1e9 / self.period_ns)

    @property
    def mountings(self) -> list[Mounting]:
        """The drives on their axes, in bus order."""
        return [axis.mounting for axis in self.axes.values()]

    @property
    def counts(self) -> list[float]:
        """An encoder count of every axis, m (rad), in bus order."""
        return [axis.encoder_resolution for axis in self.axes.values()]

    @property
    def axis_names(self) -> list[str]:
        """Names in bus order."""
        return list(self.axes)

    @model_validator(mode="after")
    def _whole(self) -> "RigConfig":
        problems = [
            *_length_problems(self),
            *_segment_problems(self),
            *_task_problems(self),
            *_watchdog_problems(self),
            *_opening_problems(self),
            *_sensor_problems(self),
            *clashes(self.outputs),
            *_motion_problems(self),
            *_homing_problems(self),
            *(self.camera.problems(self.axis_names, self.sensors) if self.camera else []),
            *_family_problems(self),
        ]
        if problems:
            raise ValueError("; ".join(problems))
        return self.model_copy(update={"plant": completed(self.plant, self.axes)})


def _is_list_of_tables(kind: object) -> bool:
    entries = get_args(kind) if get_origin(kind) is list else ()
    return any(isinstance(entry, type) and issubclass(entry, BaseModel) for entry in entries)


_LISTS_OF_TABLES = tuple(  # of [plant]; their entries name an axis
    name for name, field in PlantConfig.model_fields.items() if _is_list_of_tables(field.annotation)
)


def _length_problems(rig: RigConfig) -> list[str]:
    n = len(rig.axes)
    tables: list[tuple[str, BaseModel]] = [("plant", rig.plant), ("drives", rig.drives), ("estimator", rig.estimator)]
    if rig.task.injection:
        tables.append(("task.injection", rig.task.injection))
    listed = [(table, name, value, model) for table, model in tables for name, value in model]
    listed += [("estimator.parameters", *item, rig.estimator) for item in rig.estimator.parameters.items()]
    return [
        f"{table}.{name} has {len(value)} values for {n} axes"
        for table, name, value, model in listed
        if isinstance(value, list) and _one_per_axis(table, name, value, model) and len(value) != n
    ]


def _one_per_axis(table: str, name: str, value: list[object], model: BaseModel) -> bool:
    """Whether that list has to have a value for every axis: not the tables, nor what [plant] leaves to [axes]."""
    if table != "plant":
        return True
    return name not in _LISTS_OF_TABLES and name in model.model_fields_set and not (name == "gravity" and not value)


def _segment_problems(rig: RigConfig) -> list[str]:
    """Axes that are on no segment, on two, on one that there is not, or in another order."""
    placed = [axis for segment in rig.bus.segments for axis in segment.axes]
    if not placed or placed == rig.axis_names:
        return []
    return [
        f"bus.segments: axes {', '.join(placed)}; every axis has to be on one segment, in the order of [axes]: "
        f"{', '.join(rig.axis_names)}"
    ]


def _task_problems(rig: RigConfig) -> list[str]:
    names = rig.axis_names
    named = [("task.axes", axis) for axis in rig.task.axes]
    for name in _LISTS_OF_TABLES:
        named += [(f"plant.{name}", entry.axis) for entry in getattr(rig.plant, name) if entry.axis is not None]
    problems = [
        f"{path}: no axis '{axis}'; the axes are {', '.join(names)}" for path, axis in named if axis not in names
    ]
    if len(set(rig.task.axes)) != len(rig.task.axes):
        problems.append(f"task.axes = {rig.task.axes}: an axis twice")
    if rig.task.kind in TWO_AXES and len(rig.task.axes) != 2:
        problems.append(f"task.axes = {rig.task.axes}: a {rig.task.kind} needs two axes")
    return problems or _path_problems(rig)


def _path_problems(rig: RigConfig) -> list[str]:
    """The first point of a path or of waypoints that is beyond an axis' travel, or too fast to get to."""
    task = rig.task
    timed = task.timed
    if not timed and task.kind not in ("waypoints", "spline", "raster"):
        return []
    table, rows = ("task.samples", task.samples) if timed else ("task.waypoints", task.waypoints)
    if task.kind == "raster":
        opposite = [begin + length for begin, length in zip(task.corner, task.size, strict=True)]
        table, rows = "task.corner and task.corner + task.size", [task.corner, opposite]
    if task.repeat and timed:
        counts = [rig.axes[name].encoder_resolution for name in task.axes]
        if any(abs(b - a) > count for a, b, count in zip(rows[0][1:], rows[-1][1:], counts, strict=True)):
            return [f"task.repeat = true: row {len(rows)} of {table} must have the positions of row 1, to a count"]
    for column, name in enumerate(task.axes, 1 if timed else 0):
        limits = rig.axes[name].limits
        for number, row in enumerate(rows, 1):
            where, value = f"{table}: row {number}, column {name}", row[column]
            half = 0.5 * rig.axes[name].encoder_resolution  # what rounds to the limit's own count is at the limit
            if not limits.position[0] - half <= value <= limits.position[1] + half:
                return [f"{where}: {value:.12g} is outside axes.{name}.limits.position = {limits.position}"]
            if timed and number > 1:
                before = rows[number - 2]
                speed = abs(value - before[column]) / (row[0] - before[0])
                if speed > limits.speed:
                    return [f"{where}: {speed:g} /s from the row before, axes.{name}.limits.speed is {limits.speed:g}"]
    return []


def _family_problems(rig: RigConfig) -> list[str]:
    """What the family of the rig's drives finds wrong with it."""
    family = family_of(rig.bus.protocol)
    if family is None or not family.problems:
        return []
    facts = Circumstances(
        rig.bus,
        rig.period_ns * 1e-9,
        rig.rate_hz,
        rig.drives.watchdog_s,
        rig.safety.disable_timeout_ticks,
        {name: axis.limits.speed for name, axis in rig.axes.items()},
        {name: axis.encoder_resolution for name, axis in rig.axes.items()},
    )
    found: list[str] = load(family.problems)(facts)
    return found


def _sensor_problems(rig: RigConfig) -> list[str]:
    """Two nodes of one name or identifier, and emulated sensors that the rig has not."""
    problems = []
    users: dict[int, str] = {}
    for name, sensor in rig.sensors.items():
        if name in (*rig.axes, "host", "drives"):
            problems.append(f"sensors.{name}: an axis, or another node of the bus, has this name; choose another")
        other = users.setdefault(sensor.can_id, name)
        if other != name:
            problems.append(f"sensors.{name}.can_id = {sensor.can_id:#x}: it is the identifier of sensors.{other}, too")
    for number, entry in enumerate(rig.plant.sensors):
        where = f"plant.sensors, entry {number + 1}"
        if entry.sensor not in rig.sensors:
            there = ", ".join(rig.sensors) or "none"
            problems.append(f"{where}: sensor = '{entry.sensor}': no such sensor; those of [sensors] are: {there}")
    return problems


def _motion_problems(rig: RigConfig) -> list[str]:
    """A motion that decides, and a task as well."""
    if rig.motion.name and rig.task.kind != "hold":
        return [f"motion.name = {rig.motion.name!r}: it takes the place of a task; task.kind = {rig.task.kind!r}, "
                "expected 'hold'"]  # fmt: skip
    return []


def _homing_problems(rig: RigConfig) -> list[str]:
    """A drive that moves by itself does so alone: all others are held meanwhile."""
    orders = [axis.home.order for axis in rig.axes.values() if axis.home is not None]
    return [
        f"axes.{name}.home.order = {axis.home.order}: its drive moves it by itself (home.method), so that no other "
        "axis may have that number"
        for name, axis in rig.axes.items()
        if axis.home is not None and axis.home.by_itself and orders.count(axis.home.order) > 1
    ]


def _watchdog_problems(rig: RigConfig) -> list[str]:
    """Every drive would trip between any two commands, and no run could ever become ACTIVE."""
    watchdog_s, period_s = rig.drives.watchdog_s, rig.period_ns * 1e-9
    if watchdog_s > period_s:
        return []
    return [
        f"drives.watchdog_s = {watchdog_s:g}: it must be longer than the {period_s:g} s from one command to the next "
        f"(rate_hz = {rig.rate_hz:g})"
    ]


def _opening_problems(rig: RigConfig) -> list[str]:
    """A brake would open before its axis' weight stands, and drop it by the rest."""
    opening_s = rig.drives.brake_opening_s
    return [
        f"drives.brake_opening_s = {opening_s:g}: by then axes.{name}.limits.force_rate = {axis.limits.force_rate:g} "
        f"lets {axis.limits.force_rate * opening_s:g} N stand, and the axis weighs {abs(axis.model.gravity):g} N"
        for name, axis in rig.axes.items()
        if rig.opening_ticks and abs(axis.model.gravity) > axis.limits.force_rate * opening_s
    ]
