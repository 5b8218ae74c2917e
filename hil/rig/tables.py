"""The tables of a rig file that describe the stage's nominal model and the control service; one class a table.

[bus], [wire] and [drives] are in drivers/config.py, [plant] in sim_plant/config.py, [task] in task_tables.py, the whole
file in schema.py. Quantities are in SI units; where an axis is rotary, the unit in brackets holds.
"""

from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import Kind, known, unknown
from drivers.protocols.base import STATUS_NAMES
from drivers.protocols.mounting import Mounting
from hil.rig.error_map_table import ErrorMapConfig
from hil.rig.home_table import HomeConfig
from hil.rig.measured_table import MOST_OTHERS, MeasuredConfig, Tolerances, tolerances
from hil.rig.motion_tables import AxisMotionConfig as AxisMotionConfig
from hil.rig.motion_tables import MotionConfig as MotionConfig
from sim_plant.axis_config import MOST_LOAD
from sim_plant.config import NonNegative, Positive, Resolution

MAX_AXES: Final = 4
LEAST_RATE_HZ = 10
AXIS_NAME = r"^[a-z][a-z0-9_]{0,15}$"


def _status_bit(name: str) -> str:
    if name not in STATUS_NAMES:
        raise ValueError(f"no status bit; allowed: {', '.join(STATUS_NAMES)}")
    return name


Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
StatusBit = Annotated[str, AfterValidator(_status_bit), Field(json_schema_extra={"enum": list(STATUS_NAMES)})]
Mode = Annotated[list[float], Field(min_length=3, max_length=3)]
Ticks = Annotated[int, Field(ge=1, le=10_000)]


class LimitsConfig(Table):
    """[axes.NAME.limits]: what the gate and the fault detectors hold an axis to."""

    position: Interval = key(REQUIRED, "least and greatest position", "m (rad)")
    speed: Positive = key(REQUIRED, "greatest speed", "m/s (rad/s)")
    force: Positive = key(REQUIRED, "greatest force; at most rated_force", "N (N m)")
    force_rate: Positive = key(REQUIRED, "greatest change of the force; zero is never delayed by it", "N/s (N m/s)")
    following_error: Positive = key(REQUIRED, "greatest distance between setpoint and position", "m (rad)")
    oscillation: Positive | None = key(
        None,
        "amplitude of a following error that swings to and fro by itself, 5 Hz to half the rate; not stated: a tenth "
        "of following_error",
        "m (rad)",
    )
    standstill: Positive | None = key(
        None,
        "distance from where it came to rest at which an axis without torque is told to move; not stated: 30 um "
        "(0.3 mrad) and four encoder counts",
        "m (rad)",
    )
    switches: bool = key(
        False,
        "limit switches at both ends, read by the drive: one that closes stops the axis; no force goes beyond",
    )


LEAST_PERIOD = 1e-6  # m (rad)


class ModelConfig(Table):
    """[axes.NAME.model]: the nominal model of an axis, which the laws, the estimator and `hil check` calculate with."""

    mass: Positive = key(REQUIRED, "moving mass (moment of inertia)", "kg (kg m^2)")
    coulomb: NonNegative = key(0.0, "Coulomb friction", "N (N m)")
    viscous: float = key(0.0, "viscous friction", "N s/m (N m s/rad)")
    quadratic: float = key(0.0, "friction times v |v|", "N s^2/m^2 (N m s^2/rad^2)")
    gravity: float = key(0.0, "constant force on the axis; negative pulls towards negative positions", "N (N m)")
    torque_lag: float = key(0.0, "time constant of the force behind its command; 0: none", "s", ge=0, le=0.1)
    mode_frequency_hz: float = key(
        0.0, "at which the tool rings while the motor is held; 0: a rigid axis", "Hz", ge=0, le=5000
    )
    mode_damping: float = key(0.02, "damping ratio of that mode", "1", ge=0, le=1)
    mode_load: float = key(0.3, "fraction of the moving mass that is the tool's", "1", ge=0.001, le=0.95)
    other_modes: list[Mode] = key(
        [],
        "up to two resonances beside it, `[frequency, damping, load]` of each: Hz with the motor held, damping ratio, "
        "fraction of the moving mass",
        "Hz, 1, 1",
        max_length=MOST_OTHERS,
    )
    presliding: list[Positive] = key(
        [],
        "least and greatest Coulomb friction over its stiffness at rest, over which `hil check` tries the loop; an "
        "empty list: none, friction as in the textbook",
        "m (rad)",
        max_length=2,
    )
    friction_period: NonNegative = key(
        0.0,
        "length along the travel with which friction varies, as where rolling elements pass; presliding-kalman learns "
        "it, where it is below 4 table_pitch; 0: none is known",
        "m (rad)",
        exclude_if=lambda value: value == 0.0,
    )

    @model_validator(mode="after")
    def _modes(self) -> "ModelConfig":
        for hertz, damping, load in self.other_modes:
            if not (1.0 <= hertz <= 5000.0 and 0.0 <= damping <= 1.0 and 0.001 <= load <= MOST_LOAD):
                raise ValueError(
                    f"other_modes has [{hertz:g}, {damping:g}, {load:g}]: allowed: 1 to 5000 Hz, a damping ratio of 0 "
                    f"to 1, 0.001 to {MOST_LOAD:g} of the mass"
                )
        whole = sum([load for *_, load in self.other_modes]) + (self.mode_load if self.mode_frequency_hz else 0.0)
        if whole > MOST_LOAD:
            raise ValueError(f"other_modes and mode_load carry {whole:g} of the mass together: at most {MOST_LOAD:g}")
        return self

    @model_validator(mode="after")
    def _a_range(self) -> "ModelConfig":
        if self.presliding and (len(self.presliding) != 2 or self.presliding[0] > self.presliding[1]):
            raise ValueError(f"presliding = {self.presliding}: allowed: [least, greatest], or an empty list")
        if 0.0 < self.friction_period < LEAST_PERIOD:
            raise ValueError(f"friction_period = {self.friction_period}: allowed: 0, or {LEAST_PERIOD} and more")
        return self


class PushConfig(Table):
    """[axes.NAME.push]: the commissioning push before the first task (hil/cycle/commissioning.py)."""

    force: Positive = key(REQUIRED, "force beyond what holds the axis against gravity; above coulomb", "N (N m)")
    distance: Positive = key(REQUIRED, "travel after which the push ends", "m (rad)")
    tolerance: float = key(
        2.0, "greatest ratio between the motion seen and the nominal model's, either way", "1", ge=1.2, le=10
    )


class AxisConfig(Table):
    """[axes.NAME]: one axis of the stage. The order of these tables is the order of the axes on the bus."""

    kind: Literal["linear", "rotary"] = key("linear", "linear: metres and newtons; rotary: radians and newton metres")
    encoder_resolution: Resolution = key(REQUIRED, "length (angle) per encoder count", "m (rad)")
    rated_force: Positive = key(
        REQUIRED,
        "the drive's rated force (torque); full scale of the layouts that carry per mille or counts",
        "N (N m)",
    )
    direction: Literal[1, -1] = key(1, "-1: the drive's positive direction is the axis' negative one", "1")
    gear: Positive = key(
        1.0, "force (torque) at the axis per unit the drive makes: 2 pi / lead for a ball screw", "1 or N/(N m)"
    )
    offset: float = key(0.0, "the axis' position where the drive's is 0", "m (rad)")
    push: PushConfig | None = key(
        None, "see by a small push that force and position have the stated sign and scale, before a task may run"
    )
    must_tell: list[StatusBit] = key(
        [],
        "status bits that the axis' drive has to be able to tell: a layout that has no room for one is refused",
        exclude_if=lambda bits: not bits,
    )
    home: HomeConfig | None = key(None, "how the axis finds its position after power-up; none: the encoder knows it")
    limits: LimitsConfig = key(REQUIRED, "what the gate and the fault detectors hold the axis to")
    model: ModelConfig = key(REQUIRED, "the nominal model of the axis")
    motion: AxisMotionConfig = key(AxisMotionConfig(), "what goals hold the axis to")
    measured: MeasuredConfig | None = key(
        None, "what `hil identify` measured of the model, with half widths", exclude_if=lambda value: value is None
    )
    error_map: ErrorMapConfig | None = key(
        None, "correction of the encoder's scale along the travel", exclude_if=lambda value: value is None
    )

    @model_validator(mode="after")
    def _consistent(self) -> "AxisConfig":
        low, high = self.limits.position
        if low >= high:
            raise ValueError(f"limits.position = {self.limits.position}: the first must be below the second")
        if self.limits.force > self.rated_force:
            raise ValueError(f"limits.force = {self.limits.force} exceeds rated_force = {self.rated_force}")
        if problem := self.motion.problem(self.limits.speed, self.limits.force / self.model.mass):
            raise ValueError(problem)
        held = self.model.coulomb + abs(self.model.gravity)
        if self.home is not None and (problem := self.home.problem(self.limits, held)):
            raise ValueError(problem)
        return self

    @property
    def tolerances(self) -> Tolerances:
        """By how much the model may be off: as measured, else as is usual."""
        return tolerances(self.model, self.measured)

    @property
    def mounting(self) -> Mounting:
        """The drive on this axis."""
        return Mounting(self.direction, self.gear, round(self.offset / self.encoder_resolution))


class LawConfig(Table):
    """[law]: which control law, with which gains."""

    name: str = key("pd-feedforward", "the law: its name, package.module:Class, or ./file.py:Class beside the rig file")
    gains: dict[str, Any] = key({}, "gains of the law `name`, one number or one per axis; they override tuned ones")
    tuned: dict[str, dict[str, Any]] = key({}, "[law.tuned.LAW]: the gains `hil tune` found, per law")
    iterative_learning: bool = key(False, "learn from repetition: the task is one that repeats")
    learnt: str = key(
        "",
        "what the law begins with: a file of `hil learnt RUN` or `hil identify --write`, beside the rig file; "
        '"": nothing',
    )
    learnt_on: str = key("", "hash of what it was learnt on; filled in when the rig is loaded")
    learnt_state: list[list[float]] = key([], "content of that file, by axis; filled in when the rig is loaded", "1")
    source: str = key(
        "", "of a law of your own: its file's text, or its package's digest; filled in when the rig is loaded"
    )

    @property
    def keeps(self) -> bool:
        """Whether a live run keeps what this law learns (hil/live/kept_learnt.py): it has a state, of no named file."""
        return bool(self.learnt_state) and not self.learnt

    def effective_gains(self) -> dict[str, Any]:
        """Tuned gains of the named law, overridden by `gains`."""
        return {**self.tuned.get(self.name, {}), **self.gains}


# Our own estimator stays where a user's is named, for all but the law. A user's is a class like hil.Estimator.
ESTIMATORS: dict[str, str] = {"motion-filter": "hil.control.estimator.motion_filter:MotionFilter"}
ESTIMATOR_KIND = Kind("estimator", "estimators", "estimator", "name", "hil.estimators", ESTIMATORS, ("reset", "update"))


class EstimatorConfig(Table):
    """[estimator]: the Kalman filter on position, velocity and disturbance force, per axis; what else the law sees."""

    name: str = key(
        "motion-filter",
        f"what tells the law position and velocity: {', '.join(ESTIMATORS)}; or an estimator of your own: its "
        "registered name, package.module:Class, or ./file.py:Class beside the rig file",
    )
    parameters: dict[str, Any] = key(
        {}, "of an estimator of your own: what its class takes; a list has a value for each axis"
    )
    source: str = key(
        "", "of such an estimator: its file's text, or its package's digest; filled in when the rig is loaded"
    )
    disturbance_noise: Positive | list[Positive] = key(10.0, "random walk of the disturbance force", "N/sqrt(s)")
    acceleration_noise: NonNegative | list[NonNegative] = key(0.0, "noise of the acceleration", "m/s^2/sqrt(Hz)")
    measurement_floor: Positive = key(
        29e-9, "the measurement noise assumed is never below this, whatever the encoder's resolution", "m (rad)"
    )

    @property
    def is_users(self) -> bool:
        """Whether the law sees an estimator that users bring."""
        return self.name not in ESTIMATORS

    def parameters_of(self, axis: int) -> dict[str, Any]:
        """Of one axis."""
        return {name: value[axis] if isinstance(value, list) else value for name, value in self.parameters.items()}

    @model_validator(mode="after")
    def _known(self) -> "EstimatorConfig":
        if not self.source and not known(ESTIMATOR_KIND, self.name):  # with it, a recording of a package not here
            raise ValueError(unknown(ESTIMATOR_KIND, self.name))
        if self.parameters and not self.is_users:
            raise ValueError(f"parameters: of an estimator of your own; name = {self.name!r} takes none")
        return self


class TimingConfig(Table):
    """[timing]: what the control process asks of the kernel."""

    realtime: bool = key(True, "real-time scheduling (SCHED_FIFO) for the control loop")
    priority: int = key(80, "its priority", "1", ge=1, le=99)
    cpu: int = key(-1, "the processor it stays on; -1: the last one this process may use", "1", ge=-1, le=1023)
    lock_memory: bool = key(True, "keep the process in memory")
    dma_latency: bool = key(True, "keep the processors from deep sleep (/dev/cpu_dma_latency)")
    wake_ahead_s: float = key(
        5e-5, "most to wait awake before a tick, within an eighth of a period", "s", ge=0, le=1e-4
    )
    allow_degraded: bool = key(
        False, "run although the kernel refused something of the above, and say so everywhere; otherwise refuse"
    )


class TelemetryConfig(Table):
    """[telemetry]: ring, Zenoh and recording. Nothing listens beyond loopback unless `listen` says so."""

    listen: list[str] = key(["tcp/127.0.0.1:7447"], "Zenoh endpoints the sidecar listens on")
    publish_hz: float = key(50.0, "batches of telemetry a second", "Hz", gt=0, le=1000)
    blackbox_s: float = key(
        60.0, "time the ring holds, which is the black box; a tick takes 5 KB of memory", "s", ge=1, le=600
    )
    record: bool = key(True, "record every run")
    record_part_size: int = key(500_000_000, "a file that is larger is followed by another", "B", ge=100_000, le=2**40)
    record_part_s: float = key(3600.0, "a file that is older is followed by another", "s", ge=1, le=604800)
    record_quota: int = key(
        20_000_000_000,
        "most that recordings, snapshots of faults and black boxes take; the oldest go",
        "B",
        ge=1_000_000,
        le=2**50,
    )
    recording_required: bool = key(False, "without a working recorder a new ACTIVE is refused")
    # The last: in what follows in this class the name would hide the function.
    key: Annotated[str, Field(pattern=r"^[a-z0-9_-]+(/[a-z0-9_-]+)*$")] = key("hil", "prefix of all Zenoh keys")


class SafetyConfig(Table):
    """[safety]: thresholds of the fault detectors (hil/cycle/fault_monitor.py); docs/faults.md has the reactions."""

    silent_stop_ticks: Ticks = key(3, "without an answer of an axis: damped stop", "ticks")
    silent_zero_ticks: Ticks = key(10, "without an answer of an axis: zero torque", "ticks")
    bad_frame_limit: Ticks = key(5, "damaged frames that are a fault (a leaky bucket)", "frames")
    bad_frame_leak_ticks: Ticks = key(100, "one damaged frame is forgiven per so many ticks", "ticks")
    jump_margin: Positive = key(1.5, "greatest step between two samples, in steps at the speed limit", "1")
    stuck_ticks: Ticks = key(50, "the position does not change for so long under force: a fault", "ticks")
    stuck_force_fraction: float = key(0.6, "of the force limit; the least force that counts for it", "1", gt=0, le=1)
    nis_limit: Positive = key(1e6, "normalised innovation squared of the filter that counts as implausible", "1")
    nis_ticks: Ticks = key(20, "consecutive ticks above it that are a fault", "ticks")
    transmit_refused_limit: Ticks = key(3, "consecutive ticks whose command the bus refused that are a fault", "ticks")
    flood_frames: int = key(12, "frames received in one tick that are a fault", "frames", ge=8, le=1000)
    overrun_streak: Ticks = key(5, "consecutive late ticks that are a fault", "ticks")
    overrun_zero_s: Positive = key(0.02, "more than this between two ticks: zero torque", "s")
    stop_s: float = key(0.05, "a damped stop ends within this", "s", gt=0, le=0.5)
    heartbeat_s: NonNegative = key(0.0, "the operator's heartbeat must come within this; 0: none is asked for", "s")
    command_expiry_s: Positive = key(0.5, "an operator's command older than this is refused", "s")
    enable_timeout_ticks: Ticks = key(500, "most a drive may take to enable torque", "ticks")
    disable_timeout_ticks: Ticks = key(
        50, "most a drive may take to disable torque, its brake's delay included", "ticks"
    )
    ready_ticks: Ticks = key(20, "consecutive ticks with fresh answers of all axes before READY", "ticks")
