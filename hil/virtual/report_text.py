"""What `hil sim` and `hil replay` make of their reports alike."""

import dataclasses
from typing import Any

from rich.console import Console

from hil.events.table import Kind


def report_document(report: Any) -> dict[str, Any]:
    """A report as JSON has it: its events as objects with names."""
    document: dict[str, Any] = dataclasses.asdict(dataclasses.replace(report, events=[], latched=None))
    latched = report.latched.document if report.latched else None
    return {**document, "events": [event.document for event in report.events], "latched": latched}


def show_latched(report: Any, console: Console) -> None:
    """Where accuracy was lost, and the fault that a run ended with, if it did."""
    for event in report.events:
        if event.kind is Kind.ACCURACY_LOST:
            console.print(event.line, style="yellow", markup=False, highlight=False, soft_wrap=True)
    if report.latched:
        console.print(report.latched.line, style="red", markup=False, highlight=False, soft_wrap=True)
