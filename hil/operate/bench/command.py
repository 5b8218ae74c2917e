"""`hil bench ...`: measurements of this machine and this rig. Those of the product itself, against C and against other
libraries, are in tests/benchmarks.
"""

import sys

import typer

from hil.cli.commands import Entry, add_commands, first_word

BENCHES = {
    "jitter": Entry("hil.operate.bench.jitter:jitter", "Wake lateness of the full loop, against cyclictest"),
    "bus": Entry("hil.operate.bench.bus:bus", "Round trip, jitter and loss of your own adapter and drives"),
}

bench = typer.Typer(no_args_is_help=True, help="Measurements of this machine, as ratios against a reference.")
add_commands(bench, BENCHES, first_word(sys.argv[2:]))
