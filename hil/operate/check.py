"""What `hil check` looks at: does the rig's traffic fit its bus, and is its sampled loop stable."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.table import Table

from drivers.base.named_file import save_picture
from drivers.bus_load.schedulability import Analysis, Response, faults_tolerated
from drivers.config import KERNEL_INTERFACES
from drivers.frame import EXTENDED
from hil.analysis.feasibility import start_notes, task_problems
from hil.analysis.learning_check import check_learning
from hil.analysis.loop_corners import CornerTrial, corner_problems
from hil.analysis.second_resonance import second_notes, second_resonances
from hil.analysis.stability import StabilityReport, check_stability
from hil.analysis.task_figures import excursion_notes, excursion_problems, excursions_json, task_figures
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_CONFIG
from hil.cli.output import write_json
from hil.control.law_registry import law_class
from hil.operate.check_loop import asked_note, corner_notes, corner_table, measured_findings, measured_notes
from hil.operate.check_sensor import check_sensor
from hil.rig.bus_load import (
    analyse_rig,
    emulation_notes,
    feedback_notes,
    layout_warnings,
    messages_by_segment,
    microseconds,
    problems,
    rest_notes,
    rig_layout,
)
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.file import load_rig
from hil.rig.plant_notes import encoder_notes, law_notes
from hil.rig.schema import RigConfig, RigError
from sim_plant.user_stage import stage_problems


def check_rig(
    rig_file: Path,
    overrides: Sequence[str] = (),
    *,
    json_path: str | None = None,
    picture: Path | None = None,
    measured: Sequence[str] = (),
    frd: Path | None = None,
) -> None:
    """Print what was found of a rig, write JSON. Exit status 78 where the rig cannot run as it is.

    json_path: "-" is standard output. picture: of one tick, PNG; None: none. measured: AXIS=FILE, CSV with the axis'
    measured frequency response. frd: where the loop's frequency response goes, JSON.
    """
    rig = load_rig(rig_file, overrides)
    layout = rig_layout(rig, rig_file.parent)
    analysis = analyse_rig(rig, layout)
    console = plain_console(stderr=json_path == "-")
    warnings = layout_warnings(layout)
    for note in [
        *encoder_notes(rig),
        *law_notes(rig),
        *estimator_notes(rig),
        *feedback_notes(rig, layout),
        *rest_notes(rig, layout),
        *emulation_notes(rig),
        *interface_notes(rig),
        *warnings,
    ]:
        console.print(note, soft_wrap=True, markup=False)
    console.print(bus_table(rig, analysis))
    parts = messages_by_segment(rig, layout)
    tolerated = min(faults_tolerated(messages, rig.bus.bitrate, rig.bus.data_bitrate) for messages in parts)
    if tolerated >= 0:
        console.print(f"Bus errors that may hit one response without a deadline missed: {tolerated}")
    show_tick(console, rig, analysis, picture)
    found = problems(rig, rig_file.parent, analysis)
    try:
        infeasible = [*encoder_range_problems(rig, layout), *task_problems(rig), *excursion_problems(rig)]
        figures = task_figures(rig)
        trial = CornerTrial(rig)
        stability = check_stability(rig, lowest_rate=True, beside=[trial])
        corners = [*trial.findings(), *measured_findings(rig, measured, frd)] if stability.stable else []
        second = second_resonances(trial) if stability.stable else []
        learning = check_learning(rig)
        sensor = check_sensor(rig)
    except ValueError as error:
        raise RigError([f"{rig_file}: {error}"]) from None
    console.print(stability_table(stability))
    console.print(corner_table(corners))
    for note in [
        *([asked_note(stability.law, corners)] if corners else []),
        *measured_notes(rig),
        *(f"less margin than is good: {note}; next: hil tune {rig_file}" for note in corner_notes(corners)),
        *second_notes(second),
    ]:
        console.print(note, soft_wrap=True, markup=False)
    for finding in learning:
        console.print(finding.note(), soft_wrap=True, markup=False)
    for told in sensor:
        console.print(told.text, soft_wrap=True, markup=False)
    units = {name: "m" if axis.kind == "linear" else "rad" for name, axis in rig.axes.items()}
    for note in [*figures.notes(units), *excursion_notes(rig)]:
        console.print(note, soft_wrap=True, markup=False)
    for note in start_notes(rig):
        console.print(f"ACTIVATE there would break a limit: {note}", soft_wrap=True, markup=False)
    found = [*found, *stability.problems(), *corner_problems(corners), *infeasible]
    found += [text for finding in learning if (text := finding.problem())]
    found += [told.text for told in sensor if told.refused]
    found += stage_problems(rig.plant, rig.axis_names)
    document = as_json(analysis) | {"faults_tolerated": tolerated, "stability": stability.as_json(), "problems": found}
    document["warnings"] = warnings
    document["task"] = figures.as_json() | {"excursions": excursions_json(rig)}
    document["corners"] = [corner.as_json() for corner in corners]
    document["second_resonance"] = [finding.as_json() for finding in second]
    document["sensor"] = [told._asdict() for told in sensor]
    document["learning"] = [finding.as_json() for finding in learning]
    if json_path:
        write_json(document, json_path)
    for line in found:
        print(f"hil: {rig_file}: {line}", file=sys.stderr)
    if found:
        raise typer.Exit(EXIT_CONFIG)


def estimator_notes(rig: RigConfig) -> list[str]:
    """What a user's estimator does not do."""
    if not rig.estimator.is_users or not law_class(rig.law).own_estimate:
        return []
    own = f"law {rig.law.name} has an observer of its own"
    return [f"estimator.name = {rig.estimator.name!r} changes nothing: {own}"]


def interface_notes(rig: RigConfig) -> list[str]:
    """What a bus that is none of the kernel's is good for."""
    if rig.bus.interface in KERNEL_INTERFACES:
        return []
    return [
        f"bus.interface = '{rig.bus.interface}' serves hil bus, hil drives and hil bench bus; hil run and hil emulate "
        f"refuse it, and run on {' or '.join(KERNEL_INTERFACES[1:])} alone"
    ]


def as_json(analysis: Analysis) -> dict[str, Any]:
    """Keys: bus_load (fraction), schedulable, tick_s, responses[] {frame, can_id, bits, worst_s, deadline_s, margin_s,
    bounded}; worst_s is null where no bound exists."""
    return {
        "bus_load": analysis.bus_load,
        "schedulable": analysis.schedulable,
        "tick_s": analysis.tick_ns * 1e-9,
        "responses": [_response_json(response) for response in analysis.responses],
    }


def _response_json(response: Response) -> dict[str, Any]:
    deadline_ns, margin_ns = response.message.deadline_ns, response.margin_ns
    return {
        "frame": response.frame,
        "can_id": response.message.can_id,
        "bits": {"nominal": response.bits[0], "data": response.bits[1]},
        "worst_s": None if margin_ns is None else (deadline_ns - margin_ns) * 1e-9,
        "deadline_s": deadline_ns * 1e-9,
        "margin_s": None if margin_ns is None else margin_ns * 1e-9,
        "bounded": response.worst_ns is not None,
    }


def bus_table(rig: RigConfig, analysis: Analysis) -> Table:
    """Every frame with its length, worst case, deadline and margin, the most urgent first."""
    bus = rig.bus
    rates = f"{bus.bitrate} bit/s" + (f", data {bus.data_bitrate} bit/s" if _any_fd(analysis) else "")
    verdict = "fits" if analysis.schedulable else "[red]does not fit[/red]"
    title = (
        f"{rig.name}: {bus.protocol} on {_segments(rig)}{rates}, {rig.rate_hz:g} Hz: {verdict}\n"
        f"worst-case load {analysis.bus_load:.1%}, cyclic frames {microseconds(analysis.tick_ns)} a tick; times in us"
    )
    table = Table(title=title, title_justify="left")
    for column in ("frame", "id", "from"):
        table.add_column(column, no_wrap=True)
    for column in ("bytes", "bits", "time", "worst", "due", "margin"):  # all of a stage fit into 80 columns
        table.add_column(column, no_wrap=True, justify="right")
    for response in sorted(analysis.responses, key=lambda response: response.message.period_ns):
        message, margin_ns = response.message, response.margin_ns
        nominal, fast = response.bits
        table.add_row(
            response.frame,
            f"{message.can_id & ~EXTENDED:03X}",
            message.sender,
            str(message.length),
            f"{nominal}+{fast}" if fast else str(nominal),
            f"{response.cost_ns / 1000:.1f}",
            "no bound" if margin_ns is None else f"{(message.deadline_ns - margin_ns) / 1000:.1f}",
            f"{message.deadline_ns / 1000:.0f}",
            "-" if margin_ns is None else f"{'' if response.fits else '[red]'}{margin_ns / 1000:.1f}",
        )
    return table


def _segments(rig: RigConfig) -> str:
    """Which axes are where, of a rig with more than one segment; the load is that of the busiest."""
    return "".join(f"{segment.channel} ({', '.join(segment.axes)}), " for segment in rig.bus.segments)


def stability_table(report: StabilityReport) -> Table:
    """Per axis: slowest pole, margins, and the rates from which the loop is stable."""
    title = f"{report.law} at {report.rate_hz:g} Hz, one period of delay: " + (
        "stable" if report.stable else "[red]unstable[/red]"
    )
    table = Table("axis", "largest pole", "gain margin", "phase margin", "stable from", title=title)
    differs = any(axis.finite_difference_rate_hz is not None for axis in report.axes.values())
    if differs:
        table.add_column("with a finite difference from")
    for name, axis in report.axes.items():
        gain, phase = axis.gain_margin, axis.phase_margin_deg
        rates = (axis.lowest_stable_rate_hz, *((axis.finite_difference_rate_hz,) if differs else ()))
        table.add_row(
            name,
            f"{'' if axis.stable else '[red]'}{axis.radius:.4f}",
            "-" if gain is None else f"{20.0 * math.log10(gain):.1f} dB",
            "-" if phase is None else f"{phase:.0f} deg",
            *("-" if rate is None else f"{rate:.0f} Hz" if rate < math.inf else "no rate" for rate in rates),
        )
    return table


def _any_fd(analysis: Analysis) -> bool:
    return any(response.message.fd for response in analysis.responses)


def show_tick(console: Console, rig: RigConfig, analysis: Analysis, picture: Path | None) -> None:
    """Draw it, where that is asked for, and say where."""
    if picture:
        draw_tick(rig, analysis, picture)
        console.print(f"One worst-case tick: {picture}")


def draw_tick(rig: RigConfig, analysis: Analysis, target: Path) -> None:
    """PNG: the worst case of one tick. A bar is a frame at its longest, ending at its worst-case response time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    responses = [
        response for response in analysis.responses if response.message.deadline_ns <= 2 * rig.period_ns
    ] or list(analysis.responses)
    figure, axes = pyplot.subplots(figsize=(9, 1.2 + 0.35 * len(responses)), layout="constrained")
    for row, response in enumerate(responses):
        margin_ns = response.margin_ns
        if margin_ns is not None:
            end = (response.message.deadline_ns - margin_ns) / 1000
            colour = "tab:blue" if response.fits else "tab:red"
            axes.barh(row, response.cost_ns / 1000, left=end - response.cost_ns / 1000, color=colour)
            axes.annotate(f"{end:.0f}", (end, row), xytext=(3, 0), textcoords="offset points", va="center", fontsize=8)
        axes.plot(response.message.deadline_ns / 1000, row, "k|", markersize=14)
    axes.axvline(rig.period_ns / 1000, color="grey", linewidth=0.8)
    axes.set_yticks(range(len(responses)), [f"{r.frame}  {r.message.can_id & ~EXTENDED:03X}h" for r in responses])
    axes.invert_yaxis()
    axes.set_xlim(left=0)
    axes.set_xlabel("µs after the tick's start (bar: the frame at its longest, ending at worst; tick mark: deadline)")
    axes.set_title(f"{rig.name}, {rig.bus.protocol}, {rig.rate_hz:g} Hz: worst-case load {analysis.bus_load:.1%}")
    save_picture(figure, target)
    pyplot.close(figure)
