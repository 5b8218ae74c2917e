"""`hil bench …`: each benchmark is one function in a module of its own; only the one asked for is imported."""

import importlib
import sys
from collections.abc import Callable
from typing import Any

import typer

BENCHES = {
    "tick": "CPU per tick by stage, system calls and allocations, against a C program doing the same work",
    "jitter": "Wake lateness of the full loop, against cyclictest on the same core",
    "misses": "Slots that a long run loses, against a C program that touches as much memory",
    "peers": "The same tick with python-can + cantools, with canopen, with moteus",
    "io": "Receiving and sending through the bus layer alone",
    "lockstep": "How much faster than real time a whole rig runs in lockstep",
    "batch": "Plants times ticks per second of the batch engine",
    "profile": "Where a tick's time goes, function by function",
    "ring": "What telemetry costs the control process, and how far a reader lags",
}


def _not_loaded() -> None:
    raise AssertionError("only the benchmark asked for is loaded")


def build_bench(wanted: str | None) -> typer.Typer:
    """The group with `wanted` loaded and all others as lines of help."""
    group = typer.Typer(no_args_is_help=True, help="Measurements, as ratios against a reference in the same run.")
    for name, text in BENCHES.items():
        function: Callable[..., Any] = _not_loaded
        if name == wanted:
            function = getattr(importlib.import_module(f"tests.benchmarks.{name}"), name)
        group.command(name, help=text)(function)
    return group


bench = build_bench(next((word for word in sys.argv[2:] if not word.startswith("-")), None))
