"""The table of states as a drawing; docs/states.md has it as a table."""

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

from docs.pictures.sheet import BLUE, GREY, INK, ORANGE, SOFT, Place, figure
from hil.cycle.state_machine import SILENT_STATES, TABLE, TORQUE_STATES, Event, State

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLACES = {
    State.BOOT: (0, 3), State.CONNECTED: (2, 3), State.READY: (4, 3), State.HOMING: (6.4, 5), State.ACTIVE: (7.2, 3),
    State.STOPPING: (5.8, 1.2), State.FAULT: (2.2, 0.8), State.ESTOP: (0.4, 0.8), State.SHUTDOWN: (4.4, 0),
}  # fmt: skip
EVERYWHERE = {
    (Event.ESTOP, State.ESTOP),
    (Event.FAULT_ZERO, State.FAULT),
    (Event.FAULT_STOP, State.FAULT),
    (Event.EXIT, State.SHUTDOWN),
}
CAPTION = """orange: torque permitted; grey: nothing is sent
not drawn, from every state: estop to ESTOP, a fault to FAULT (fault_stop by way of STOPPING where torque flows), exit
to SHUTDOWN likewise"""


def draw(path: Path) -> None:
    """States as boxes, events as arrows."""
    with figure(path, (12, 8)) as drawn:
        axes = drawn.add_subplot()
        for (state, target), events in _arrows().items():
            _arrow(axes, PLACES[state], PLACES[target], "\n".join(event.name.lower() for event in events))
        for state, place in PLACES.items():
            colour = ORANGE if state in TORQUE_STATES else GREY if state in SILENT_STATES else BLUE
            box = {"boxstyle": "round,pad=0.5", "facecolor": colour, "edgecolor": INK}
            axes.text(*place, state.name, ha="center", va="center", fontsize=11, bbox=box, zorder=3)
        axes.set_xlim(-0.8, 8.2)
        axes.set_ylim(-0.8, 5.8)
        axes.axis("off")
        axes.set_title(CAPTION, fontsize=9)


def _arrows() -> dict[tuple[State, State], list[Event]]:
    """Events by the pair of states they join; self-transitions and those of EVERYWHERE left out."""
    joined: dict[tuple[State, State], list[Event]] = defaultdict(list)
    for (state, event), target in TABLE.items():
        if state is not target and (event, target) not in EVERYWHERE:
            joined[state, target].append(event)
    return dict(joined)


def _arrow(axes: "Axes", start: Place, end: Place, label: str) -> None:
    style = {"arrowstyle": "-|>", "color": SOFT, "shrinkA": 32, "shrinkB": 32, "connectionstyle": "arc3,rad=0.12"}
    axes.annotate("", xy=end, xytext=start, arrowprops=style)
    (x0, y0), (x1, y1) = start, end
    across = (0.12 * (y1 - y0), -0.12 * (x1 - x0))
    x, y = x0 + 0.45 * (x1 - x0) + 0.5 * across[0], y0 + 0.45 * (y1 - y0) + 0.5 * across[1]
    axes.text(x, y, label, fontsize=6.5, ha="center", va="center", color="#444444", zorder=2)
