"""What every kind of task asks for, from where it begins and at which rate it is sampled."""

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from hil.control.trajectories import make_trajectory
from hil.control.trajectories.base import Trajectory
from hil.control.trajectories.homing import plan_homing
from hil.rig.file import load_rig
from hil.rig.schema import TaskConfig
from tests.golden.golden import sha256
from tests.support.paths import RIGS

MS = 1_000_000
AXES = ["x", "y", "z"]
STARTS = ([0.0, 0.0, 0.0], [0.03, -0.02, 0.01])
POINTS = [[0.0, 0.0], [0.05, 0.02], [0.05, 0.02], [0.01, -0.03]]
CORNERS = [[0.0, 0.01], [0.03, 0.01], [0.03, -0.01], [0.0, 0.01]]
ROWS = [[0.0, 0.0], [0.5, 0.01], [0.75, 0.03], [2.0, 0.0]]
XY = {"axes": ["x", "y"]}
SLOW = {"approach_s": 0.7, "settle_s": 0.2}
BESIDE = {"speed": 0.05, "acceleration": 0.4, "jerk": 20.0}
TASKS: dict[str, dict[str, Any]] = {
    "hold": {"kind": "hold"},
    "circle": {"kind": "circle", **XY, "radius": 0.5, "frequency_hz": 0.5, **SLOW},
    "circle elsewhere": {"kind": "circle", "axes": ["z", "x"], "radius": 0.01, "frequency_hz": 0.3, "phase": 1.0},
    "lissajous": {"kind": "lissajous", **XY, "radius": 0.01, "frequency_hz": 0.3, "ratio": 3, "phase": 0.7},
    "one move": {"kind": "point_to_point", "axes": ["y"], "target": [0.2], "move_s": 0.5, "dwell_s": 0.25},
    "two axes move": {"kind": "point_to_point", "axes": ["z", "x"], "target": [0.1, -0.2], "move_s": 0.3},
    "spiral": {"kind": "spiral", **XY, "radius": 0.01, "turns": 2.0, "move_s": 4.0, **SLOW},
    "spiral and back": {"kind": "spiral", **XY, "radius": 0.01, "turns": 1.5, "move_s": 1.0, "repeat": True},
    "waypoints": {"kind": "waypoints", **XY, "waypoints": POINTS, "dwell_s": 0.1, **BESIDE},
    "waypoints, blended": {"kind": "waypoints", **XY, "waypoints": POINTS, "blend": 5e-3, **SLOW},
    "waypoints, blended, around": {
        "kind": "waypoints", "axes": ["z", "y"], "waypoints": CORNERS, "blend": 1e-2, "repeat": True, "dwell_s": 0.05,
        **BESIDE,
    },
    "waypoints, around": {"kind": "waypoints", **XY, "waypoints": POINTS, "repeat": True, **BESIDE},
    "spline": {"kind": "spline", **XY, "waypoints": [POINTS[0], *POINTS[2:]], **BESIDE},
    "spline, around": {"kind": "spline", "axes": ["y", "x"], "waypoints": CORNERS, "repeat": True, "dwell_s": 0.2},
    "raster": {"kind": "raster", **XY, "corner": [0.0, 0.01], "size": [0.02, 0.01], "lines": 4, **SLOW},
    "raster, blended": {
        "kind": "raster", "axes": ["y", "z"], "corner": [0.01, 0.0], "size": [0.02, 3e-3], "lines": 5, "blend": 1e-3,
        "dwell_s": 0.1, **BESIDE,
    },
    "path": {"kind": "path", "axes": ["y"], "samples": ROWS, **SLOW},
    "path, around": {"kind": "path", "axes": ["z"], "samples": ROWS, "repeat": True},
}  # fmt: skip


PLACES = ([0.0] * 4, [0.001, 0.0, -0.002, 0.1])  # of the four axes of the microscope
OF_THE_MICROSCOPE = ("injection", "homing")
FACTS = ("duration_ns", "repeat_ns", "repeat_from_ns", "steady_from_ns")


def stories() -> list[str]:
    """Their names."""
    return [*TASKS, *OF_THE_MICROSCOPE]


def made(story: str) -> Iterator[tuple[str, Trajectory, int]]:
    """By variant: from rest at home and from elsewhere, at a kilohertz and at a rate that divides nothing; and how many
    axes it has.
    """
    if story in OF_THE_MICROSCOPE:
        rig = load_rig(RIGS / "microscope-ideal.toml")
        home = plan_homing(rig)
        for number, place in enumerate(PLACES):
            plan = home(place) if story == "homing" else make_trajectory(rig.task, list(rig.axes), np.array(place), MS)
            yield f"start {number}", plan, len(place)
        return
    task = TaskConfig.model_validate(TASKS[story])
    for number, start in enumerate(STARTS):
        for period_ns in (MS, 1_234_567):
            yield f"start {number}, {period_ns} ns", make_trajectory(task, AXES, np.array(start), period_ns), len(AXES)


def tell(story: str) -> list[str]:
    """Each variant's times, its phases, and where it is in between."""
    return [f"{variant}: {line}" for variant, trajectory, n_axes in made(story) for line in _lines(trajectory, n_axes)]


def _lines(trajectory: Trajectory, n_axes: int) -> Iterator[str]:
    for fact in FACTS:
        value = getattr(trajectory, fact)
        yield f"{fact.removesuffix('_ns')} {'none' if value is None else f'{value / 1e9:.9g} s'}"
    yield f"phases {', '.join(trajectory.phase_names) or 'none'}"
    ends = _ends(trajectory)
    for t_ns in range(0, ends, ends // 4):
        motion = [[value + 0.0 for value in trajectory.at(axis, t_ns)] for axis in range(n_axes)]
        position, velocity = (", ".join(f"{axis[place]:.6g}" for axis in motion) for place in (0, 1))
        yield f"at {t_ns / 1e9:.6g} s: position {position} m, velocity {velocity} m/s"
    yield f"sha256 {trajectory_hash(trajectory, n_axes)}"


def _ends(trajectory: Trajectory) -> int:
    return (trajectory.duration_ns or 0) + (trajectory.repeat_ns or 0) + trajectory.repeat_from_ns + 100 * MS


def trajectory_hash(trajectory: Trajectory, n_axes: int) -> str:
    """Over what it says of itself, and over phase and motion from before its start to long after its end: at instants
    that fall anywhere, and where its segments meet.
    """
    told = [repr([getattr(trajectory, fact) for fact in (*FACTS, "phase_names")]).encode()]
    ends = _ends(trajectory)
    instants = [-MS, -1, 0, 1, *range(0, ends, ends // 600), ends - 100 * MS, 3 * ends]
    for meeting in (trajectory.duration_ns, trajectory.repeat_ns, trajectory.repeat_from_ns, trajectory.steady_from_ns):
        instants += [meeting - 1, meeting, meeting + 1] if meeting else []
    for t_ns in instants:
        told.append(struct.pack("<qq", t_ns, trajectory.phase_at(t_ns) if t_ns >= 0 else 0))
        for axis in range(n_axes):
            told.append(struct.pack("<3d", *(value + 0.0 for value in trajectory.at(axis, t_ns))))
    return sha256(*told, digits=64)
