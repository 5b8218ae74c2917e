"""What an identification was found from, to look at: a picture, and frequency responses as files for `hil check`."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drivers.base.named_file import save_picture
from hil.analysis.frequency_response import COLUMNS
from hil.cli.pictures import STYLE, UNITS
from hil.identify.findings import Findings

PANELS = 6


def identification_picture(path: Path, findings: Mapping[str, Findings], kinds: Mapping[str, str]) -> None:
    """One row an axis: the frequency response with its fit, friction and force along the travel, friction over speed,
    loops at rest, the check and what was refused. kinds: of the axes, "linear" or "rotary".
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.6 * PANELS, 3.0 * len(findings)), layout="constrained")
        for row, (name, one) in zip(
            figure.subplots(len(findings), PANELS, squeeze=False), findings.items(), strict=True
        ):
            _bode(row[0], row[1], one, kinds[name])
            _travel(row[2], row[3], one, kinds[name])
            _loops(row[4], one, kinds[name])
            _checked(row[5], one, kinds[name])
            row[0].set_ylabel(f"{name}: {row[0].get_ylabel()}")
        save_picture(figure, path, dpi=110)


def _not_measured(*panels: Axes) -> None:
    for panel in panels:
        panel.text(0.5, 0.5, "not measured", ha="center", transform=panel.transAxes)


def _bode(size: Axes, phase: Axes, one: Findings, kind: str) -> None:
    if one.response is None:
        _not_measured(size, phase)
        return
    hertz, measured, _, coherence, _ = one.response
    turned = np.unwrap(np.angle(measured))
    size.loglog(hertz, np.abs(measured), ".", markersize=3, label="measured")
    if (fitted := one.fitted) is not None:
        size.loglog(hertz, np.abs(fitted), label="fitted")
        phase.semilogx(hertz, np.degrees(np.unwrap(np.angle(fitted))))
        turned = np.unwrap(np.angle(fitted)) + np.angle(measured / fitted)  # about a notch, the same branch
    for quantity, estimate in one.found.items():
        if quantity.endswith("_frequency_hz"):  # of the tool, or another resonance
            size.axvline(estimate.value, color="C3", linewidth=0.5)
    phase.semilogx(hertz, np.degrees(turned), ".", color="C0", markersize=3)
    phase.set(xlabel="Hz", ylabel="phase, degrees")
    beside = phase.twinx()
    beside.semilogx(hertz, coherence, color="C2", linewidth=0.5)
    beside.set(ylim=(0.0, 1.05), ylabel="coherence")
    size.set(xlabel="Hz", ylabel="position over force, " + ("m/N" if kind == "linear" else "rad/(N m)"))
    size.legend()


def _travel(along: Axes, over: Axes, one: Findings, kind: str) -> None:
    if one.travel is None:
        _not_measured(along, over)
        return
    long, to_long, _, _, force = UNITS[kind]
    curves = one.travel
    along.plot(curves.position * to_long, curves.friction, label="friction")
    along.plot(curves.position * to_long, curves.place - curves.place.mean(), label="force of the place less its mean")
    along.set(xlabel=f"position, {long}", ylabel=force)
    along.legend()
    for way, words in ((1.0, "up"), (-1.0, "down")):
        chosen = curves.speed * way > 0.0
        over.plot(np.abs(curves.speed[chosen]) * to_long, curves.friction_at_speed[chosen], ".", label=words)
    over.set(xlabel=f"speed, {long}/s", ylabel=f"friction, {force}")
    over.legend()


def _loops(panel: Axes, one: Findings, kind: str) -> None:
    if one.loops is None:
        _not_measured(panel)
        return
    _, _, short, to_short, force = UNITS[kind]
    position, pushed = one.loops
    panel.plot((position - position.mean()) * to_short, pushed, linewidth=0.4)
    panel.set(xlabel=f"position about its mean, {short}", ylabel=f"force, {force}")


def _checked(panel: Axes, one: Findings, kind: str) -> None:
    """The motion that no fit used; above it, what was refused."""
    panel.set_title(f"refused: {', '.join(one.missing)}" if one.missing else "", fontsize="small", color="C3")
    if one.checked is None:
        _not_measured(panel)
        return
    panel.plot(one.checked.seconds, one.checked.force, ".", markersize=1, label="force")
    panel.plot(one.checked.seconds, one.checked.rest, ".", markersize=1, label="left unexplained")
    panel.set(xlabel="check, s", ylabel=UNITS[kind][4])
    panel.legend()


def write_responses(folder: Path, findings: Mapping[str, Findings]) -> dict[str, Path]:
    """FOLDER/AXIS.csv of each frequency response, as `hil check --measured AXIS=FILE` reads them. Raises OSError."""
    written = {}
    folder.mkdir(parents=True, exist_ok=True)
    for name, one in findings.items():
        if one.response is None:
            continue
        phase = np.degrees(np.unwrap(np.angle(one.response.response)))
        rows = zip(one.response.frequency_hz, np.abs(one.response.response), phase, strict=True)
        lines = [",".join(COLUMNS), *(f"{hertz:.9g},{size:.9g},{angle:.6f}" for hertz, size, angle in rows)]
        written[name] = folder / f"{name}.csv"
        written[name].write_text("\n".join(lines) + "\n", encoding="utf-8")
    return written
