"""A batch in real time: on an emulated stage that is started for it, or of a rig that runs."""

import contextlib
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.console import Console

from hil.cycle.goal import MotionError
from hil.live.runtime_paths import RuntimePaths, nearest, runtime_paths_in
from hil.operate.demo_live import ALWAYS, Interrupted, Scene, Signals, private_runtime
from hil.operate.keys import Keys
from hil.operate.moving import open_link
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.inject.batch import Batch, Follower
from hil.studies.inject.equipment import Positions, has_equipment
from hil.studies.inject.live import LiveBatch, LiveInjection, follow
from hil.studies.inject.requests import Script
from hil.telemetry.blackbox import run_directory

_WHILE_S = 1e6  # longer than any batch


def run_live(
    rig: RigConfig, rig_file: Path, words: Sequence[str], followers: Sequence[Follower], script: Script,
    console: Console,
) -> Batch:  # fmt: skip
    """Start stage, control process and sidecar as `hil demo` does, and follow the batch to its end."""
    chosen = (*words, *ALWAYS)
    scene = Scene(load_rig(rig_file, chosen), rig_file, chosen, private_runtime(), run_directory())
    scene.out.mkdir(parents=True, exist_ok=True)
    with _keys(console) as keys:
        stage = LiveInjection(scene, console, Signals(), followers, script, keys)
        try:
            stage.run(_WHILE_S)
        finally:
            shutil.rmtree(scene.runtime, ignore_errors=True)
    console.print(f"recording: {scene.out}/run.mcap", soft_wrap=True)
    batch = Batch(planned=len(rig.motion.parameters["cells"])) if stage.live is None else stage.live.batch
    if stage.live is not None:
        _say(stage.live.troubles, console)
    if stage.stalls:
        console.print(f"{stage.stalls} stop(s) because this computer was too busy: reset, activated again")
    _say([*stage.troubles, *([stage.busy] if stage.busy else [])], console)
    batch.failure = stage.busy or (stage.troubles[0] if stage.troubles else "")
    return batch


def cells_of_running(name: str) -> tuple[RigConfig, Positions]:
    """The rig of that name which runs here, and where its cells are. Raises MotionError, RigError."""
    with open_link(name) as link:
        rig = link.rig
    if not has_equipment(rig):
        raise RigError([f'{name}: it runs without [motion] name = "cells"'])
    return rig, [(row[0], row[1]) for row in rig.motion.parameters["cells"]]


def run_attached(rig: RigConfig, followers: Sequence[Follower], script: Script, console: Console) -> Batch:
    """Follow the batch of the rig that runs, from now on. Raises MotionError."""
    paths = nearest(rig.name, _paths, MotionError)
    signals = Signals()
    with _keys(console) as keys, contextlib.closing(LiveBatch(paths, rig, followers, script, keys)) as live:
        with contextlib.suppress(Interrupted):
            follow(live, signals)
        _say(live.troubles, console)
        return live.batch


def _paths(directory: Path) -> RuntimePaths:
    found = runtime_paths_in(directory.parent, directory.name)
    if not found.ring.exists():
        raise MotionError(f"{directory.name} does not run here")
    return found


@contextlib.contextmanager
def _keys(console: Console) -> Iterator[Callable[[], str]]:
    """What is pressed at this terminal; nothing where there is none."""
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    console.print("keys: p pause, r resume, s skip the cell, a abort; Ctrl-C aborts, too")
    with Keys(sys.stdin.fileno()) as keys:
        yield lambda: keys.within(0.0)


def _say(texts: Sequence[str], console: Console) -> None:
    for text in dict.fromkeys(texts):
        console.print(text, soft_wrap=True, markup=False)
