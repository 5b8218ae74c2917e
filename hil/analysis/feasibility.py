"""Whether a task can be done at all: the whole of it, sampled from where the stage stands, held against the limits.

Rules:
- What is held against a limit is the reference and what the nominal model says it takes; nothing is simulated. A law
  that cannot follow a feasible task is a matter for hil/analysis/stability.py.
- Each limit is kept with a stated margin (the constants below): a run has noise, friction that differs from the
  model's, and a controller that needs force of its own.
- The first instant at which a limit is broken is told, with the axis, the value, the limit and the key to change.

Theory of operation: a trajectory gives position, velocity and acceleration of every axis for any instants. Position,
with the way that half the force limit would need to stop from there (the fault monitor's rule), is held against the
travel, velocity against the speed limit. So is mass * acceleration + friction + gravity against the force limit, and
its change from one control period to the next against the force rate. The jump of Coulomb friction where the velocity
changes sign is left out of the rate: it comes at rest, and the gate spreads it over a few periods. Axes do not depend
on each other, so that starting all of them at their lower travel limits, then at the upper ones, covers every corner.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories import Trajectory, plan_task
from hil.control.trajectories.homing import home_position
from hil.control.trajectories.segments import Segments
from hil.rig.schema import RigConfig
from hil.rig.tables import AxisConfig, LimitsConfig, ModelConfig

TRAVEL_MARGIN = 0.5  # of limits.following_error, kept from either end of the travel,
MOST_TRAVEL_MARGIN = 0.05  # but no more of the travel than this
SPEED_MARGIN = 0.05  # of limits.speed
FORCE_MARGIN = 0.15  # of limits.force
RATE_MARGIN = 0.15  # of limits.force_rate
SAMPLES_A_PERIOD = 20  # control periods that an oscillation, or a move from rest to rest, must last at least
CHUNK = 65_536  # instants looked at together

# What a stage that this program is for can have; beyond, a unit is wrong far more often than the stage is strange.
ACCELERATION = (0.05, 1e5)  # force limit over mass, m/s^2 (rad/s^2)
TRAVEL = (1e-6, 20.0)  # m
CROSSING = 1e-3  # s for the whole travel at the speed limit, at least
COUNTS = 100  # of the encoder, within the travel


class Violation(NamedTuple):
    """A limit that a task breaks. value, limit: in `unit`; limit: what remains of it after the margin."""

    axis: str
    quantity: str
    time_s: float  # from the task's start; NaN where it is no matter of time
    value: float
    limit: float
    unit: str
    key: str

    def text(self) -> str:
        """One line for people."""
        when = "" if math.isnan(self.time_s) else f" {self.time_s:.3f} s after the start"
        value = f"{self.quantity} {self.value:.6g} {self.unit}".rstrip()
        return f"axis {self.axis}: {value}{when}, the limit less its margin is {self.limit:.6g}; change {self.key}"


def violations(rig: RigConfig, start: Sequence[float]) -> list[Violation]:
    """What the rig's task breaks when it begins at rest at `start` (m, rad per axis): the first instant of each limit.

    Raises ValueError as plan_task.
    """
    trajectory = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts)(start)
    found: dict[tuple[str, str], Violation] = {}
    for violation in [*too_quick(rig, trajectory), *_along(rig, trajectory)]:
        found.setdefault((violation.axis, violation.quantity), violation)
    return sorted(found.values(), key=lambda violation: (rig.axis_names.index(violation.axis), violation.quantity))


def corner_starts(rig: RigConfig) -> dict[str, list[float]]:
    """Where a task may have to begin, by what people call it: home, and the ends of the travel less the margin."""
    limits = [axis.limits for axis in rig.axes.values()]
    reserves = [travel_margin(li) * (1.0 + 1e-9) for li in limits]  # standing there is feasible
    return {
        "home": home_position(rig),
        "the lower ends of the travel": [li.position[0] + r for li, r in zip(limits, reserves, strict=True)],
        "the upper ends of the travel": [li.position[1] - r for li, r in zip(limits, reserves, strict=True)],
    }


def travel_margin(limits: LimitsConfig) -> float:
    """What is kept from either end of the travel, m (rad)."""
    travel = limits.position[1] - limits.position[0]
    return min(limits.following_error * TRAVEL_MARGIN, travel * MOST_TRAVEL_MARGIN)


def horizon(trajectory: Trajectory) -> int:
    """Task time after which nothing new comes, ns."""
    if trajectory.duration_ns is not None:
        return trajectory.duration_ns
    return trajectory.repeat_from_ns + (trajectory.repeat_ns or 0)


def chunks(trajectory: Trajectory, n_axes: int, period_ns: int) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Instants (s), positions, velocities, accelerations (instants, axes); neighbouring chunks share an instant."""
    count = horizon(trajectory) // period_ns + 2
    for first in range(0, count - 1, CHUNK):
        instants = np.arange(first, min(first + CHUNK + 1, count)) * period_ns
        reference = trajectory.sample(np.repeat(instants[:, None], n_axes, axis=1))
        yield instants.astype(np.float64) * 1e-9, reference.position, reference.velocity, reference.acceleration


def _along(rig: RigConfig, trajectory: Trajectory) -> Iterator[Violation]:
    """Violations of the limits that hold at every instant."""
    for times, positions, velocities, accelerations in chunks(trajectory, len(rig.axes), rig.period_ns):
        for index, (name, axis) in enumerate(rig.axes.items()):
            q, v, a = positions[:, index], velocities[:, index], accelerations[:, index]
            yield from _axis_violations(name, axis, times, (q, v, a), rig.period_ns * 1e-9)


class Measure(NamedTuple):
    """A quantity of a motion beside its limit. values: (instants[, starts]), to be at most `limit`; sign: of both, for
    people. limit: what remains after the margin, in `unit`.
    """

    quantity: str
    values: Array
    limit: float
    sign: float
    unit: str
    key: str


def smooth_force(model: ModelConfig, velocity: Array, acceleration: Array) -> Array:
    """What a motion takes by the nominal model, N, without Coulomb friction; arrays of one shape, m/s and m/s^2."""
    wet = velocity * (model.viscous + model.quadratic * np.abs(velocity))
    return model.mass * acceleration + wet - model.gravity


def measures(name: str, axis: AxisConfig, motion: tuple[Array, Array, Array], period: float) -> list[Measure]:
    """What is held against the limits of an axis. motion: position, velocity, acceleration, each of the shape
    (instants, ...) in m, m/s, m/s^2 (rad); instants one `period` (s) apart.
    """
    position, velocity, acceleration = motion
    limits, model = axis.limits, axis.model
    unit, force_unit = ("m", "N") if axis.kind == "linear" else ("rad", "N m")
    key = f"axes.{name}.limits"
    stop = position + velocity * np.abs(velocity) * model.mass / limits.force
    margin = travel_margin(limits)
    count = axis.encoder_resolution  # a target that is nearer to a limit is at it
    low, high = limits.position[0] + margin - count, limits.position[1] - margin + count
    smooth = smooth_force(model, velocity, acceleration)
    force = np.abs(smooth + model.coulomb * np.sign(velocity))
    change = np.abs(np.diff(smooth, axis=0)) / period
    travel = f"[task] or {key}.position = {limits.position}"
    force_key, rate_key = (f"[task] or {key}.{limit} = {getattr(limits, limit)}" for limit in ("force", "force_rate"))
    rate = limits.force_rate * (1 - RATE_MARGIN)
    return [
        Measure("position", np.maximum(position, stop), high, 1.0, unit, travel),
        Measure("position", -np.minimum(position, stop), -low, -1.0, unit, travel),
        Measure(
            "speed", np.abs(velocity), limits.speed * (1 - SPEED_MARGIN), 1.0, f"{unit}/s",
            f"[task] or {key}.speed = {limits.speed}",
        ),
        Measure("force", force, limits.force * (1 - FORCE_MARGIN), 1.0, force_unit, force_key),
        Measure("force rate", change, rate, 1.0, f"{force_unit}/s", rate_key),
    ]  # fmt: skip


def _axis_violations(
    name: str, axis: AxisConfig, times: Array, motion: tuple[Array, Array, Array], period: float
) -> Iterator[Violation]:
    for quantity, values, limit, sign, unit, key in measures(name, axis, motion, period):
        beyond = np.flatnonzero(~(values <= limit))
        if beyond.size:
            at = int(beyond[0])
            yield Violation(name, quantity, float(times[at]), sign * float(values[at]), sign * limit, unit, key)


def too_quick(rig: RigConfig, trajectory: Trajectory) -> Iterator[Violation]:
    """What a loop of this rate cannot sample finely enough."""
    task, least = rig.task, SAMPLES_A_PERIOD
    if task.kind in ("circle", "lissajous"):
        for name, factor in zip(task.axes, (1, task.ratio if task.kind == "lissajous" else 1), strict=True):
            periods = rig.rate_hz / (task.frequency_hz * factor)
            if periods < least:
                change = f"task.frequency_hz = {task.frequency_hz} or rate_hz = {rig.rate_hz:g}"
                yield Violation(name, "control periods per oscillation", math.nan, periods, least, "", change)
    if isinstance(trajectory, Segments):
        for segment in trajectory.segments:
            periods = segment.duration_ns / rig.period_ns
            moving = [name for name, still in zip(rig.axes, segment.still, strict=True) if not still]
            if segment.duration_ns and periods < least:
                for name in moving:
                    change = f"the durations of [task] or rate_hz = {rig.rate_hz:g}"
                    yield Violation(name, "control periods per move", math.nan, periods, least, "", change)


def unit_questions(rig: RigConfig) -> list[str]:
    """What looks like a unit that is off by thousands, a line each: to be asked back before anything moves."""
    found = []
    for name, axis in rig.axes.items():
        low, high = ACCELERATION
        reach = axis.limits.force / axis.model.mass
        if not low <= reach <= high:
            found.append(
                f"axes.{name}.model.mass = {axis.model.mass:g}: limits.force = {axis.limits.force:g} could accelerate "
                f"it by {reach:.3g} in SI units; expected {low:g} to {high:g}. Is it in grams? It must be in kg "
                "(kg m^2)"
            )
        if axis.model.coulomb > axis.limits.force:
            found.append(
                f"axes.{name}.model.coulomb = {axis.model.coulomb:g}: more than limits.force = {axis.limits.force:g}; "
                "the axis could never move. Is it in millinewtons? It must be in N (N m)"
            )
        if abs(axis.model.gravity) > axis.limits.force:
            found.append(
                f"axes.{name}.model.gravity = {axis.model.gravity:g}: more than limits.force = {axis.limits.force:g}; "
                "the axis could not be held. Is it in millinewtons, or grams? It must be in N (N m)"
            )
        travel = axis.limits.position[1] - axis.limits.position[0]
        if travel / axis.limits.speed < CROSSING:
            found.append(
                f"axes.{name}.limits.speed = {axis.limits.speed:g}: the whole travel of {travel:g} in "
                f"{travel / axis.limits.speed:.2g} s. Is it in mm/s? It must be in m/s (rad/s)"
            )
        if axis.kind == "linear" and not TRAVEL[0] <= travel <= TRAVEL[1]:
            found.append(
                f"axes.{name}.limits.position = {axis.limits.position}: a travel of {travel:g} m. Is it in "
                "millimetres? It must be in m"
            )
        if travel / axis.encoder_resolution < COUNTS:
            found.append(
                f"axes.{name}.encoder_resolution = {axis.encoder_resolution:g}: fewer than {COUNTS} counts within the "
                "travel. Is it in micrometres, or counts per metre? It must be in m (rad) per count"
            )
        elif axis.limits.following_error < axis.encoder_resolution:
            found.append(
                f"axes.{name}.limits.following_error = {axis.limits.following_error:g}: less than a count of the "
                f"encoder, {axis.encoder_resolution:g}. Are both in m (rad)?"
            )
    return found


def task_problems(rig: RigConfig, start: Sequence[float] | None = None) -> list[str]:
    """Why the rig must not move as it is, a line each: units, and its task from `start` (m, rad per axis), else from
    home. Raises ValueError as plan_task.
    """
    place = "home" if start is None else f"{list(start)}"
    found = violations(rig, corner_starts(rig)["home"] if start is None else start)
    return [*unit_questions(rig), *(f"task.kind = {rig.task.kind!r} from {place}: {v.text()}" for v in found)]


def start_notes(rig: RigConfig) -> list[str]:
    """From which ends of the travel the task breaks a limit, a line each; it does not where it begins elsewhere."""
    notes = []
    for place, start in corner_starts(rig).items():
        if place != "home":
            notes += [f"task.kind = {rig.task.kind!r} from {place}: {v.text()}" for v in violations(rig, start)]
    return notes
