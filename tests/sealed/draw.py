"""Draws faults: kind, axis, instant and size, for the shipped rigs. Nothing else knows the ranges."""

import random
from collections.abc import Callable
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.control.trajectories import make_trajectory
from hil.cycle.tick import CycleResult, Tick
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.sim import simulate
from sim_plant.scenario.language import FaultConfig, Scenario
from tests.support.paths import RIGS

FAULT_RIGS: Final = ("microscope", "microscope", "microscope-ideal", "paper")  # as often as named
SOUND_RIGS: Final = (
    "microscope", "microscope", "microscope", "microscope-ideal", "microscope-ideal", "paper", "paper", "cubemars",
    "damiao", "moteus", "odrive", "robstride", "vesc",
)  # fmt: skip
BEGINS_S: Final = (4.0, 11.0)  # when the fault comes
AFTER_S: Final = 4.0  # and how long the run goes on
SOUND_S: Final = 12.0
WITHIN_S: Final = 2.5  # a fault that shows in motion alone is drawn where motion is about to come
CREEPING: Final = 0.05  # of the axis' top speed
BEGUN_S: Final = 0.06  # until every task has begun


class Case(NamedTuple):
    """One run. seed: of the emulated stage. kind: of the fault; "" of a sound run. axis: "" of all. shows_s: when it
    can be seen. more: kinds and values that the same scenario sets besides.
    """

    rig: str
    seed: int
    seconds: float
    kind: str = ""
    axis: str = ""
    at_s: float = 0.0
    shows_s: float = 0.0
    value: float | None = None
    more: tuple[tuple[str, float], ...] = ()

    @property
    def config(self) -> RigConfig:
        """The rig with the seed."""
        return load_rig(RIGS / f"{self.rig}.toml", [f"plant.seed={self.seed}", f"wire.seed={self.seed}"])

    @property
    def scenario(self) -> Scenario | None:
        """The fault in the scenario language."""
        if not self.kind:
            return None
        whose: dict[str, Any] = {"node": self.axis} if self.kind.startswith("wire_") else {"axis": self.axis or None}
        values = (*self.more, (self.kind, self.value))
        return Scenario(fault=[FaultConfig(kind=kind, value=value, at_s=self.at_s, **whose) for kind, value in values])


class _Axis(NamedTuple):
    """What sizes are drawn by, SI units. resolution: a count. top: largest speed of the task."""

    resolution: float
    dry: float
    force: float
    mass: float
    top: float


class _Kind(NamedTuple):
    """size: of what is drawn; None: the kind takes none. moving: it shows in motion alone. more: what else is set."""

    size: Callable[[random.Random, _Axis], float] | None = None
    moving: bool = False
    more: Callable[[random.Random, _Axis], tuple[str, float]] | None = None


def _counts(low: float, high: float) -> Callable[[random.Random, _Axis], float]:
    return lambda draw, axis: axis.resolution * draw.uniform(low, high)


def _period(draw: random.Random, axis: _Axis) -> float:
    """Of an encoder's error: short enough that no loop follows it, and several samples long at full speed."""
    return max(axis.resolution * draw.uniform(2000, 4000), axis.top * draw.uniform(0.004, 0.012))


KINDS: Final[dict[str, _Kind]] = {
    "encoder_silent": _Kind(),
    "encoder_stuck": _Kind(moving=True),
    "encoder_jump": _Kind(lambda draw, axis: draw.choice((-1, 1)) * axis.resolution * draw.uniform(2000, 50000)),
    "encoder_noise": _Kind(_counts(60, 400)),
    "encoder_fault": _Kind(),
    "drive_fault": _Kind(),
    "drive_watchdog": _Kind(),
    "stale_feedback": _Kind(lambda draw, axis: float(draw.randint(3, 20))),
    "duplicate_feedback": _Kind(),
    "wrong_sequence": _Kind(lambda draw, axis: float(draw.randint(3, 100))),
    "bad_checksum": _Kind(),
    "garbage": _Kind(),
    "clock_jump": _Kind(lambda draw, axis: draw.choice((-1, 1)) * draw.uniform(0.05, 0.5)),
    "torque_constant": _Kind(lambda draw, axis: draw.uniform(0.3, 0.6), moving=True),
    "axis_jam": _Kind(lambda draw, axis: axis.dry * draw.uniform(1.5, 3.0), moving=True),
    "push": _Kind(lambda draw, axis: draw.choice((-1, 1)) * (axis.dry + axis.force * draw.uniform(0.1, 0.3))),
    "plant_encoder_noise": _Kind(_counts(30, 200)),
    "plant_encoder_periodic_error": _Kind(
        _counts(150, 800),
        moving=True,
        more=lambda draw, axis: ("plant_encoder_period", _period(draw, axis)),
    ),
    "plant_vibration": _Kind(
        lambda draw, axis: min(axis.dry / axis.mass * draw.uniform(1.5, 4.0), 100.0),  # less, and dry friction holds it
        more=lambda draw, axis: ("plant_vibration_frequency", draw.uniform(20.0, 90.0)),
    ),
    "wire_no_ack": _Kind(),
}


def draw_fault(draw: random.Random, kind: str = "") -> Case:
    """One run with a fault. kind: of this kind."""
    kind = kind or draw.choice(sorted(KINDS))
    while True:
        rig = draw.choice(FAULT_RIGS)
        seed = _seed(draw)
        config, begins_s, speeds = _planned(rig, seed)
        number = draw.randrange(len(config.axes))
        at_s = round(draw.uniform(*BEGINS_S), 4)
        shows_s = _shows_s(speeds[number], begins_s, at_s) if KINDS[kind].moving else at_s
        if shows_s <= at_s + WITHIN_S:
            break
    name, of = config.axis_names[number], list(config.axes.values())[number]
    axis = _Axis(of.encoder_resolution, of.model.coulomb, of.limits.force, of.model.mass, float(speeds[number].max()))
    size, _, besides = KINDS[kind]
    value = None if size is None else size(draw, axis)
    more = (besides(draw, axis),) if besides else ()
    return Case(rig, seed, round(shows_s + AFTER_S, 3), kind, name, at_s, shows_s, value, more)


def _seed(draw: random.Random) -> int:
    return draw.randrange(1, 2**31)


@cache
def _planned(rig: str, seed: int) -> tuple[RigConfig, float, Any]:
    """The rig; when its task begins, s; the task's speeds at each ms from there, (n_axes, n)."""
    config = Case(rig, seed, 0.0).config
    names = config.axis_names
    begins_s, stands = _begins(config)
    task = make_trajectory(config.task, names, stands, config.period_ns, config.counts)
    times = np.arange(0, round((BEGINS_S[1] + AFTER_S) * 1e9), 1_000_000)
    return config, begins_s, np.abs([task.sample_axis(axis, times)[1] for axis in range(len(names))])


def _begins(config: RigConfig) -> tuple[float, NDArray[np.float64]]:
    """When the task begins, s; where the axes stand then, (n_axes,), m (rad): beside home by a count, they approach."""
    found: list[tuple[float, NDArray[np.float64]]] = []

    def observe(tick: Tick, _frames: object, result: CycleResult) -> None:
        if result.record["task_ns"] >= 0:
            found.append(
                (tick.index * config.period_ns * 1e-9, result.record["setpoint_position"][: len(config.axes)].copy())
            )

    simulate(config, RIGS, BEGUN_S, observer=observe)
    return found[0]


def _shows_s(speed: Any, begins_s: float, at_s: float) -> float:
    seconds = begins_s + np.arange(len(speed)) * 1e-3
    moving = np.flatnonzero((seconds >= at_s) & (speed > CREEPING * speed.max()))
    return round(float(seconds[moving[0]]), 3) if len(moving) else float("inf")


def draw_sound(draw: random.Random) -> Case:
    """One run without a fault."""
    return Case(draw.choice(SOUND_RIGS), _seed(draw), SOUND_S)
