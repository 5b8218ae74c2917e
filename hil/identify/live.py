"""The experiments in real time, on the rig itself or, where its bus is local, on a live emulated stage.

Rules:
- Each experiment is a run of its own: control process and sidecar are started for it, as an operator would start them.
  Gate, fault detectors, stop line and recorder are those of every other run; `hil estop NAME` stops it.
- On a rig nothing moves before the operator has agreed to the experiment's way, speed, force and time, nor without a
  key that is held meanwhile. It stops when the key is let go, or when this process is gone: by safety.heartbeat_s,
  HEARTBEAT_S where the rig file has none.
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
from hil.cycle.fault_table import Fault
from hil.identify.estimate import Refused
from hil.identify.experiments import ROW_S, middle
from hil.identify.findings import passes_of
from hil.identify.frequency_fit import too_few_pairs
from hil.identify.lockstep import AFTER_S, Trial
from hil.identify.signals import signals, too_many_lost
from hil.operate.dead_man import NAMED, Handle
from hil.operate.demo_live import RECORDING, Demo, Scene, Signals, private_runtime
from hil.rig.file import load_rig, rig_hash
from hil.rig.home_table import SPEED
from hil.rig.schema import RigConfig
from hil.runs.api import Run, load_run
from hil.runs.rigs import Rig

RIG_FILE = "rig.toml"
TRIES = 5  # on an emulated stage
HEARTBEAT_S = 0.25
ENABLE_S = 1.0  # from ACTIVE to the beginning of the task, at most


class LiveError(Exception):
    """An experiment was not run to its end; the text says why."""


class TooBusyError(LiveError):
    """This computer held a process up."""


class LiveExperiments:
    """A Runner (hil/identify/lockstep.py) in real time.

    out: folder for the recordings, one below it an experiment. agrees: asked before a real axis moves, with what it
    will do. handle: of the key that has to be held; None: it moves without one. runtime: directory in which the
    processes meet. Raises LiveError as it is called, and OSError.
    """

    def __init__(
        self,
        out: Path,
        console: Console,
        signals: Signals,
        agrees: Callable[[str], bool],
        runtime: Path,
        handle: Handle | None = None,
    ) -> None:
        self._out, self._console, self._signals, self._agrees, self._runtime = out, console, signals, agrees, runtime
        self._handle = handle

    def __call__(self, trial: Trial) -> tuple[Run, str]:
        """The run of one experiment, with the hash of its recording; of an earlier start, where it has it."""
        rig = Rig.build(self._document(trial), trial.folder)
        if anywhere := declared_anywhere(trial.axis, rig.config):
            raise LiveError(anywhere)
        kept = kept_in(self._out, trial.axis, trial.experiment)
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
            write_text(file, toml_text(self._document(trial)))
            rig = load_rig(file)
            scene = Scene(rig, file, (), self._runtime, begun, is_emulated(rig))
            with contextlib.nullcontext() if self._handle is None else self._handle() as held:
                stage = Demo(scene, self._console, self._signals, insists=False, holds=False, held=held)
                stage.run(ENABLE_S + trial.seconds + AFTER_S)
        finally:
            file.unlink(missing_ok=True)
        where = f"{trial.axis}, {trial.experiment}"
        if self._signals.seen:
            raise LiveError(f"{where}: interrupted")
        if stage.busy:
            raise TooBusyError(f"{where}: {stage.busy}")
        run = load_run(begun) if (begun / RECORDING).exists() else None
        if run is not None and Fault.HEARTBEAT_LOST.name in run.summary()["faults"]:
            raise LiveError(f"{where}: {NAMED} was let go, and the stage stopped")
        if run is None or (stage.troubles and not run.summary()["faults"]):
            raise LiveError(f"{where}: {stage.troubles[0] if stage.troubles else 'nothing was recorded'}")
        if not stage.troubles and (missing := too_many_lost(run) or _too_many_held_up(run, trial)):
            raise TooBusyError(f"{where}: {missing}")
        if not stage.troubles and not run.summary()["faults"]:
            shutil.rmtree(kept, ignore_errors=True)
            begun = begun.replace(kept)
        return run, _digest(begun)

    def _document(self, trial: Trial) -> dict[str, Any]:
        return live_document(trial.document, heartbeat=self._handle is not None)

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def is_emulated(rig: RigConfig) -> bool:
    """A local bus has no drives but emulated ones."""
    return rig.bus.interface == "local"


def live_document(document: dict[str, Any], *, heartbeat: bool = False) -> dict[str, Any]:
    """The same rig, recorded, with an operator's heartbeat. Where its stage is emulated, that only as asked; and on a
    machine that grants no real time, too.
    """
    telemetry, timing, safety = {**document["telemetry"], "record": True}, dict(document["timing"]), document["safety"]
    emulated = document["bus"]["interface"] == "local"
    if emulated:
        timing["allow_degraded"] = True
    if heartbeat or not emulated:
        safety = {**safety, "heartbeat_s": safety["heartbeat_s"] or HEARTBEAT_S}
    return {**document, "telemetry": telemetry, "timing": timing, "safety": safety}


def what_moves(trial: Trial, rig: RigConfig) -> str:
    """What an experiment does, for who has to agree: way, speed, force and time, each with its limit."""
    axis, rows = rig.axes[trial.axis], trial.plan.positions
    unit, force = ("m", "N") if axis.kind == "linear" else ("rad", "N m")
    speed = float(np.abs(np.diff(rows)).max()) / ROW_S
    low, high = axis.limits.position
    return (
        f"{trial.axis}, {trial.experiment}: {trial.seconds:.0f} s, from {rows.min():.4g} to {rows.max():.4g} {unit} "
        f"(travel {low:.4g} to {high:.4g}), up to {speed:.3g} {unit}/s, at most {axis.limits.force:.3g} {force}. "
        f"It goes first to {rows[0]:.4g} {unit}.{_homing(rig)} Stop it with Ctrl-C or hil estop {rig.name}"
    )


def _homing(rig: RigConfig) -> str:
    """What moves before an experiment, as each is a run of its own that has to home."""
    told = [
        f"{name} homes by {axis.home.by}, up to {axis.home.farthest:g} {unit} "
        f"at {axis.home.speed or SPEED * axis.limits.speed:.3g} {unit}/s"
        for name, axis in rig.axes.items()
        if axis.home is not None and axis.home.moves and (unit := "m" if axis.kind == "linear" else "rad")
    ]
    return f" Before that {', '.join(told)}." if told else ""


def declared_anywhere(name: str, rig: RigConfig) -> str:
    """In words, where an axis would be declared elsewhere by each experiment's homing; else ""."""
    axis = rig.axes[name]
    centre, _ = middle(axis)
    if axis.home is None or axis.home.by != "here" or abs(axis.home.at - centre) <= axis.limits.following_error:
        return ""
    return (
        f'{name}: home.by = "here" takes where the axis stands for {axis.home.at:g}, but each experiment is a run of '
        f"its own, and leaves the axis at {centre:g}: put the axis there and state home.at = {centre:g}, or home it "
        "another way"
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


def _too_many_held_up(run: Run, trial: Trial) -> str:
    """In words, where the frequency response cannot be fitted for the ticks that are missing; else ""."""
    if trial.experiment != "frequency" or run.summary()["faults"]:
        return ""
    try:
        passes = passes_of(signals(run, trial.axis, trial.folder), trial.plan)
    except Refused:
        return ""  # the fit says why
    return too_few_pairs(passes)


def kept_in(out: Path, axis: str, experiment: str) -> Path:
    """Folder of an experiment's recording, once it has come to its end."""
    return out / f"{axis}-{experiment}"


def _finished(kept: Path, wanted: str) -> Run | None:
    """The run kept there, where it is of the rig with that hash."""
    if not (kept / RECORDING).exists():
        return None
    run = load_run(kept)
    return run if rig_hash(run.rig) == wanted else None


def _digest(folder: Path) -> str:
    return hashlib.sha256((folder / RECORDING).read_bytes()).hexdigest()
