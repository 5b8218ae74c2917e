"""`make bench ARGS="tick --json FILE"`, which is `python -m tests.benchmarks tick --json FILE`.

Each benchmark is one function in a module of its own; only the one asked for is imported. What a person at a rig
measures is `hil bench`.
"""

import sys

import typer

from hil.cli.app import run
from hil.cli.commands import Entry, add_commands, first_word
from hil.operate.bench.command import BENCHES as BENCHES_AT_A_RIG

BENCHES = BENCHES_AT_A_RIG | {
    name: Entry(f"tests.benchmarks.{name}:{name}", text)
    for name, text in {
        "tick": "CPU per tick by stage, system calls and allocations, against a C program doing the same work",
        "instructions": "Instructions of a live tick of the compiled build, counted by valgrind",
        "misses": "Slots that a long run loses, against a C program that touches as much memory",
        "peers": "The same tick with python-can + cantools, with canopen, with moteus",
        "endurance": "Memory, descriptors, files and lateness of every process over a long live run",
        "io": "Receiving and sending through the bus layer alone",
        "lockstep": "How much faster than real time a whole rig runs in lockstep",
        "scale": "How near to linear a sweep gets over cores, and over a local cluster",
        "batch": "Plants times ticks per second of the batch engine",
        "profile": "Where a tick's time goes, function by function",
        "streams": "Streams of set-points through bad networks, in virtual time",
        "latency": "From a goal that is written to the frame that it changes, by the page and over TLS",
        "page": "What open pages cost the control process, and how much CPU the page takes",
        "ring": "What telemetry costs the control process, and how far a reader lags",
    }.items()
}


def build_bench(wanted: str | None) -> typer.Typer:
    """The command line with `wanted` loaded and all others as lines of help."""
    group = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        help="Measurements, as ratios against a reference in the same run.",
    )
    add_commands(group, BENCHES, wanted)
    return group


if __name__ == "__main__":
    run(build_bench(first_word(sys.argv[1:])))
