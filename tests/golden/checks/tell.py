"""What a rig is told before anything runs: its bus, its loop, its task.

Numbers of the loop have four digits: they come from matrix libraries that differ in the last ones.
"""

import math
from typing import Any

import numpy as np

from drivers.config import LAYOUTS
from hil.analysis.feasibility import corner_starts, start_notes, task_problems, unit_questions, violations
from hil.analysis.frequency_response import loop_response
from hil.analysis.learning_check import check_learning
from hil.analysis.loop_corners import check_corners
from hil.analysis.stability import check_stability
from hil.analysis.start_ranges import start_ranges
from hil.operate.check import as_json
from hil.rig.bus_load import (
    analyse_rig,
    emulation_notes,
    feedback_notes,
    highest_rate,
    layout_warnings,
    problems,
    rest_notes,
    rig_layout,
)
from hil.rig.difference import rig_differences
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.file import load_rig
from hil.rig.plant_notes import encoder_notes, plant_notes
from hil.rig.scaffold import AxisSketch, Sketch, rig_text
from hil.rig.schema import RigConfig
from tests.golden.golden import outline
from tests.support.paths import RIGS

GEARS = [f"axes.{name}.gear=12566.37" for name in ("x", "y", "z", "theta")]  # 1e5 counts of 5 nm a turn
BUSES: dict[str, tuple[str, list[str]]] = {
    **{name: (name, []) for name in ("paper", "paper-dbc", "microscope", "moteus", "odrive", "vesc")},
    **{name: (name, []) for name in ("damiao", "cubemars", "robstride")},
    **{
        f"microscope, {layout} at {rate} Hz": (
            "microscope", [f"bus.protocol={layout}", f"rate_hz={rate}", *(GEARS if layout == "moteus" else ())]
        )
        for layout in LAYOUTS if ":" not in layout and layout != "mit"  # whose torques end below this stage's
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
    "by a dbc": Sketch("bound", (PLAIN, PLAIN._replace(name="z", travel=0.3, vertical=True)), "dbc"),
    "moteus": Sketch("motors", (PLAIN, PLAIN._replace(name="y", encoder=2e-7, friction=0.0)), "moteus"),
}  # fmt: skip
DIFFERENCES = "difference of paper and microscope-ideal"


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
    layout = rig_layout(rig, RIGS)
    analysis = analyse_rig(rig, layout)
    notes = [encoder_notes(rig), plant_notes(rig), emulation_notes(rig), feedback_notes(rig, layout)]
    notes.append(rest_notes(rig, layout))
    return {
        **as_json(analysis),
        "tightest": analysis.tightest.frame,
        "highest_rate": highest_rate(rig, RIGS),
        # Whether the native kernel is built belongs to the machine, not to the rig
        "notes": [
            note for part in (*notes, layout_warnings(layout)) for note in part if "sim_plant.native" not in note
        ],
        "problems": [*problems(rig, RIGS, analysis), *encoder_range_problems(rig, layout)],
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
        "response": [part[150::150].tolist() for part in parts],  # an integral is ill-conditioned at the very lowest
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


def stories() -> list[str]:
    """Their names."""
    named = (("bus", BUSES), ("loop", LOOPS), ("task", TASKS), ("new", SKETCHES))
    return [*(f"{kind} {name}" for kind, table in named for name in table), DIFFERENCES]


def tell(story: str) -> list[str]:
    """Of a rig on its bus, of a loop, of a task; what `hil new` writes; how two rigs differ."""
    if story == DIFFERENCES:
        one, other = (load_rig(RIGS / f"{name}.toml") for name in ("paper", "microscope-ideal"))
        return [f"{key}: {' | '.join(map(str, values))}" for key, *values in rig_differences(one, other)]
    kind, _, name = story.partition(" ")
    if kind == "new":
        sketch = SKETCHES[name]
        texts = [rig_text(sketch), *sketch.files.values()]
        return [line for text in texts for line in text.splitlines()]
    if kind == "bus":
        rig, sets = BUSES[name]
        return list(outline(rounded(bus_of(load_rig(RIGS / f"{rig}.toml", sets)))))
    if kind == "loop":
        return list(outline(rounded(loop_of(load_rig(RIGS / "paper.toml", LOOPS[name])))))
    return list(outline(rounded(task_of(load_rig(RIGS / "microscope-ideal.toml", TASKS[name])))))
