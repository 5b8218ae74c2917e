"""`hil learnt`: what the law of a recorded run had learnt at its end, by running the recording through a new cycle."""

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from hil.rig.file import learning_hash
from hil.rig.learnt_file import write_learnt_file
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigConfig
from hil.telemetry.recording import Recording, RecordingError


def learnt_of_run(recording: Recording) -> tuple[RigConfig, dict[str, list[float]]]:
    """The rig of a recording, and by axis what its law had learnt; no axis where it learns no repeats by itself. Raises
    RecordingError, RigError.
    """
    from hil.virtual.replay import Tasks, new_cycle, steps

    with ExitStack() as stack:
        rig, base_dir = stack.enter_context(rig_of_run(recording.metadata))
        cycle, tasks = new_cycle(rig, base_dir), Tasks(recording, rig)
        for step in steps(recording):
            step.tick.task = tasks.of(step.tick)
            cycle.step(step.tick, step.received)
        laws = getattr(cycle.axes.law, "laws", [])
        states = [law.learnt_state() for law in laws]
    return rig, {name: state for name, state in zip(rig.axis_names, states, strict=False) if state}


def learnt(
    recording: Annotated[Path, typer.Argument(help="run.mcap of a live or lockstep run", show_default=False)],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="default: learnt.json beside it")] = None,
) -> None:
    """Write what the law of a run has learnt over its repeats, for `law.learnt` of the same rig."""
    target = output or recording.with_name("learnt.json")
    try:
        rig, state = learnt_of_run(Recording(recording))
        if not state:
            raise RecordingError(
                f"{recording}: its law ({rig.law.name}, law.iterative_learning = "
                f"{str(rig.law.iterative_learning).lower()}) keeps nothing that it learns"
            )
        write_learnt_file(target, rig.name, learning_hash(rig), state)
    except (RecordingError, OSError) as error:
        print(f"hil learnt: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    print(f"{target}: for law.learnt of {rig.name} ({learning_hash(rig)[:12]})")
