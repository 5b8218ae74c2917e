"""Replay: the frames, commands and times of a recording through a new control cycle, compared byte for byte.

Code that a recording carries runs only where its digest is permitted (hil/rig/carried_code.py).
"""

import dataclasses
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from google.protobuf.message import DecodeError

from drivers.base import plugins
from drivers.base.text_file import words_of
from drivers.frame import Frame
from hil.cycle.command_desk import LOADS
from hil.cycle.record import MAX_RECEIVED, MOTION_FIELDS, RECORD
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind, Tick
from hil.events.event import Event
from hil.events.sources import events_of
from hil.live.task_loading import loaded_law, loaded_task, rig_with_law, rig_with_task
from hil.rig.baseline_file import is_baseline
from hil.rig.carried_code import carried_code
from hil.rig.provenance import other_version, rig_of_run
from hil.rig.schema import RigConfig, RigError
from hil.telemetry import codec, cycle_codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.recording import Gaps, Recording, RecordingError, loss_text

_EXACT = [*MOTION_FIELDS, "stamp_ns"]
_LARGEST = 2**60  # ns: 36 years of a monotonic clock
_TRAFFIC: dict[str, Callable[[bytes], Iterator[codec.RecordedTick]]] = {
    "cycle": lambda data: cycle_codec.recorded_ticks(pb.Cycle.FromString(data)),
    "traffic": lambda data: codec.recorded_ticks(pb.Traffic.FromString(data)),  # of the earlier layout
}


@dataclasses.dataclass
class Replayed:
    """What came of it. different: ticks whose sent frames differ from the recorded ones in any byte."""

    recording: str
    rig: str
    rig_hash: str
    recorded_version: str
    ticks: int = 0
    different: int = 0
    first_different: int | None = None  # tick index
    frames: int = 0
    gap_at: int | None = None  # ring index at which ticks are missing; the cycle's state is unknown from there on
    not_compared: int = 0  # ticks that are recorded behind such a gap
    loss: str = ""  # what is missing, in ticks and seconds; empty where nothing is
    parts: int = 1  # files
    truncated: bool = False
    other_version: str = ""  # which version recorded it and which this is, where they are two
    events: list[Event] = dataclasses.field(default_factory=list)
    latched: Event | None = None  # of the fault that the run ended with
    other_law: str | None = None
    other_force: dict[str, dict[str, float]] | None = None  # per axis: RMS and largest difference, N


def new_cycle(rig: RigConfig, base_dir: Path) -> ControlCycle:
    """Raises RigError where this rig cannot have one."""
    try:
        return ControlCycle(rig, base_dir)
    except (ValueError, OSError) as error:  # another law, or overrides, that this rig cannot have
        raise RigError([f"rig {rig.name}: {error}"]) from None


class _Comparison:
    """Runs a second rig over the same ticks; how its force differs, in open loop: the stage did not feel it.

    recorded: the rig that ran. Laws that were set while it did are set here only where both have one law.
    """

    def __init__(self, rig: RigConfig, base_dir: Path, recorded: RigConfig) -> None:
        self._keeps_law = rig.law != recorded.law
        self._names = rig.axis_names
        self._cycle = new_cycle(rig, base_dir)
        self._squares = np.zeros(len(self._names))
        self._largest = np.zeros(len(self._names))
        self._ticks = 0
        self.law = rig.law.name

    def step(self, recorded: codec.RecordedTick, force: np.ndarray) -> None:
        n = len(self._names)
        if self._keeps_law:
            recorded.tick.law = None
        other = self._cycle.step(recorded.tick, recorded.received).record["force"][:n]
        difference = np.abs(other - force[:n])
        self._squares += difference**2
        np.maximum(self._largest, difference, out=self._largest)
        self._ticks += 1

    def result(self) -> dict[str, dict[str, float]]:
        rms = np.sqrt(self._squares / max(self._ticks, 1))
        return {
            name: {"rms": float(rms[axis]), "max": float(self._largest[axis])} for axis, name in enumerate(self._names)
        }


def _check(step: codec.RecordedTick) -> None:
    """Raise ValueError where a number is larger than a control process can have met: its cycle need not bear that."""
    tick, frames = step.tick, step.received
    if len(frames) > MAX_RECEIVED or any(len(frame.data) > 64 or frame.flags > 0xFF for frame in frames):
        raise ValueError(f"the frames received in tick {tick.index}")
    numbers = (tick.index, tick.scheduled_ns, tick.now_ns, *tick.port, *(frame.timestamp_ns for frame in frames))
    if max(map(abs, numbers)) > _LARGEST:
        raise ValueError(f"the times or counters of tick {tick.index}")


def loaded_documents(recording: Recording) -> dict[int, str]:
    """The tasks and laws that were loaded on the way, by the number of the command that did."""
    found = {}
    for item in recording:
        if item.topic == "commands":
            try:
                entry = pb.CommandEntry.FromString(item.data)
            except DecodeError as error:
                raise RecordingError(f"{recording.path}: a command makes no sense: {error}") from None
            if entry.kind in LOADS and entry.task:
                found[entry.posted] = entry.task.decode(errors="replace")
    return found


class Loads:
    """What a recording's LOAD_TASK and SET_LAW commands load, made anew for a rig."""

    def __init__(self, recording: Recording, rig: RigConfig) -> None:
        self._recording, self._rig = recording, rig
        self._documents: dict[int, str] | None = None

    def into(self, tick: Tick) -> None:
        """Give a tick what its commands load, if they do. Raises RecordingError."""
        for command in tick.commands:
            if command.kind in LOADS:
                if self._documents is None:
                    self._documents = loaded_documents(self._recording)
                self._load(tick, command.kind, self._documents.get(command.sequence, ""))

    def _load(self, tick: Tick, kind: int, document: str) -> None:
        what = "law" if kind == CommandKind.SET_LAW else "task"
        named = f"{self._recording.path}: the {what} that tick {tick.index} loads"
        if not document:
            raise RecordingError(f"{named} is not in it")
        try:
            if kind == CommandKind.SET_LAW:
                tick.law = loaded_law(rig_with_law(self._rig, document))
            else:
                tick.task = loaded_task(rig_with_task(self._rig, document))
        except (RigError, ValueError) as error:
            raise RecordingError(f"{named}: {error}") from None


def steps(recording: Recording) -> Iterator[codec.RecordedTick]:
    """Every recorded tick once, in order: a sidecar that was killed may have left ticks whose recording its successor
    did not know of. Raises RecordingError for a message that no control process can have caused.
    """
    following = 0  # ring index
    for item in recording:
        if item.topic in _TRAFFIC:
            try:
                ticks = list(_TRAFFIC[item.topic](item.data))
                for step in ticks:
                    _check(step)
            except (DecodeError, ValueError, TypeError, IndexError, RuntimeError) as error:
                raise RecordingError(f"{recording.path}: its traffic makes no sense: {words_of(error)}") from None
            yield from (step for step in ticks if step.ring >= following)
            following = max([following, *(step.ring + 1 for step in ticks[-1:])])


def bytes_of(frames: list[Frame]) -> list[tuple[int, bytes, int]]:
    """What of frames goes over the wire."""
    return [(frame.can_id, bytes(frame.data), frame.flags) for frame in frames]


def _nothing() -> None:
    """Before code runs that needs no preparation."""


def replay_run(
    path: Path,
    overrides: tuple[str, ...] = (),
    permitted: Collection[str] = (),
    prepare: Callable[[], None] = _nothing,
) -> Replayed:
    """Replay a recording as far as it goes. permitted: digests of code that it carries and that may run, beside what
    `overrides` choose. prepare: called before any of it runs. Raises RecordingError, RigError.
    """
    recording = Recording(path)
    meta = recording.metadata
    with ExitStack() as stack:
        rig, base_dir = stack.enter_context(rig_of_run(meta))
        changed = stack.enter_context(rig_of_run(meta, overrides)) if overrides else None
        chosen = {*carried_code(changed[0])} - {*carried_code(rig)} if changed else set()
        stack.enter_context(plugins.only({*permitted, *(code.digest for code in chosen)}))
        prepare()
        report = Replayed(str(path), rig.name, meta["rig_hash"], meta["version"])
        cycle, loads = new_cycle(rig, base_dir), Loads(recording, rig)
        baseline = meta.get("baseline")
        stream = events_of(rig, baseline if is_baseline(baseline, rig.axis_names) else None)
        other = _Comparison(*changed, rig) if changed else None
        gaps = Gaps()
        for step in steps(recording):
            gaps.add(step.ring, 1, 0, damaged=recording.truncated)
            if report.gap_at is not None or step.ring != report.ticks:
                report.gap_at = report.ticks if report.gap_at is None else report.gap_at
                report.not_compared += 1
                continue
            loads.into(step.tick)
            result = cycle.step(step.tick, step.received)
            report.events += stream.observe(cycle, result.record)
            report.ticks += 1
            report.frames += len(step.sent)
            if bytes_of(result.frames) != bytes_of(step.sent):
                report.different += 1
                if report.first_different is None:
                    report.first_different = step.tick.index
            if other:
                other.step(step, result.record["force"])
        if other:
            report.other_law, report.other_force = other.law, other.result()
        report.events += stream.close()
        report.latched = stream.latched
    report.loss = loss_text(gaps.found, rig.period_ns * 1e-9, damaged=recording.truncated)
    report.truncated, report.parts = recording.truncated, max(len(recording.parts), 1)
    report.other_version = other_version(meta)
    return report


def code_of_recording(path: Path) -> list[str]:
    """Digests of the code that a recording carries. Raises RecordingError, RigError."""
    with rig_of_run(Recording(path).metadata) as (rig, _):
        return [code.digest for code in carried_code(rig)]


def exact_motion(path: Path) -> dict[str, np.ndarray] | None:
    """The recorded motion to the last bit, by running the cycle again: arrays (ticks, axes) by field of the record;
    of a rig with sensors also "readings", (ticks, sensors).

    None where no cycle comes to the same frames: another version of it, ticks that are missing, or code that the
    recording carries, which is not run. Raises RecordingError, RigError.
    """
    recording = Recording(path)
    kept: list[bytes] = []
    with rig_of_run(recording.metadata) as (rig, base_dir), plugins.only(()):
        try:
            cycle, loads = new_cycle(rig, base_dir), Loads(recording, rig)
        except RigError:
            return None
        fields = [*_EXACT, "readings"] if rig.sensors else _EXACT
        for step in steps(recording):
            loads.into(step.tick)
            result = cycle.step(step.tick, step.received)
            if step.ring != len(kept) or bytes_of(result.frames) != bytes_of(step.sent):
                return None
            kept.append(np.asarray(result.record[fields]).tobytes())
    records = np.frombuffer(b"".join(kept), RECORD[fields])
    widths = {"readings": len(rig.sensors)}
    return {name: records[name][:, : widths.get(name, len(rig.axes))].copy() for name in fields}
