"""Layouts for the usual MCAP viewers, made from a rig's axes: what they plot is named as a recording names it.

Lichtblick and Foxglove read a JSON document, PlotJuggler an XML one (`python -m docs.make_pages` writes those of the
shipped rigs to deploy/viewers).
"""

import json
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

from hil.telemetry.tick_schema import field_of_axis

TOPIC = "tick"
# Of every axis, a plot each: title and the fields in it.
PLOTS = (
    ("position", ("position", "setpoint_position")),
    ("following error", ("following_error",)),
    ("force", ("force", "force_requested")),
)
OVERALL = ("state", "fault", "lateness")
_COLOURS = ("#4e98e2", "#f5774d", "#7fba3c", "#c05bd8")


def paths(axes: Sequence[str]) -> list[str]:
    """Every field that the layouts plot, below the topic: "x.position", "state", ..."""
    motion = [f"{field_of_axis(axis)}.{field}" for axis in axes for _, fields in PLOTS for field in fields]
    return [*motion, *OVERALL]


def lichtblick(axes: Sequence[str]) -> str:
    """A layout for Lichtblick and Foxglove: rows of plots, a column an axis, state and lateness below."""
    configs: dict[str, Any] = {}

    def plot(name: str, title: str, fields: Sequence[str]) -> str:
        lines = [
            {"value": f"{TOPIC}.{field}", "enabled": True, "timestampMethod": "receiveTime",
             "color": _COLOURS[place % len(_COLOURS)], "label": field}
            for place, field in enumerate(fields)
        ]  # fmt: skip
        configs[f"Plot!{name}"] = {"title": title, "paths": lines, "xAxisVal": "timestamp", "showLegend": True}
        return f"Plot!{name}"

    columns = [
        _stack([plot(f"{axis}{place}", f"{axis}: {title}", [f"{field_of_axis(axis)}.{field}" for field in fields])
                for place, (title, fields) in enumerate(PLOTS)], "column")
        for axis in axes
    ]  # fmt: skip
    below = [plot(f"all{place}", field, [field]) for place, field in enumerate(OVERALL)]
    layout = {
        "direction": "column",
        "first": _stack(columns, "row"),
        "second": _stack(below, "row"),
        "splitPercentage": 75,
    }
    document = {"configById": configs, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps({**document, "layout": layout}, indent=1) + "\n"


def _stack(parts: Sequence[Any], direction: str) -> Any:
    """Parts side by side or one above the other, of equal size."""
    first, *rest = parts
    if not rest:
        return first
    share = 100.0 / len(parts)
    return {"direction": direction, "first": first, "second": _stack(rest, direction), "splitPercentage": share}


def plotjuggler(axes: Sequence[str]) -> str:
    """A layout for PlotJuggler: a tab an axis, and one for state, fault and lateness."""
    tabs = [(axis, [[f"{field_of_axis(axis)}.{field}" for field in fields] for _, fields in PLOTS]) for axis in axes]
    tabs.append(("all", [[field] for field in OVERALL]))
    lines = [
        "<?xml version='1.0' encoding='UTF-8'?>",
        "<root>",
        ' <tabbed_widget name="Main Window" parent="main_window">',
    ]
    for name, plots in tabs:
        lines.append(f'  <Tab containers="1" tab_name={quoteattr(name)}>')
        lines.append("   <Container>")
        shares = ";".join(f"{1 / len(plots):.3f}" for _ in plots)
        lines.append(f'    <DockSplitter orientation="-" count="{len(plots)}" sizes="{shares}">')
        for fields in plots:
            lines.append(f"     <DockArea name={quoteattr(fields[0])}>")
            lines.append('      <plot mode="TimeSeries" style="Lines">')
            for place, field in enumerate(fields):
                curve = f"{TOPIC}/{field.replace('.', '/')}"
                lines.append(f'       <curve name={quoteattr(curve)} color="{_COLOURS[place]}"/>')
            lines.extend(["      </plot>", "     </DockArea>"])
        lines.extend(["    </DockSplitter>", "   </Container>", "  </Tab>"])
    lines.extend(
        ['  <currentTabIndex index="0"/>', " </tabbed_widget>", ' <use_relative_time_offset enabled="1"/>', "</root>"]
    )
    return "\n".join(lines) + "\n"
