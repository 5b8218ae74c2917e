"""What the pictures are drawn on: a white sheet of matplotlib's, boxes and arrows, and an SVG without a date."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, SOFT = "#333333", "#777777"
BLUE, ORANGE, GREY, RED, GREEN = "#d7e8ff", "#ffd9a0", "#dddddd", "#f4b6b0", "#d5ecd0"
CURVES = ("#1f5fa8", "#d9730d", "#5a8f3c", "#8a4fa3")

STYLE = {"svg.hashsalt": "hil", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}

Place = tuple[float, float]


@contextmanager
def figure(path: Path, size: Place) -> Iterator["Figure"]:
    """An empty figure of `size` (inches), written to `path` (SVG) at the end. Raises OSError."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(
        {"svg.hashsalt": "hil", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    ):
        drawn = Figure(figsize=size)
        yield drawn
        drawn.savefig(path, format="svg", metadata={"Date": None}, bbox_inches="tight", facecolor="white")


@contextmanager
def sheet(path: Path, size: Place, extent: Place) -> Iterator["Axes"]:
    """Axes without a frame, 0 to `extent` in both directions, for drawings; written to `path` as `figure` does."""
    with figure(path, size) as drawn:
        axes = drawn.add_axes((0, 0, 1, 1))
        axes.set_xlim(0, extent[0])
        axes.set_ylim(0, extent[1])
        axes.axis("off")
        yield axes


def box(axes: "Axes", corner: Place, size: Place, text: str = "", colour: str = BLUE) -> None:
    """A box with its text in the middle. corner: lower left."""
    from matplotlib.patches import FancyBboxPatch

    axes.add_patch(
        FancyBboxPatch(corner, *size, boxstyle="round,pad=0,rounding_size=0.08", facecolor=colour, edgecolor=INK)
    )
    axes.text(corner[0] + size[0] / 2, corner[1] + size[1] / 2, text, ha="center", va="center", color=INK)


def arrow(axes: "Axes", begin: Place, end: Place, text: str = "", *, both: bool = False, colour: str = INK) -> None:
    """An arrow from begin to end, its text above the middle."""
    style = {"arrowstyle": "<|-|>" if both else "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0, "linewidth": 1.3}
    axes.annotate("", xy=end, xytext=begin, arrowprops=style)
    middle = ((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2)
    upright = abs(end[0] - begin[0]) < abs(end[1] - begin[1])
    offset, align = ((0.08, 0.0), ("left", "center")) if upright else ((0.0, 0.08), ("center", "bottom"))
    axes.text(middle[0] + offset[0], middle[1] + offset[1], text, ha=align[0], va=align[1], color=colour, fontsize=8)
