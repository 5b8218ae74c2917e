"""Pictures that correspond to the paper's Figures 3 to 12, from our own runs."""

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.base.named_file import naming
from hil.studies.paper.experiment import Job, Run
from hil.studies.paper.problem import circle

AXES = ("X", "Y")
PERIOD = 2.0  # s, of the circle


class Curve(NamedTuple):
    """A run in a picture."""

    claim: str
    variant: int
    label: str


class Figure(NamedTuple):
    """One of the paper's figures. printed_um: the band the paper reads off it; 0: a tracking picture."""

    number: int
    title: str
    axis: int
    curves: tuple[Curve, ...]
    printed_um: float = 0.0


_EXACT = Curve("pdff-exact", 0, "ours, solved accurately")
_NOISE = Curve("pdff-solver-noise", 0, "ours, ode45 at rtol 1e-3")
_DELTA = Curve("pdff-modelling-error", 0, "ours")
_PRINTED = Curve("robust-as-printed", 0, "as printed")
_FILTERED = Curve("robust-filtered-error", 0, "filtered error, vector norm")
_PER_AXIS = Curve("robust-filtered-error", 1, "filtered error, per axis")
_BRACKETS = Curve("robust-alpha-brackets", 0, "alpha before both brackets")

FIGURES = (
    Figure(3, "X axis, PD + feedforward: tracking", 0, (_EXACT,)),
    Figure(4, "Y axis, PD + feedforward: tracking", 1, (_EXACT,)),
    Figure(5, "X axis, PD + feedforward: error", 0, (_NOISE, _EXACT), 0.8),
    Figure(6, "Y axis, PD + feedforward: error", 1, (_NOISE, _EXACT), 1.8),
    Figure(7, "X axis, robust PD with Delta: tracking", 0, (_PRINTED, _BRACKETS)),
    Figure(8, "Y axis, robust PD with Delta: tracking", 1, (_PRINTED, _BRACKETS)),
    Figure(9, "X axis, PD + feedforward with Delta: error", 0, (_DELTA,), 100.0),
    Figure(10, "Y axis, PD + feedforward with Delta: error", 1, (_DELTA,), 100.0),
    Figure(11, "X axis, robust PD with Delta: error", 0, (_PRINTED, _FILTERED, _PER_AXIS, _BRACKETS), 1.5),
    Figure(12, "Y axis, robust PD with Delta: error", 1, (_PRINTED, _FILTERED, _PER_AXIS, _BRACKETS), 1.5),
)


def draw(runs: Mapping[Job, Run], directory: Path) -> list[tuple[Figure, Path]]:
    """PNG files of the figures whose runs are all there, in the paper's order."""
    drawn = []
    for figure in FIGURES:
        curves = [(curve, runs.get(_finest(runs, curve))) for curve in figure.curves]
        present = [(curve, run) for curve, run in curves if run is not None]
        if len(present) == len(curves):
            path = directory / f"figure_{figure.number:02d}.png"
            with naming(path):
                path.write_bytes(_picture(figure, present))
            drawn.append((figure, path))
    return drawn


def _finest(runs: Mapping[Job, Run], curve: Curve) -> Job:
    candidates = [job for job in runs if (job.claim, job.variant) == (curve.claim, curve.variant)]
    return max(candidates, key=lambda job: job.step, default=Job(curve.claim, curve.variant, 0))


def _picture(figure: Figure, curves: list[tuple[Curve, Run]]) -> bytes:
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(7.0, 3.2), layout="constrained")
    axes = canvas.subplots()
    if figure.printed_um:
        _draw_errors(axes, figure, curves)
    else:
        _draw_tracking(axes, figure, curves)
    axes.set_title(f"Fig. {figure.number}: {figure.title}", fontsize=10)
    axes.set_xlabel("t from the start of the steady window / s" if figure.printed_um else "t / s")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="best")
    buffer = io.BytesIO()
    canvas.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def _draw_tracking(axes: Any, figure: Figure, curves: list[tuple[Curve, Run]]) -> None:
    longest = max(float(run.time[-1]) for _, run in curves)
    time = np.linspace(0.0, longest, 601)
    axes.plot(time, [circle(t).position[figure.axis] for t in time.tolist()], "k--", lw=1, label="setpoint")
    for curve, run in curves:
        axes.plot(run.time, run.position[:, figure.axis], lw=1, label=curve.label)
    axes.set_ylabel(f"{AXES[figure.axis]} / m")


def _draw_errors(axes: Any, figure: Figure, curves: list[tuple[Curve, Run]]) -> None:
    largest = figure.printed_um
    for curve, run in curves:
        # every run's steady window over the same two seconds: they are one period of the task
        since = run.time - run.steady_from
        window = (since >= 0.0) & (since <= PERIOD)
        error = run.error[window, figure.axis] * 1e6
        largest = max(largest, float(np.abs(error).max()))
        axes.plot(since[window], error, lw=1, label=curve.label)
    for side in (-1, 1):
        axes.axhline(side * figure.printed_um, color="grey", ls=":", lw=1, label="paper" if side > 0 else None)
    axes.set_ylabel(f"{AXES[figure.axis]} error / µm")
    if largest > 20 * figure.printed_um:
        axes.set_yscale("symlog", linthresh=2 * figure.printed_um)


def embedded(path: Path) -> str:
    """A PNG as a data URI, so that a page needs no other file."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
