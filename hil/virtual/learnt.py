"""`hil learnt`: what the law of a recorded run had learnt at its end, by running the recording through a new cycle.

A law that the recording carries runs only where its user has trusted it (`hil replay --trust-its-code`), and confined.
"""

import sys
from collections.abc import Callable, Collection
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from drivers.base import plugins
from hil.rig.carried_code import carried_code, trusted
from hil.rig.file import learning_hash, learning_hashes
from hil.rig.learnt_file import write_learnt_file
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigConfig
from hil.telemetry.recording import Recording, RecordingError
from hil.virtual.sandbox import ConfinedError, confined


def learnt_of_run(
    recording: Recording, permitted: Collection[str] = (), prepare: Callable[[], None] = lambda: None
) -> tuple[RigConfig, dict[str, list[float]]]:
    """The rig of a recording, and by axis what its law had learnt; no axis where it keeps nothing.
    permitted, prepare: as of replay_run. Raises RecordingError, RigError.
    """
    from hil.virtual.replay import Loads, new_cycle, steps

    with ExitStack() as stack:
        rig, base_dir = stack.enter_context(rig_of_run(recording.metadata))
        stack.enter_context(plugins.only(permitted))
        prepare()
        cycle, loads = new_cycle(rig, base_dir), Loads(recording, rig)
        for step in steps(recording):
            loads.into(step.tick)
            cycle.step(step.tick, step.received)
        laws = getattr(cycle.axes.law, "laws", [])
        states = [law.learnt_state() for law in laws]
    return rig, {name: state for name, state in zip(rig.axis_names, states, strict=False) if state}


def _of_trusted(path: Path) -> tuple[RigConfig, dict[str, list[float]]]:
    """The same of a file, by a law that is ours or that this user trusts."""
    recording = Recording(path)
    with rig_of_run(recording.metadata) as (rig, _):
        code = carried_code(rig)
    if not code:
        return learnt_of_run(recording)
    known = trusted()
    if unknown := [part for part in code if part.digest not in known]:
        raise RecordingError(
            f"{path}: {unknown[0].text} is code that came with the recording, and is not run; once you have read it, "
            f"and trust it: hil replay {path} --trust-its-code"
        )
    try:
        state: Any = confined(lambda confine: learnt_of_run(recording, known, confine)[1])
    except ConfinedError as error:
        raise RecordingError(f"{path}: {error}") from None
    return rig, {str(name): [float(value) for value in values] for name, values in state.items()}


def learnt(
    recording: Annotated[Path, typer.Argument(help="run.mcap of a live or lockstep run", show_default=False)],
    output: Annotated[Path | None, typer.Option("--out", "-o", help="default: learnt.json beside it")] = None,
) -> None:
    """Write what the law of a run has learnt, for `law.learnt` of the same rig."""
    target = output or recording.with_name("learnt.json")
    try:
        rig, state = _of_trusted(recording)
        if not state:
            raise RecordingError(f"{recording}: its law ({rig.law.name}) keeps nothing that it learns")
        write_learnt_file(target, rig.name, learning_hash(rig), learning_hashes(rig), state)
    except (RecordingError, OSError) as error:
        print(f"hil learnt: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    print(f"{target}: for law.learnt of {rig.name} ({learning_hash(rig)[:12]})")
