"""One tick in time: the frames of the microscope rig where its bus analysis puts them, and what this computer does."""

from pathlib import Path
from typing import TYPE_CHECKING

from docs.pictures.sheet import BLUE, GREEN, INK, ORANGE, SOFT, figure
from hil.rig.bus_load import analyse_rig, rig_layout
from hil.runs.rigs import load_rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEP = 60.0  # us that a tick of this computer takes here; docs/what-costs-what.md has measured ones
ON_COMMAND = "sample the encoder, apply the new torque, answer"
ROWS = {"drives": 0, "bus": 1, "computer": 2}


def draw(path: Path) -> None:
    """Two periods, us: the answers of one tick are what the next one computes with."""
    rig = load_rig("microscope").config
    period = 1e6 / rig.rate_hz
    responses = analyse_rig(rig, rig_layout(rig, path.parent)).responses
    with figure(path, (9, 3.2)) as drawn:
        axes = drawn.add_subplot()
        for tick in range(2):
            _one(axes, tick * period, [(r.frame, r.cost_ns * 1e-3, r.worst_ns * 1e-3) for r in responses])
        for tick in range(3):
            axes.axvline(tick * period, color=SOFT, linestyle=":", linewidth=1)
        axes.set_yticks([*ROWS.values()], [*ROWS])
        axes.set_ylim(-0.75, 2.85)
        axes.set_xlim(-40, 2 * period + 60)
        axes.set_xlabel(f"time, us ({rig.name}, {rig.bus.protocol}, {rig.rate_hz:g} Hz; frames at their longest)")
        axes.text(0, 2.62, " tick k", color=SOFT)
        axes.text(period, 2.62, " tick k + 1", color=SOFT)


def _one(axes: "Axes", begin: float, frames: list[tuple[str, float, float]]) -> None:
    """A tick that is due at `begin`. frames: (name, us on the wire, us from the tick until received)."""
    _bar(axes, "computer", begin, STEP, "step", ORANGE)
    for name, length, received in frames:
        host = name == "command"
        last = begin + STEP + received
        short = "cmd" if host else name.replace("feedback ", "")
        _bar(axes, "bus", last - length, length, short, BLUE if host else GREEN)
        if host:
            _bar(axes, "drives", last, 14.0, "", ORANGE)
            axes.text(last + 20, ROWS["drives"], ON_COMMAND, va="center", fontsize=7.5, color=INK)
            axes.plot([last, last], [ROWS["drives"], ROWS["bus"]], color=SOFT, linewidth=0.8)
    if begin == 0:
        answered = STEP + frames[-1][2]
        style = {"arrowstyle": "-|>", "color": SOFT, "connectionstyle": "arc3,rad=-0.25"}
        axes.annotate("", xy=(1000, ROWS["computer"]), xytext=(answered, ROWS["bus"] + 0.3), arrowprops=style)
        axes.text(800, 1.45, "waits in the kernel until the next tick", fontsize=7.5, color=SOFT, ha="center")


def _bar(axes: "Axes", row: str, begin: float, length: float, text: str, colour: str) -> None:
    axes.barh(ROWS[row], length, 0.55, begin, color=colour, edgecolor=INK, linewidth=0.8)
    axes.text(begin + length / 2, ROWS[row], text, ha="center", va="center", fontsize=7, color=INK)
