"""The wiring: what stands on the CAN bus, what cuts the power, and what only listens."""

from pathlib import Path

from docs.pictures.sheet import BLUE, GREEN, GREY, INK, ORANGE, RED, SOFT, arrow, box, sheet

POWER = "#b03a2e"
SUPPLY = "motor power: passes the emergency stop, never this computer"
DRIVES = ("X", "Y", "Z", "theta")


def draw(path: Path) -> None:
    """The rig PC, the bus with its drives, the emergency stop in the drives' supply, and who watches."""
    with sheet(path, (9, 5), (11.4, 6.3)) as axes:
        box(axes, (0.3, 2.5), (3.0, 3.2), colour=GREY)
        axes.text(1.8, 5.45, "rig PC", ha="center", color=INK)
        box(axes, (0.55, 4.2), (2.5, 0.9), "control process\n1000 ticks/s", ORANGE)
        box(axes, (0.55, 2.75), (2.5, 0.9), "sidecar:\nrecords, publishes", BLUE)
        arrow(axes, (1.8, 4.2), (1.8, 3.65), "ring in memory", both=True)
        axes.plot([3.05, 10.9], [4.65, 4.65], color=INK, linewidth=3, solid_capstyle="butt")
        axes.text(3.4, 4.78, "CAN, both ends terminated (120 ohm)", fontsize=8, color=INK)
        for number, name in enumerate(DRIVES):
            left = 3.9 + 1.55 * number
            axes.plot([left + 0.6] * 2, [4.65, 4.1], color=INK, linewidth=1.5)
            box(axes, (left, 3.4), (1.2, 0.7), f"drive\n{name}", GREEN)
            box(axes, (left, 2.3), (1.2, 0.7), "motor, brake,\nencoder" if name == "Z" else "motor,\nencoder", GREY)
            arrow(axes, (left + 0.6, 3.4), (left + 0.6, 3.0), both=True, colour=SOFT)
            axes.plot([left + 1.05] * 2, [3.4, 1.2], color=POWER, linewidth=1.2, zorder=0)
        box(axes, (10.1, 3.4), (1.1, 0.7), "sensor,\ncamera", GREEN)
        axes.plot([10.65] * 2, [4.65, 4.1], color=INK, linewidth=1.5)
        box(axes, (2.4, 0.8), (1.9, 0.8), "emergency stop\n(hardware)", RED)
        box(axes, (0.3, 0.8), (1.4, 0.8), "drives'\nsupply", GREY)
        axes.plot([1.7, 2.4], [1.2, 1.2], color=POWER, linewidth=1.2)
        axes.plot([4.3, 9.6], [1.2, 1.2], color=POWER, linewidth=1.2)
        axes.text(
            7.2,
            0.85,
            "motor power: passes the emergency stop, never this computer",
            ha="center",
            fontsize=8,
            color=POWER,
        )
        box(axes, (0.55, 5.85), (2.5, 0.4), "monitor, page, scripts", BLUE)
        axes.plot([0.15, 0.15, 0.55], [3.2, 6.05, 6.05], color=SOFT, linewidth=1.2)
        axes.plot([0.15, 0.55], [3.2, 3.2], color=SOFT, linewidth=1.2)
        axes.text(3.2, 6.05, "Zenoh, to watch; loopback unless you say otherwise", va="center", fontsize=8, color=SOFT)
