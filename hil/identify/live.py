"""The experiments in real time, on the rig itself or, where its bus is local, on a live emulated stage.

Rules:
- Each experiment is a run of its own: control process and sidecar are started for it, as an operator would start them.
  Gate, fault detectors, stop line and recorder are those of every other run; `hil estop NAME` stops it.
- On a rig nothing moves before the operator has agreed to the experiment's way, speed, force and time.
- An experiment that came to its end is kept, and is not run again for the same rig and plan. One that ended in a
  fault, or lost too many ticks to be fitted, is not kept: the next start runs it again.
- Where this computer held up an emulated stage, the experiment is tried again. On a rig that is the operator's to
  decide.
"""

import contextlib
import hashlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from drivers.base.named_file import write_text
from drivers.base.runtime import runtime_dir
from drivers.base.toml_file import toml_text
from hil.identify.experiments import ROW_S
from hil.identify.lockstep import AFTER_S, Trial
from hil.identify.signals import too_many_lost
from hil.operate.demo_live import RECORDING, Demo, Scene, Signals, private_runtime
from hil.rig.file import load_rig, rig_hash
from hil.rig.schema import RigConfig
from hil.runs.api import Run, load_run
from hil.runs.rigs import Rig

RIG_FILE = "rig.toml"
TRIES = 5  # on an emulated stage
ENABLE_S = 1.0  # from ACTIVE to the beginning of the task, at most


class LiveError(Exception):
    """An experiment was not run to its end; the text says why."""


class TooBusyError(LiveError):
    """This computer held a process up."""


class LiveExperiments:
    """A Runner (hil/identify/lockstep.py) in real time.

    out: folder for the recordings, one below it an experiment. agrees: asked before a real axis moves, with what it
    will do. runtime: directory in which the processes meet. Raises LiveError as it is called, and OSError.
    """

    def __init__(
        self, out: Path, console: Console, signals: Signals, agrees: Callable[[str], bool], runtime: Path
    ) -> None:
        self._out, self._console, self._signals, self._agrees, self._runtime = out, console, signals, agrees, runtime

    def __call__(self, trial: Trial) -> tuple[Run, str]:
        """The run of one experiment, with the hash of its recording; of an earlier start, where it has it."""
        rig = Rig.build(live_document(trial.document), trial.folder)
        kept = self._out / f"{trial.axis}-{trial.experiment}"
        before = _finished(kept, rig.sha256)
        if before is not None:
            self._say(f"{trial.axis}, {trial.experiment}: recorded before, in {kept}")
            return before, _digest(kept)
        if is_emulated(rig.config):
            for _ in range(TRIES - 1):
                try:
                    return self._run(trial, kept)
                except TooBusyError as error:
                    self._say(f"{error}; once more")
        elif not self._agrees(what_moves(trial, rig.config)):
            raise LiveError(f"{trial.axis}, {trial.experiment}: not agreed to; nothing moved")
        return self._run(trial, kept)

    def _run(self, trial: Trial, kept: Path) -> tuple[Run, str]:
        begun = kept.with_name(f"{kept.name}.part")
        shutil.rmtree(begun, ignore_errors=True)
        begun.mkdir(parents=True)
        file = trial.folder / f".{trial.axis}-{trial.experiment}-{RIG_FILE}"  # what the rig names lies beside it
        try:
            write_text(file, toml_text(live_document(trial.document)))
            rig = load_rig(file)
            scene = Scene(rig, file, (), self._runtime, begun, is_emulated(rig))
            stage = Demo(scene, self._console, self._signals, insists=False, holds=False)
            stage.run(ENABLE_S + trial.seconds + AFTER_S)
        finally:
            file.unlink(missing_ok=True)
        where = f"{trial.axis}, {trial.experiment}"
        if self._signals.seen:
            raise LiveError(f"{where}: interrupted")
        if stage.busy:
            raise TooBusyError(f"{where}: {stage.busy}")
        run = load_run(begun) if (begun / RECORDING).exists() else None
        if run is None or (stage.troubles and not run.summary()["faults"]):
            raise LiveError(f"{where}: {stage.troubles[0] if stage.troubles else 'nothing was recorded'}")
        if not stage.troubles and (missing := too_many_lost(run)):
            raise TooBusyError(f"{where}: {missing}")
        if not stage.troubles and not run.summary()["faults"]:
            shutil.rmtree(kept, ignore_errors=True)
            begun = begun.replace(kept)
        return run, _digest(begun)

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def is_emulated(rig: RigConfig) -> bool:
    """A local bus has no drives but emulated ones."""
    return rig.bus.interface == "local"


def live_document(document: dict[str, Any]) -> dict[str, Any]:
    """The same rig, recorded; where its stage is emulated, on a machine that grants no real time, too."""
    telemetry = {**document["telemetry"], "record": True}
    timing = dict(document["timing"])
    if document["bus"]["interface"] == "local":
        timing["allow_degraded"] = True
    return {**document, "telemetry": telemetry, "timing": timing}


def what_moves(trial: Trial, rig: RigConfig) -> str:
    """What an experiment does, for who has to agree: way, speed, force and time, each with its limit."""
    axis, rows = rig.axes[trial.axis], trial.plan.positions
    unit, force = ("m", "N") if axis.kind == "linear" else ("rad", "N m")
    speed = float(np.abs(np.diff(rows)).max()) / ROW_S
    low, high = axis.limits.position
    return (
        f"{trial.axis}, {trial.experiment}: {trial.seconds:.0f} s, from {rows.min():.4g} to {rows.max():.4g} {unit} "
        f"(travel {low:.4g} to {high:.4g}), up to {speed:.3g} {unit}/s, at most {axis.limits.force:.3g} {force}. "
        f"It goes first to {rows[0]:.4g} {unit}. Stop it with Ctrl-C or hil estop {rig.name}"
    )


@contextlib.contextmanager
def live_runtime(rig: RigConfig) -> Iterator[Path]:
    """Where the processes meet: of a rig, where `hil estop` looks; of an emulated stage, a private directory."""
    if not is_emulated(rig):
        yield runtime_dir()
        return
    runtime = private_runtime()
    try:
        yield runtime
    finally:
        shutil.rmtree(runtime, ignore_errors=True)


def _finished(kept: Path, wanted: str) -> Run | None:
    """The run kept there, where it is of the rig with that hash."""
    if not (kept / RECORDING).exists():
        return None
    run = load_run(kept)
    return run if rig_hash(run.rig) == wanted else None


def _digest(folder: Path) -> str:
    return hashlib.sha256((folder / RECORDING).read_bytes()).hexdigest()
