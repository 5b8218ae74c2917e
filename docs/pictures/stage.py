"""The stage: four axes, what each carries, and which way is up."""

from pathlib import Path

from docs.pictures.sheet import BLUE, GREEN, GREY, INK, ORANGE, SOFT, arrow, box, sheet

GRAVITY = "gravity pulls on Z:\na brake holds it\nwithout torque"


def draw(path: Path) -> None:
    """Seen from the side: X carries Y, Y carries theta, theta turns the dish; Z carries the pipette (paper, eq. 2)."""
    from matplotlib.patches import Circle, Polygon

    with sheet(path, (8, 4.8), (10, 6)) as axes:
        box(axes, (0.4, 0.3), (6.6, 0.5), "base, on the microscope", GREY)
        box(axes, (0.9, 0.9), (5.6, 0.5), "X", BLUE)
        box(axes, (1.4, 1.5), (4.6, 0.5), "Y", BLUE)
        box(axes, (2.4, 2.1), (2.6, 0.35), "theta", BLUE)
        axes.plot([2.1, 2.1, 5.3, 5.3], [2.8, 2.55, 2.55, 2.8], color=INK, linewidth=1)
        for x in (2.9, 3.7, 4.5):
            axes.add_patch(Circle((x, 2.74), 0.18, facecolor=ORANGE, edgecolor=INK))
        axes.text(1.95, 2.68, "cells in a dish", ha="right", color=INK, fontsize=8)
        box(axes, (7.6, 0.3), (0.7, 5.0), "column", GREY)
        box(axes, (6.1, 3.9), (1.5, 0.9), "Z", GREEN)
        axes.add_patch(Polygon([(6.1, 4.45), (6.1, 4.2), (3.76, 2.92)], facecolor="white", edgecolor=INK))
        axes.text(4.6, 3.95, "micropipette", ha="center", color=INK, fontsize=8)
        arrow(axes, (0.6, 1.15), (0.0, 1.15), colour=SOFT)
        arrow(axes, (6.8, 1.15), (7.4, 1.15), "x", colour=SOFT)
        axes.add_patch(Circle((6.65, 2.05), 0.09, facecolor="white", edgecolor=SOFT))
        axes.add_patch(Circle((6.65, 2.05), 0.03, color=SOFT))
        axes.text(6.65, 2.2, "y, towards you", ha="center", va="bottom", fontsize=8, color=SOFT)
        arrow(axes, (9.0, 3.6), (9.0, 4.9), "z, up", colour=SOFT)
        axes.text(8.55, 2.7, GRAVITY, fontsize=8, color=SOFT, va="center")
        axes.text(0.4, 5.7, "Each axis: a motor, an encoder and a drive. Lengths in m, angles in rad.", color=INK)
