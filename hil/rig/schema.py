"""The rig file: one TOML document, validated whole before any bus is opened, frozen afterwards."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, model_validator

from drivers.config import STRICT, BusConfig, WireConfig
from sim_plant.config import PlantConfig, Resolution

MAX_AXES = 4
LEAST_RATE_HZ = 10
AXIS_NAME = r"^[a-z][a-z0-9_]{0,15}$"

# Of any quantity, in SI units. Beyond, the quotient of two can be zero or infinite, and a tick would divide by it.
Positive = Annotated[float, Field(ge=1e-15, le=1e15)]
NonNegative = Annotated[float, Field(ge=0, le=1e15)]
Duration = Annotated[float, Field(gt=0, le=1e6)]  # s; a thousand cells of the longest still fit 64 bits of ns
Pause = Annotated[float, Field(ge=0, le=1e6)]  # s
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
Ticks = Annotated[int, Field(ge=1, le=10_000)]


class RigError(Exception):
    """A rig file (or an override of it) that cannot be used; `problems` holds one line per problem."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = list(problems)


class LimitsConfig(BaseModel):
    """What the gate and the detectors hold an axis to; m, m/s, N, N/s (rad, rad/s, N m, N m/s for rotary axes)."""

    model_config = STRICT
    position: Interval
    speed: Positive
    force: Positive
    force_rate: Positive
    following_error: Positive


class ModelConfig(BaseModel):
    """Nominal belief about one axis: kg, N, N s/m, N s^2/m^2, N (rotary: kg m^2, N m, ...)."""

    model_config = STRICT
    mass: Positive
    coulomb: NonNegative = 0.0
    viscous: float = 0.0
    quadratic: float = 0.0
    gravity: float = 0.0  # constant force on the axis, as in [plant]


class AxisConfig(BaseModel):
    """One axis of the stage."""

    model_config = STRICT
    kind: Literal["linear", "rotary"] = "linear"
    encoder_resolution: Resolution  # m or rad per count
    rated_force: Positive  # N or N m; full scale of the bus layouts that carry per-mille or counts
    # At zero torque: free to move, or held by its brake. For whoever reads the file: the drive does it, nothing here
    # acts on it, and the emulated drive goes by plant.brake.
    safe: Literal["release", "brake"] = "release"
    limits: LimitsConfig
    model: ModelConfig

    @model_validator(mode="after")
    def _consistent(self) -> "AxisConfig":
        low, high = self.limits.position
        if low >= high:
            raise ValueError(f"limits.position = {self.limits.position}: the first must be below the second")
        if self.limits.force > self.rated_force:
            raise ValueError(f"limits.force = {self.limits.force} exceeds rated_force = {self.rated_force}")
        return self


class LawConfig(BaseModel):
    """[law]: which law, with which gains. `gains` belong to `name`; `tuned` holds what `hil tune` found, per law."""

    model_config = STRICT
    name: str = "pd-feedforward"
    gains: dict[str, Any] = {}
    tuned: dict[str, dict[str, Any]] = {}
    iterative_learning: bool = False  # wrap the law for repeated tasks
    source: str = ""  # text of the law's file, where name is './file.py:Class'; read in when the rig file is loaded

    def effective_gains(self) -> dict[str, Any]:
        """Tuned gains of the named law, overridden by `gains`."""
        return {**self.tuned.get(self.name, {}), **self.gains}


class EstimatorConfig(BaseModel):
    """[estimator]: the rig's Kalman filter on [position, velocity, disturbance], per axis."""

    model_config = STRICT
    disturbance_noise: Positive | list[Positive] = 10.0  # N/sqrt(s), random walk of the disturbance force
    acceleration_noise: NonNegative | list[NonNegative] = 0.0  # m/s^2/sqrt(Hz)
    measurement_floor: Positive = 29e-9  # m; the noise assumed is never below this, whatever the encoder's resolution


class TaskConfig(BaseModel):
    """[task]: what the stage is to do once ACTIVE."""

    model_config = STRICT
    kind: Literal["hold", "circle", "point_to_point", "lissajous", "injection"] = "hold"
    axes: list[str] = []  # circle, lissajous: the two axes; point_to_point: those that move
    radius: Positive = 1.0  # m; circle, lissajous: amplitude
    frequency_hz: Annotated[float, Field(ge=1e-6, le=1e4)] = 0.5  # of the first axis
    ratio: Annotated[int, Field(ge=1, le=16)] = 2  # lissajous: second axis' frequency over the first's
    phase: float = 0.0  # rad
    approach_s: Duration = 2.0  # minimum-jerk approach to the figure
    settle_s: Pause = 6.0  # after the approach; statistics start then
    target: list[float] = []  # point_to_point: m, per axis in `axes`
    move_s: Duration = 1.0  # point_to_point: duration of one move
    dwell_s: Pause = 0.5  # point_to_point: rest between moves
    injection: "InjectionConfig | None" = None

    @model_validator(mode="after")
    def _complete(self) -> "TaskConfig":
        if self.kind == "injection" and self.injection is None:
            raise ValueError("kind = 'injection' needs a table [task.injection]")
        if self.kind == "point_to_point" and self.target and len(self.target) != len(self.axes):
            raise ValueError(f"target has {len(self.target)} values for {len(self.axes)} axes")
        return self


class InjectionConfig(BaseModel):
    """[task.injection]: the paper's section 2.1 over a row of cells. Positions in m (rad), in the order of [axes]."""

    model_config = STRICT
    home: list[float]  # q_a
    focal: list[float]  # q_b, within the focal range, beside the first cell
    start: list[float]  # q_s of the first cell: where the pipette starts to accelerate
    contact: list[float]  # q_c of the first cell; speed is greatest here
    end: list[float]  # q_d of the first cell: at rest inside
    pitch: list[float]  # from one cell to the next
    cells: Annotated[int, Field(ge=1, le=1000)] = 3
    approach_s: Duration = 2.0  # q_a -> q_b
    transfer_s: Duration = 0.6  # q_b -> q_s, and from cell to cell
    strike_s: Duration = 0.25  # q_s -> q_c -> q_d
    contact_speed: Positive = 0.01  # m/s along the line q_s -> q_d
    dwell_s: Duration = 1.0  # inject
    withdraw_s: Duration = 0.6


class TimingConfig(BaseModel):
    """[timing]: what the control process asks of the kernel."""

    model_config = STRICT
    realtime: bool = True
    priority: Annotated[int, Field(ge=1, le=99)] = 80  # SCHED_FIFO
    cpu: Annotated[int, Field(ge=-1, le=1023)] = -1  # -1: the last one this process may use
    lock_memory: bool = True
    dma_latency: bool = True
    wake_ahead_s: Annotated[float, Field(ge=0, le=1e-4)] = 5e-5  # most to wait awake, within an eighth of a period
    allow_degraded: bool = False  # run although the kernel refused something of the above, and say so everywhere


class TelemetryConfig(BaseModel):
    """[telemetry]: ring, Zenoh and recording. Nothing listens beyond loopback unless `listen` says so."""

    model_config = STRICT
    listen: list[str] = ["tcp/127.0.0.1:7447"]
    key: Annotated[str, Field(pattern=r"^[a-z0-9_-]+(/[a-z0-9_-]+)*$")] = "hil"
    publish_hz: Annotated[float, Field(gt=0, le=1000)] = 50.0  # batches a second
    ring_slots: Annotated[int, Field(ge=256, le=65536)] = 4096
    record: bool = True
    recording_required: bool = False  # without a working recorder a new ACTIVE is refused


class SafetyConfig(BaseModel):
    """[safety]: thresholds of hil/cycle/fault_monitor.py, in ticks unless named otherwise."""

    model_config = STRICT
    silent_stop_ticks: Ticks = 3
    silent_zero_ticks: Ticks = 10
    bad_frame_limit: Ticks = 5
    bad_frame_leak_ticks: Ticks = 100  # one bad frame is forgiven per so many ticks
    jump_margin: Positive = 1.5  # of the speed limit, between two samples
    stuck_ticks: Ticks = 50
    stuck_force_fraction: Annotated[float, Field(gt=0, le=1)] = 0.6  # of the force limit
    nis_limit: Positive = 1e6  # normalised innovation squared
    nis_ticks: Ticks = 20
    transmit_refused_limit: Ticks = 3
    flood_frames: Annotated[int, Field(ge=8, le=1000)] = 12  # received in one tick
    overrun_streak: Ticks = 5
    overrun_zero_s: Positive = 0.02
    stop_s: Annotated[float, Field(gt=0, le=0.5)] = 0.05  # a damped stop ends within this
    heartbeat_s: NonNegative = 0.0  # operator heartbeat; 0: none asked for
    command_expiry_s: Positive = 0.5
    enable_timeout_ticks: Ticks = 500
    disable_timeout_ticks: Ticks = 50  # longer than a drive takes to let go, its brake's delay included
    ready_ticks: Ticks = 20  # consecutive fresh ticks of all axes before READY


class RigConfig(BaseModel):
    """A whole rig file."""

    model_config = STRICT
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$")]
    description: str = ""
    rate_hz: Annotated[float, Field(ge=LEAST_RATE_HZ, le=10_000)] = 1000.0
    axes: Annotated[
        dict[Annotated[str, Field(pattern=AXIS_NAME)], AxisConfig], Field(min_length=1, max_length=MAX_AXES)
    ]
    law: LawConfig = LawConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    task: TaskConfig = TaskConfig()
    bus: BusConfig = BusConfig()
    wire: WireConfig = WireConfig()
    timing: TimingConfig = TimingConfig()
    safety: SafetyConfig = SafetyConfig()
    telemetry: TelemetryConfig = TelemetryConfig()
    plant: PlantConfig

    @property
    def period_ns(self) -> int:
        """Control period, ns."""
        return round(1e9 / self.rate_hz)

    @property
    def axis_names(self) -> list[str]:
        """Names in bus order."""
        return list(self.axes)

    @model_validator(mode="after")
    def _per_axis_lengths(self) -> "RigConfig":
        problems = [*_length_problems(self), *_task_problems(self), *_watchdog_problems(self)]
        if problems:
            raise ValueError("; ".join(problems))
        return self


_MAY_BE_EMPTY = ("gravity",)


def _length_problems(rig: RigConfig) -> list[str]:
    n = len(rig.axes)
    tables: list[tuple[str, BaseModel]] = [("plant", rig.plant), ("estimator", rig.estimator)]
    if rig.task.injection:
        tables.append(("task.injection", rig.task.injection))
    return [
        f"{table}.{key} has {len(value)} values for {n} axes"
        for table, model in tables
        for key, value in model
        if isinstance(value, list) and key != "cells" and len(value) != n and (value or key not in _MAY_BE_EMPTY)
    ]


def _task_problems(rig: RigConfig) -> list[str]:
    names = rig.axis_names
    named = [("task.axes", axis) for axis in rig.task.axes] + [("plant.cells", cell.axis) for cell in rig.plant.cells]
    problems = [f"{key}: no axis '{axis}'; the axes are {', '.join(names)}" for key, axis in named if axis not in names]
    if rig.task.kind in ("circle", "lissajous") and len(rig.task.axes) != 2:
        problems.append(f"task.axes = {rig.task.axes}: a {rig.task.kind} needs two axes")
    return problems


def _watchdog_problems(rig: RigConfig) -> list[str]:
    """Every drive would trip between any two commands, and no run could ever become ACTIVE."""
    watchdog_s, period_s = rig.plant.watchdog_s, rig.period_ns * 1e-9
    if watchdog_s > period_s:
        return []
    return [
        f"plant.watchdog_s = {watchdog_s:g}: it must be longer than the {period_s:g} s from one command to the next "
        f"(rate_hz = {rig.rate_hz:g})"
    ]
