"""What a rig is told before anything runs, kept as text in tests/reference/checks.json: its bus, its loop, its task.

python -m tests.support.reference checks     renew the file, after a change that is meant to change what is found

Numbers of the loop have four digits: they come from matrix libraries that differ in the last ones.
"""

import json
import math
from typing import Any

import numpy as np

from drivers.config import LAYOUTS
from hil.control.feasibility import corner_starts, start_notes, task_problems, unit_questions, violations
from hil.control.frequency_response import loop_response
from hil.control.learning_check import check_learning
from hil.control.loop_corners import check_corners
from hil.control.stability import check_stability
from hil.control.start_ranges import start_ranges
from hil.operate.check import as_json
from hil.rig.bus_load import analyse_rig, emulation_notes, feedback_notes, highest_rate, layout_warnings, problems
from hil.rig.difference import rig_differences
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.file import load_rig
from hil.rig.plant_notes import encoder_notes, plant_notes
from hil.rig.scaffold import AxisSketch, Sketch, dbc_text, rig_text
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS, ROOT

FILE = ROOT / "tests" / "reference" / "checks.json"

BUSES: dict[str, tuple[str, list[str]]] = {
    **{name: (name, []) for name in ("paper", "paper-dbc", "microscope", "moteus", "odrive", "vesc")},
    **{
        f"microscope, {layout} at {rate} Hz": ("microscope", [f"bus.protocol={layout}", f"rate_hz={rate}"])
        for layout in LAYOUTS if ":" not in layout
        for rate in (500, 1000, 2000)
    },
    "paper, slow bus": ("paper", ["bus.bitrate=500000", "bus.data_bitrate=2000000", "rate_hz=2500"]),
    "paper, classic": ("paper", ["bus.protocol=stage_classic", "bus.bitrate=250000"]),
    "odrive, slower": ("odrive", ["rate_hz=250"]),
    "coarse encoder": ("paper", ["axes.x.encoder_resolution=1e-3", "axes.y.encoder_resolution=1e-12"]),
}  # fmt: skip

REAL = [
    "axes.x.model.torque_lag=2e-4", "axes.y.model.torque_lag=1e-4",
    "axes.x.model.mode_frequency_hz=150", "axes.x.model.mode_damping=0.02",
    "axes.x.model.presliding=[1e-6, 1e-5]", "axes.y.model.presliding=[3e-7, 3e-5]",
]  # fmt: skip
LOOPS: dict[str, list[str]] = {
    "pd": ["law.name=pd-feedforward"],
    "pd, 500 Hz": ["law.name=pd-feedforward", "rate_hz=500"],
    "pd, the paper's gains": ["law.gains.kp=[3000, 3500]", "law.gains.kd=[20, 25]"],
    "pd, lag, mode, presliding": REAL,
    "slotine-li": ["law.name=slotine-li"],
    "disturbance-observer, lag, mode, presliding": ["law.name=disturbance-observer", *REAL],
}

MOVE = ["task.kind=point_to_point", 'task.axes=["x"]']
TASKS: dict[str, list[str]] = {
    "as shipped": [],
    "a circle": ["task.kind=circle", 'task.axes=["x", "y"]', "task.radius=0.002", "task.frequency_hz=1.0"],
    "a circle that is too quick": [
        "task.kind=circle", 'task.axes=["x", "y"]', "task.radius=0.01", "task.frequency_hz=30.0", "task.approach_s=0.2"
    ],
    "a figure that is not sampled": [
        "task.kind=lissajous", 'task.axes=["x", "y"]', "task.radius=1e-5", "task.frequency_hz=40.0", "task.ratio=3"
    ],
    "a far move": [*MOVE, "task.target=[0.02]", "task.move_s=0.1"],
    "a move beyond the travel": [*MOVE, "task.target=[0.2]", "task.move_s=2.0", "task.dwell_s=0.1"],
    "a move of a few ticks": [*MOVE, "task.target=[1e-6]", "task.move_s=0.005"],
    "units off": ["axes.x.model.mass=5e6", "axes.y.model.coulomb=400", "axes.z.limits.speed=5e3"],
    "a raster": [
        "task.kind=raster", 'task.axes=["x", "y"]', "task.corner=[0, 0]", "task.size=[0.02, 0.01]", "task.lines=3"
    ],
}  # fmt: skip

PLAIN = AxisSketch("x", 0.5, 0.05, 1e-8, 10.0, 0.3)
TURNING = AxisSketch("turn", 1e-4, 1.0, 1e-6, 0.1, 0.0, rotary=True)
SKETCHES = {
    "one axis": Sketch("one", (PLAIN,)),
    "weak and turning": Sketch("weak", (PLAIN._replace(force=0.1), TURNING)),
    "upright, slow": Sketch("tall", (PLAIN._replace(name="z", vertical=True),), "stage_classic", 250.0, 0.05),
    "by a dbc": Sketch("bound", (PLAIN, PLAIN._replace(name="z", travel=0.3, vertical=True)), "dbc", dbc="bound.dbc"),
    "moteus": Sketch("motors", (PLAIN, PLAIN._replace(name="y", encoder=2e-7, friction=0.0)), "moteus"),
}  # fmt: skip


def rounded(value: Any) -> Any:
    """As JSON has it, floats to four digits; poles left out but for the largest's size."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items() if key != "poles"}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else str(value)
    return value


def bus_of(rig: RigConfig) -> dict[str, Any]:
    """What its wire carries, and what is said of it."""
    analysis = analyse_rig(rig, RIGS)
    notes = [encoder_notes(rig), plant_notes(rig), emulation_notes(rig), feedback_notes(rig, RIGS)]
    return {
        **as_json(analysis),
        "tightest": analysis.tightest.frame,
        "highest_rate": highest_rate(rig, RIGS),
        "notes": [note for part in (*notes, layout_warnings(rig, RIGS)) for note in part],
        "problems": [*problems(rig, RIGS, analysis), *encoder_range_problems(rig, RIGS)],
    }


def loop_of(rig: RigConfig) -> dict[str, Any]:
    """What its loop bears; of one that is stable, corners and frequency response, too."""
    found = check_stability(rig)
    told = {**found.as_json(), "problems": found.problems(), "learning": [one.as_json() for one in check_learning(rig)]}
    if not found.stable:
        return told
    response = loop_response(rig)
    parts = response.frequency_hz, *abs(response.loop).T, *abs(response.plant).T, *np.angle(response.loop).T
    corners = check_corners(rig)
    said = [text for corner in corners for text in (corner.lacks(), corner.lacks(least=True)) if text]
    return told | {
        "corners": [corner.as_json() for corner in corners],
        "said": said,
        "response": [part[::150].tolist() for part in parts],
    }


def task_of(rig: RigConfig) -> dict[str, Any]:
    """What its task asks of it, and from where."""
    return {
        "starts": start_ranges(rig),
        "problems": task_problems(rig),
        "notes": start_notes(rig),
        "units": unit_questions(rig),
        "violations": {
            name: [[one.axis, one.quantity, one.value, one.limit] for one in violations(rig, start)]
            for name, start in corner_starts(rig).items()
        },
    }


def others() -> dict[str, Any]:
    """What `hil new` writes, and how two rigs differ."""
    one, other = (load_rig(RIGS / f"{name}.toml") for name in ("paper", "microscope-ideal"))
    sketches = {name: [rig_text(s), dbc_text(s.axes) if s.dbc else ""] for name, s in SKETCHES.items()}
    return {"new": sketches, "different": rig_differences(one, other)}


def known() -> dict[str, Any]:
    """The file's content."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def renew() -> None:
    """Write the file anew."""
    found = {
        "bus": {name: bus_of(load_rig(RIGS / f"{rig}.toml", sets)) for name, (rig, sets) in BUSES.items()},
        "loop": {name: loop_of(load_rig(RIGS / "paper.toml", sets)) for name, sets in LOOPS.items()},
        "task": {name: task_of(load_rig(RIGS / "microscope-ideal.toml", sets)) for name, sets in TASKS.items()},
        **others(),
    }
    FILE.write_text(json.dumps(rounded(found), indent=1) + "\n", encoding="utf-8")
