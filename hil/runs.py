"""Runs to work with in Python: simulated ones and recorded ones, with one interface.

    import hil

    rig = hil.load_rig("my-stage.toml", ["law.name=structured-kalman"])
    run = hil.simulate(rig, seconds=10.0)
    print(run.summary()["axes"])
    run.plot("run.png")
    run.compare(hil.Recording("runs/last/run.mcap"))

Nothing here prints, exits or reads arguments.
"""

import copy
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.cycle.event import Event as Happened
from hil.cycle.fault_table import Fault
from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CycleResult, Tick
from hil.operate import run_files
from hil.operate.summary import RunData, steady_from
from hil.operate.summary import load_run as read_run
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.file import build_rig, rig_hash
from hil.rig.file import load_rig as read_rig
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import by_name
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import PER_AXIS, PER_TICK
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual import replay as replays
from hil.virtual import sim
from hil.virtual.event_marks import marks_of
from hil.virtual.figures_of_merit import axis_statistics
from hil.virtual.scenario import load_scenario

Array = NDArray[np.float64]
_KEPT = (*PER_TICK, *PER_AXIS)
_FIELDS: dict[str, Any] = dict(RECORD.fields or {})
_OFFSETS = {name: int(_FIELDS[name][1]) for name in _KEPT}
_USED = max(offset + RECORD[name].itemsize for name, offset in _OFFSETS.items())  # bytes of a record with all of them
_HEAD = np.dtype(
    {"names": list(_KEPT), "formats": [RECORD[name] for name in _KEPT], "offsets": [*_OFFSETS.values()],
     "itemsize": _USED}
)  # fmt: skip
_NO_CHANGES: Sequence[str] = ()
_TABLED = ("setpoint", "measured", "estimate", "error", "requested", "force")
EXPORTS = (".csv", ".npz", ".parquet")
RECORDING = "run.mcap"  # in the folder of a run


@dataclass(frozen=True)
class Rig:
    """A validated rig and the folder that the files it names are relative to. Made by `load_rig` or `Rig.build`."""

    config: RigConfig
    folder: Path
    _source: Path | dict[str, Any]
    _overrides: tuple[str, ...] = ()

    @classmethod
    def build(cls, document: dict[str, Any], folder: str | os.PathLike[str] = ".") -> "Rig":
        """From a document as the rig file's TOML would give it. Raises RigError."""
        return _rig(document, Path(folder), ())

    def changed(self, *overrides: str) -> "Rig":
        """The same rig with key.path=value overrides, beyond those it has. Raises RigError."""
        return _rig(self._source, self.folder, (*self._overrides, *overrides))

    @property
    def name(self) -> str:
        """The rig's name."""
        return self.config.name

    @property
    def axes(self) -> list[str]:
        """Names of the axes, in the order of every array's last index."""
        return self.config.axis_names

    @property
    def sha256(self) -> str:
        """Of everything the rig says, the texts of its law's and task's files included."""
        return rig_hash(self.config)


def _rig(source: Path | dict[str, Any], folder: Path, overrides: tuple[str, ...]) -> Rig:
    if isinstance(source, Path):
        return Rig(read_rig(source, overrides), folder, source, overrides)
    return Rig(build_rig(copy.deepcopy(source), overrides, folder=folder), folder, copy.deepcopy(source), overrides)


def load_rig(path: str | os.PathLike[str], overrides: Sequence[str] = _NO_CHANGES) -> Rig:
    """Read a rig file, or a shipped one by its name ("paper"); overrides: key.path=value.

    Raises RigError naming key, value and what is allowed.
    """
    file = by_name("rigs", Path(path))
    return _rig(file, file.parent, tuple(overrides))


class Event(NamedTuple):
    """Something that happened. time: s from the first tick."""

    time: float
    text: str


class Run:
    """One run as columns; arrays are (ticks,) or (ticks, n_axes), SI units (rad, N m for rotary axes).

    rig: its Rig's configuration. columns: all columns by name, as docs/architecture.md and the recording have them.
    true: position before the encoder (m), where it is known (simulations), else None. log: its events, whole
    (hil.cycle.event.Event); empty for an exported run and for older recordings.
    """

    def __init__(self, rig: RigConfig, columns: dict[str, NDArray[Any]], true: Array | None = None) -> None:
        self.rig, self.columns, self.true, self.log = rig, columns, true, list[Happened]()

    @property
    def axes(self) -> list[str]:
        """Names of the axes."""
        return self.rig.axis_names

    @cached_property
    def time(self) -> Array:
        """When each tick was due, s from the first."""
        scheduled = self.columns["scheduled_ns"]
        seconds: Array = (scheduled - scheduled[:1]) * 1e-9
        return seconds

    @property
    def measured(self) -> Array:
        """Position as measured, m; the prediction where a tick brought no sample."""
        return self.columns["position"]

    @property
    def estimate(self) -> Array:
        """Position as the rig's filter has it, m; of an estimator of your own, as the law was told."""
        return self.columns["position_estimate"]

    @property
    def velocity(self) -> Array:
        """Velocity as it is shown, m/s; of an estimator of your own, as the law was told."""
        return self.columns["velocity_estimate"]

    @property
    def requested(self) -> Array:
        """Force the law asked for, N."""
        return self.columns["force_requested"]

    @property
    def force(self) -> Array:
        """Force as sent, N."""
        return self.columns["force"]

    @property
    def setpoint(self) -> Array:
        """Setpoint at the samples' instants, m; NaN where no task ran or a tick brought no sample."""
        return np.where(self._followed, self.columns["setpoint_position"], np.nan)

    @property
    def error(self) -> Array:
        """Position less setpoint, both at the samples' instants, m; NaN as in `setpoint`."""
        return np.where(self._followed, self.columns["following_error"], np.nan)

    @cached_property
    def _followed(self) -> NDArray[np.bool_]:
        fresh = (self.columns["age_ticks"] == 0) & (self.columns["task_ns"] >= 0)[:, None]
        moves = np.isin(self.columns["state"], (int(State.HOMING), int(State.ACTIVE)))[:, None]
        return np.asarray(fresh & moves)

    @property
    def state(self) -> list[str]:
        """Name of the state after every tick."""
        names = {int(state): state.name for state in State}
        return [names[value] for value in self.columns["state"].tolist()]

    @cached_property
    def events(self) -> list[Event]:
        """Every change of state, and every fault that latched."""
        found = []
        for name, kind in (("state", State), ("fault", Fault)):
            values = self.columns[name]
            places = np.flatnonzero(np.diff(values, prepend=values[:1] if name == "state" else 0))
            for place in places.tolist():
                value = kind(int(values[place]))
                if name == "state" or value:
                    found.append(Event(float(self.time[place]), f"{name} {value.name}"))
        return sorted(found)

    def summary(self) -> dict[str, Any]:
        """Figures of the steady window: keys rig, law, ticks, seconds, final_state, faults, steady_from_s, and per axis
        in axes max_error, rms_error, plateau_error (m), peak_force and chatter (N).
        """
        ticks = len(self.time)
        first = steady_from(RunData(self.rig, {}, self.columns, pb.Counters(), None, 0, truncated=False))
        return {
            "rig": self.rig.name,
            "law": self.rig.law.name,
            "ticks": ticks,
            "seconds": float(self.time[-1]) if ticks else 0.0,
            "final_state": self.state[-1] if ticks else None,
            "faults": [event.text.removeprefix("fault ") for event in self.events if event.text.startswith("fault")],
            "steady_from_s": float(self.time[first]) if first < ticks else None,
            "axes": axis_statistics(self.axes, self.error[first:], self.force[first:]),
        }

    def compare(self, other: "Run") -> dict[str, dict[str, float]]:
        """Largest difference to another run, tick by tick as far as both go: per axis setpoint, error (m), force (N).

        Raises ValueError where the runs have other axes.
        """
        if self.axes != other.axes:
            raise ValueError(f"the runs have the axes {', '.join(self.axes)} and {', '.join(other.axes)}")
        n = min(len(self.time), len(other.time))
        found: dict[str, dict[str, float]] = {name: {} for name in self.axes}
        for key in ("setpoint", "error", "force"):
            difference = np.abs(getattr(self, key)[:n] - getattr(other, key)[:n])
            largest = np.where(np.isnan(difference), 0.0, difference).max(axis=0, initial=0.0)
            for index, name in enumerate(self.axes):
                found[name][key] = float(largest[index])
        return found

    def plot(self, path: str | os.PathLike[str]) -> Path:
        """Draw setpoint, error and force of every axis as .png, .svg, .pdf, ...; returns the path."""
        from hil.cli.pictures import tracking_picture

        tracking_picture(Path(path), self.rig, self, marks=marks_of(self.log, self.columns["index"]))
        return Path(path)

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write the run as one HTML file that needs nothing else: figures, pictures, events, law and rig."""
        from hil.operate.run_report import Story, report_page

        events = [(e.run_ns * 1e-9, e.line) for e in self.log] or [(event.time, event.text) for event in self.events]
        story = Story(self.summary(), events, {"rig hash": rig_hash(self.rig), **self._facts()}, self._failure())
        Path(path).write_text(report_page(self.rig, self, story), encoding="utf-8")
        return Path(path)

    def _facts(self) -> dict[str, Any]:
        """What else is known of the run, for people."""
        return {}

    def _failure(self) -> str:
        return ""

    def export(self, path: str | os.PathLike[str]) -> Path:
        """Write the columns, by the suffix: .csv and .parquet as `table` has them, .npz whole, for `load_run`.

        Raises ValueError for another suffix, ImportError where .parquet lacks pandas or pyarrow, OSError.
        """
        path = Path(path)
        if path.suffix == ".csv":
            run_files.write_csv(path, self.table())
        elif path.suffix == ".npz":
            run_files.write_npz(path, self.rig, self.columns, self.true)
        elif path.suffix == ".parquet":
            self.to_pandas().to_parquet(path)
        else:
            raise ValueError(f"{path}: the name must end in {', '.join(EXPORTS)}")
        return path

    def table(self) -> dict[str, NDArray[Any]]:
        """Columns (ticks,) by name: time_s, state, and for every axis such as x_setpoint, x_error, x_force."""
        found: dict[str, NDArray[Any]] = {"time_s": self.time, "state": np.array(self.state, dtype=str)}
        for i, name in enumerate(self.axes):
            found |= {f"{name}_{key}": getattr(self, key)[:, i] for key in _TABLED}
            if self.true is not None:
                found[f"{name}_true"] = self.true[:, i]
        return found

    def to_pandas(self) -> Any:
        """`table` as a pandas.DataFrame, a row a tick, indexed by time_s. Raises ImportError without pandas."""
        import pandas

        return pandas.DataFrame(self.table()).set_index("time_s")

    def to_xarray(self) -> Any:
        """An xarray.Dataset: setpoint, error, ... over (time_s, axis), state over time_s. Raises ImportError."""
        import xarray

        found = {key: (("time_s", "axis"), getattr(self, key)) for key in _TABLED}
        if self.true is not None:
            found["true"] = (("time_s", "axis"), self.true)
        state = {"state": (("time_s",), np.array(self.state, dtype=str))}
        return xarray.Dataset({**found, **state}, coords={"time_s": self.time, "axis": self.axes})


class Simulation(Run):
    """A run of `simulate`. figures: those `hil sim` shows, by the true error. law_failure: why a user's law no
    longer counted, with file and line; empty where all was well. trace_sha256: over every frame sent and received.
    """

    def __init__(self, rig: RigConfig, columns: dict[str, NDArray[Any]], true: Array, report: sim.SimReport) -> None:
        super().__init__(rig, columns, true)
        self.figures, self.log = report, report.events
        self.law_failure, self.trace_sha256 = report.law_failure, report.trace_sha256

    def _facts(self) -> dict[str, Any]:
        return {"trace_sha256": self.trace_sha256, "simulated": "in virtual time, against the emulated stage"}

    def _failure(self) -> str:
        return self.law_failure


class Recording(Run):
    """A recording (MCAP) of a live or simulated run, cut short or not. truncated: whether it is; lost: ticks missing.

    exact: the motion is what the cycle wrote, bit for bit. The file has it rounded (hil/telemetry/tick_schema.py), so
    the cycle is run again, as `hil replay` does; where ticks are missing, this version comes to other frames, or the
    run's law is not installed, the rounded values stay.

    Raises RecordingError where the file is none.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        data = read_run(Path(path))
        motion = None if "stamp_ns" in data.columns else replays.exact_motion(Path(path))  # older ones hold all bits
        self.exact = motion is not None or "stamp_ns" in data.columns
        super().__init__(data.rig, data.columns | (motion or {}))
        self.path, self.metadata, self.log = Path(path), data.metadata, data.events
        self.truncated, self.lost = data.truncated, data.lost

    def _facts(self) -> dict[str, Any]:
        known = {"recording": self.path.name, **{key: self.metadata.get(key, "") for key in ("version", "realtime")}}
        if self.truncated or self.lost:
            known["incomplete"] = f"{self.lost} ticks lost" + (", cut short or damaged" if self.truncated else "")
        return {key: value for key, value in known.items() if value}


def load_run(path: str | os.PathLike[str]) -> Run:
    """A run that was recorded or exported: a recording (run.mcap), the folder that holds one, or an exported .npz.

    Raises RecordingError where it is none of these, RigError where its rig is of another version.
    """
    path = Path(path)
    path = path / RECORDING if path.is_dir() else path
    return Run(*run_files.read_npz(path)) if path.suffix == ".npz" else Recording(path)


def simulate(
    rig: Rig | str | os.PathLike[str],
    seconds: float = 20.0,
    *,
    overrides: Sequence[str] = _NO_CHANGES,
    scenario: str | os.PathLike[str] | None = None,
    record: str | os.PathLike[str] | None = None,
) -> Simulation:
    """Run a rig in virtual time against its emulated stage, for `seconds`: the same bytes every time, on any machine.

    rig: a Rig or a rig file. overrides: key.path=value. scenario: a file of faults to inject, or a shipped one's name.
    record: write a recording there. Raises RigError where the rig cannot run, RecordingError where `record` cannot be
    written.
    """
    chosen = rig.changed(*overrides) if isinstance(rig, Rig) else load_rig(rig, overrides)
    config, folder = chosen.config, chosen.folder
    refuse_unschedulable(config, folder)
    faults = load_scenario(by_name("scenarios", Path(scenario)), config) if scenario is not None else None
    recorder = LockstepRecorder(Path(record), config, folder / f"{config.name}.toml") if record is not None else None
    kept: list[bytes] = []

    def observe(tick: Tick, frames: Sequence[Any], result: CycleResult) -> None:
        kept.append(result.record.tobytes()[:_USED])
        if recorder:
            recorder.observe(tick, frames, result)

    tell = recorder.tell if recorder else None
    try:
        report, traces = sim.simulate(config, folder, seconds, observer=observe, scenario=faults, tell=tell)
    except ValueError as error:
        raise RigError([f"{config.name}: {error}"]) from None
    finally:
        if recorder:
            recorder.close()
    report.overrides = list(overrides)
    return Simulation(config, _columns(kept, len(config.axes)), traces.true, report)


def _columns(kept: Sequence[bytes], n_axes: int) -> dict[str, NDArray[Any]]:
    records = np.frombuffer(b"".join(kept), dtype=_HEAD)
    per_axis = {name: records[name][:, :n_axes].copy() for name in PER_AXIS}
    return {**{name: records[name].copy() for name in PER_TICK}, **per_axis}


def replay(path: str | os.PathLike[str], *, overrides: Sequence[str] = _NO_CHANGES) -> replays.Replayed:
    """A recording through a new control cycle, compared byte for byte; overrides: also through that other rig.

    Raises RecordingError, RigError.
    """
    return replays.replay_run(Path(path), tuple(overrides))
