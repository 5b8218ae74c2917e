"""A picture of positioning as data sheets and ISO 230-2 draw it: deviations over the targets, both directions."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from drivers.base.named_file import save_picture
from hil.analysis.positioning import positioning
from hil.cli.output import metres
from hil.cli.pictures import STYLE, UNITS
from hil.operate.approach_file import Deviations


def accuracy_picture(path: Path, found: Mapping[str, Deviations], kinds: Mapping[str, str], title: str) -> None:
    """One panel an axis: each approach a dot, each mean with twice its standard deviation. kinds: of the axes, "linear"
    or "rotary".
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.2 * len(found), 3.4), layout="constrained")
        for panel, (name, axis) in zip(figure.subplots(1, len(found), squeeze=False)[0], found.items(), strict=True):
            long, to_long, short, to_short, _ = UNITS[kinds[name]]
            figures = positioning(axis.up, axis.down)
            places = [target * to_long for target in axis.targets]
            sides = (
                ("up", "C0", axis.up, figures.mean_up, figures.spread_up),
                ("down", "C3", axis.down, figures.mean_down, figures.spread_down),
            )
            for words, colour, single, mean, spread in sides:
                panel.plot(places, single * to_short, ".", color=colour, markersize=3, alpha=0.5)
                panel.errorbar(places, mean * to_short, 2.0 * spread * to_short, color=colour, capsize=2, label=words)
            parts = [("A", figures.accuracy), ("R", figures.repeatability), ("B", figures.reversal)]
            panel.set_title(f"{name}: " + ", ".join(f"{sign} {metres(value, kinds[name])}" for sign, value in parts))
            panel.set_xlabel(f"target, {long}")
            panel.set_ylabel(f"deviation, {short}")
            panel.legend(title="approached; bars: 2 s")
        figure.suptitle(title)
        save_picture(figure, path, dpi=110)
