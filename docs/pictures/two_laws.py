"""Two laws side by side: README's ten lines of Python, drawn."""

from pathlib import Path

import hil
from docs.pictures.sheet import CURVES, SOFT, figure

LAWS = ("pd-feedforward", "structured-kalman")
SECONDS, SHOWN = 12.0, 4.0  # of the run, and of ACTIVE in the picture


def draw(path: Path) -> None:
    """X of the paper's rig with 0.3 N of friction that the model does not know, under either law: error and force."""
    rig = hil.load_rig("paper", {"plant.modelling_error": 0.3})
    runs = {law: hil.simulate(rig, law=law, seconds=SECONDS) for law in LAWS}
    with figure(path, (9, 4.6)) as drawn:
        panels = drawn.subplots(2, len(runs), sharex=True, sharey="row")
        for column, (law, run) in enumerate(runs.items()):
            begun = next(i for i, state in enumerate(run.state) if state == "ACTIVE")
            ticks = slice(begun, begun + round(SHOWN * rig.config.rate_hz))
            at, error, force = run.time[ticks] - run.time[begun], run.error[ticks, 0] * 1e6, run.force[ticks, 0]
            largest = run.summary()["axes"]["x"]["max_error"] * 1e6
            panels[0, column].plot(at, error, color=CURVES[column], linewidth=0.8)
            panels[0, column].set_title(f"{law}: at most {largest:.2f} um once steady", fontsize=10)
            panels[1, column].plot(at, force, color=CURVES[column], linewidth=0.8)
            panels[1, column].set_xlabel("time in ACTIVE, s")
            for panel in panels[:, column]:
                panel.axhline(0.0, color=SOFT, linewidth=0.5, zorder=0)
        panels[0, 0].set_ylabel("error of X, um")
        panels[1, 0].set_ylabel("force on X, N")
        drawn.align_ylabels()
