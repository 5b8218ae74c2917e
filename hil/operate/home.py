"""`hil home RIG`: let a running rig find the positions of its axes, and wait until it has."""

import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hil.cli.exit_status import EXIT_FAULT, EXIT_UNAVAILABLE
from hil.cycle.axis_homing import Step
from hil.cycle.fault_table import ROWS, Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import nearest
from hil.operate.command import Action, at_hand, config_of, next_step
from hil.telemetry.command_client import NoGatewayError, Verdict

FIELDS = ("index", "state", "fault", "homing", "evidence_of", "evidence_value", "n_evidence")
LONGEST_S = 600.0
_POLL_S = 0.02


def home(
    rig: Annotated[
        Path, typer.Argument(metavar="RIG", help="name of a running rig, or its rig file", show_default=False)
    ],
) -> None:
    """Home the axes and wait until they are at home. Exit status 0: they are; 1: refused; 3: a fault ended it; 69: the
    rig does not run here, or homing takes more than 10 minutes; each with the reason.
    """
    name = config_of(rig).name
    try:
        with at_hand(name) as client:
            verdict = client.command(CommandKind.HOME)
        if not verdict.accepted:
            print("\n".join(refusal(name, verdict)), file=sys.stderr)
            raise typer.Exit(1)
        with nearest(name, _ring, RingError) as ring:
            ring.next = max(ring.written - 1, 0)
            status = _watch(name, ring)
    except (NoGatewayError, RingError) as error:
        print(f"hil home: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    raise typer.Exit(status)


def refusal(name: str, verdict: Verdict) -> list[str]:
    """What to say of a refused homing, with what to do next where there is something."""
    step = next_step(Action.HOME, name, verdict)
    return [f"hil home: {verdict.reason}", *([f"hil home: next: {step}"] if step else [])]


def _ring(directory: Path) -> RingReader:
    return RingReader(directory / "ring")


def _watch(name: str, ring: RingReader) -> int:
    """Say each step until the rig is READY or a fault has latched; the exit status."""
    until, told = time.monotonic() + LONGEST_S, ""
    while time.monotonic() < until and ring.writer_alive:
        for record in ring.read(256, FIELDS).records:
            state, step = State(int(record["state"])), Step(int(record["homing"]) & 15)
            for found in _failures(name, ring, record):
                print(found, file=sys.stderr)
            if state is State.HOMING and step is not Step.NONE and step.name != told:
                told = step.name
                print(told.lower().replace("_", " "), flush=True)
            if state not in (State.HOMING, State.STOPPING):
                return _end(name, state, Fault(int(record["fault"])), int(record["homing"]) >> 4)
        time.sleep(_POLL_S)
    print(f"hil home: {name} is not at home; hil command {name} stop ends it", file=sys.stderr)
    return EXIT_UNAVAILABLE


def _failures(name: str, ring: RingReader, record: np.void) -> list[str]:
    """What HOMING_FAILED says of which axis, in this tick."""
    axes = list(ring.metadata["rig"]["axes"])
    found = []
    for place in range(min(int(record["n_evidence"]), len(record["evidence_of"]))):
        what, value = int(record["evidence_of"][place]), record["evidence_value"][place]
        if what & 0xFFFF == Fault.HOMING_FAILED:
            found.append(f"hil home: {axes[what >> 16]}: {ROWS[Fault.HOMING_FAILED].words[int(value)]}")
    return found


def _end(name: str, state: State, fault: Fault, yet: int) -> int:
    if state is State.READY and not yet:
        print("at home; READY")
        return 0
    why = f"fault {fault.name}" if fault else "stopped on the way"
    print(f"hil home: {name} is {state.name}, {why}; see hil events {name}", file=sys.stderr)
    return EXIT_FAULT if fault else 1
