"""The report of a survey, for people and as JSON."""

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drivers.protocols.frame_text import Reader
from hil.operate.bringup.frame_log import Comparison
from hil.operate.bringup.survey import AxisReport, NodeReport, SurveyReport
from hil.operate.bus_statistics import identifier

_SLOW = 1.2  # times a tick's period


def as_document(report: SurveyReport, reader: Reader) -> dict[str, Any]:
    """The report as `--json` writes it."""
    return {
        "rig": report.rig,
        "ready": report.ready,
        "other_host": report.intruder or None,
        "nodes": [{**vars(n.identity), "axis": n.axis, "state": n.state, "boot_ups": n.boot_ups} for n in report.nodes],
        "missing_nodes": report.missing,
        "emergencies": report.emergencies,
        "error_frames": report.error_frames,
        "pace": report.pace,
        "axes": [
            {
                **{key: value for key, value in vars(axis).items() if key not in ("steps", "status")},
                "status": None if axis.status is None else status_words(axis),
                "steps": [vars(step) for step in axis.steps],
            }
            for axis in report.axes
        ],
        "frames": [_frame_document(frame, reader) for frame in report.frames],
        "unknown_frames": [
            {"id": identifier(last.can_id), "count": count, "data": last.data.hex()} for count, last in report.unknown
        ],
    }


def _frame_document(seen: Comparison, reader: Reader) -> dict[str, Any]:
    expected = seen.expected
    return {
        "name": expected.name,
        "sender": expected.sender,
        "id": identifier(expected.can_id),
        "expected": {"bytes": expected.length, "fd": expected.fd, "period_s": expected.period_ns * 1e-9},
        "frames": seen.frames,
        "period_s": seen.period_s,
        "data": seen.last.data.hex() if seen.last else "",
        "text": reader(seen.last) if seen.last else "",
        "problem": seen.problem,
    }


def status_words(axis: AxisReport) -> str:
    """What a drive says of itself."""
    if axis.status is None:
        return "nothing that can be read"
    words = " ".join(flag.name.lower().replace("_", " ") for flag in axis.status if flag.name)
    state = axis.state.lower().replace("_", " ")
    return ", ".join(part for part in (state, words or "not enabled") if part)


def show(report: SurveyReport, reader: Reader, console: Console) -> None:
    """The report for people."""
    if report.intruder:
        console.print(
            f"[bold red]somebody else commands these drives[/]: {escape(report.intruder)}. Nothing was sent",
            soft_wrap=True,
        )
        return
    if report.nodes or report.missing:
        _show_nodes(report, console)
    for text in report.emergencies:
        console.print(f"[bold]emergency[/] {escape(text)}", soft_wrap=True)
    if report.error_frames:
        console.print(f"[bold]{report.error_frames} error frames[/] of the CAN controller; see hil bus view")
    for axis in report.axes:
        if axis.steps:
            _show_steps(axis, console)
    if report.frames:
        _show_frames(report, reader, console)
    for axis in report.axes:
        where = "no position" if axis.position is None else f"position {axis.position:+.6g}"
        console.print(f"axis {axis.name}: {where}; drive: {status_words(axis)}", soft_wrap=True)
        if axis.problem:
            console.print(f"  [bold red]{escape(axis.problem)}[/]", soft_wrap=True)
    console.print("[bold green]ready[/]" if report.ready else "[bold red]not ready[/]")


def _show_nodes(report: SurveyReport, console: Console) -> None:
    table = Table("node", "axis", "device type", "name", "vendor", "product", "revision", "serial", "state", "boot-ups")
    for node in report.nodes:
        table.add_row(*_node_cells(node))
    console.print(table)
    for number in report.missing:
        console.print(f"[bold red]node {number} does not answer[/]: power, node number, bit rate, wiring")


def _node_cells(node: NodeReport) -> list[str]:
    who = node.identity
    numbers = [f"{value:#x}" if value is not None else "-" for value in (who.vendor, who.product, who.revision)]
    device = f"{who.device_type:#x}" if who.device_type is not None else "-"
    serial = str(who.serial) if who.serial is not None else "-"
    axis = node.axis or "not in the rig"
    return [
        str(who.node_id), axis, device, escape(who.name) or "-", *numbers, serial, node.state or "-", str(node.boot_ups)
    ]  # fmt: skip


def _show_steps(axis: AxisReport, console: Console) -> None:
    title = f"axis {axis.name}, node {axis.node}: {axis.drive}"
    table = Table("object", "value", "need", "why", "answer", title=escape(title), title_justify="left", box=None)
    for step in axis.steps:
        value = "-" if step.value is None else f"{step.value:#x}"
        style = (
            "bold red" if "aborted" in step.answer or step.answer == "no answer" or "expected" in step.answer else ""
        )
        shown = f"[{style}]{escape(step.answer)}[/]" if style else escape(step.answer)
        table.add_row(step.object, f"{step.action} {value}", step.need, escape(step.why), shown)
    console.print(table)


def _show_frames(report: SurveyReport, reader: Reader, console: Console) -> None:
    table = Table("frame", "id", "expected", "heard", "last", "meaning", title="frames", title_justify="left")
    for seen in report.frames:
        expected = seen.expected
        due = f"{expected.length} bytes every {expected.period_ns / 1e6:.3g} ms"
        heard = f"{seen.frames}, every {seen.period_s * 1e3:.3g} ms" if seen.frames > 1 else str(seen.frames)
        meaning, data = (reader(seen.last), seen.last.data) if seen.last else ("", b"")
        text = f"[bold red]{escape(seen.problem)}[/] " if seen.problem else ""
        table.add_row(expected.name, identifier(expected.can_id), due, heard, data.hex(" "), text + escape(meaning))
    console.print(table)
    if report.pace > _SLOW:
        console.print(
            f"this computer was slow: ticks took {report.pace:.2g} times their period, and what answers them with them",
            soft_wrap=True,
        )
    for count, last in report.unknown:
        name, said = identifier(last.can_id), escape(reader(last))
        console.print(f"not expected: {name}, {count} frames, last {last.data.hex(' ')} {said}")
