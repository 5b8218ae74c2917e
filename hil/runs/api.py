"""Runs to work with in Python: simulated ones and recorded ones, with one interface.

    import hil

    rig = hil.load_rig("my-stage.toml", ["law.name=structured-kalman"])
    run = hil.simulate(rig, seconds=10.0)
    print(run.summary()["axes"])
    run.plot("run.png")
    run.compare(hil.Recording("runs/last/run.mcap"))

Nothing here prints, exits or reads arguments.
"""

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.base.named_file import write_text
from hil.analysis.figures_of_merit import axis_statistics
from hil.control.laws.base import Law
from hil.cycle.fault_table import Fault
from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CycleResult, Tick
from hil.events.event import Event as Happened
from hil.events.followed import only_followed
from hil.events.marks import marks_of
from hil.events.table import Kind
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.file import rig_hash
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import by_name
from hil.runs import files as run_files
from hil.runs.columns import Array, Columns, Difference, Event, Summary, seconds_of
from hil.runs.rigs import NO_CHANGES, Overrides, Rig, load_rig, override_words
from hil.runs.summary import RunData, steady_window
from hil.runs.summary import load_run as read_run
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import PER_AXIS, PER_TICK
from hil.telemetry.recorder import LockstepRecorder
from hil.telemetry.tick_codec import PER_SENSOR
from hil.virtual import replay as replays
from hil.virtual import sim
from hil.virtual.scenario import load_scenario

_PER_TICK = (*PER_TICK, "motion")
_KEPT = (*_PER_TICK, *PER_AXIS, *PER_SENSOR)
_FIELDS: dict[str, Any] = dict(RECORD.fields or {})
_OFFSETS = {name: int(_FIELDS[name][1]) for name in _KEPT}
_USED = max(offset + RECORD[name].itemsize for name, offset in _OFFSETS.items())  # bytes of a record with all of them
_HEAD = np.dtype(
    {"names": list(_KEPT), "formats": [RECORD[name] for name in _KEPT], "offsets": [*_OFFSETS.values()],
     "itemsize": _USED}
)  # fmt: skip
_TABLED = ("setpoint", "measured", "estimate", "error", "requested", "force")
EXPORTS = (".csv", ".npz", ".parquet")
RECORDING = "run.mcap"  # in the folder of a run


class Run:
    """One run as columns; arrays are (ticks,), (ticks, n_axes) or (ticks, n_sensors), SI units (rad, N m for rotary
    axes).

    rig: its Rig's configuration. columns: all columns by name, as docs/architecture.md and the recording have them; of
    a rig with [sensors] also "readings" (each in its sensor's unit; NaN before the first) and "reading_age" (ticks).
    true: position before the encoder (m), where it is known (simulations), else None. log: its events, whole
    (hil.events.event.Event); empty for an exported run and for older recordings.
    """

    def __init__(self, rig: RigConfig, columns: Columns, true: Array | None = None) -> None:
        self.rig, self.columns, self.true, self.log = rig, columns, true, list[Happened]()

    def __repr__(self) -> str:
        seconds = self.time[-1] if len(self.time) else 0.0
        ended = self.state[-1] if len(self.time) else "without a tick"
        return f"<{type(self).__name__} of {self.rig.name}, {self.rig.law.name}: {seconds:.3f} s, ended {ended}>"

    @property
    def axes(self) -> list[str]:
        """Names of the axes."""
        return self.rig.axis_names

    @cached_property
    def time(self) -> Array:
        """When each tick was due, s from the first."""
        return seconds_of(self.columns)

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
        return np.where(self._fresh, self.columns["setpoint_position"], np.nan)

    @property
    def error(self) -> Array:
        """Position less setpoint, both at the samples' instants, m; NaN as in `setpoint`."""
        return np.where(self._fresh, self.columns["following_error"], np.nan)

    @property
    def _fresh(self) -> NDArray[np.bool_]:
        return np.asarray(self.columns["age_ticks"] == 0)

    @property
    def state(self) -> list[str]:
        """Name of the state after every tick."""
        names = {int(state): state.name for state in State}
        return [names[value] for value in self.columns["state"].tolist()]

    @cached_property
    def events(self) -> list[Event]:
        """Every change of state, and every fault that latched."""
        found = []
        for name, kind, values in (("state", State, self.columns["state"]), ("fault", Fault, self.columns["fault"])):
            places = np.flatnonzero(np.diff(values, prepend=values[:1] if name == "state" else 0))
            for place in places.tolist():
                value = kind(int(values[place]))
                if name == "state" or value:
                    found.append(Event(float(self.time[place]), f"{name} {value.name}"))
        return sorted(found)

    def summary(self) -> Summary:
        """Figures of the steady window: keys rig, law, ticks, seconds, final_state, faults, steady_from_s, settled, and
        per axis in axes max_error, rms_error, plateau_error (m), peak_force and chatter (N). Of a run that ended in
        FAULT they are those of the time before it. settled: False where it was too short for approach and settling.
        """
        ticks = len(self.time)
        first, settled = steady_window(RunData(self.rig, {}, self.columns, pb.Counters(), None, 0, truncated=False))
        return {
            "rig": self.rig.name,
            "law": self.rig.law.name,
            "ticks": ticks,
            "seconds": float(self.time[-1]) if ticks else 0.0,
            "final_state": self.state[-1] if ticks else None,
            "faults": [event.text.removeprefix("fault ") for event in self.events if event.text.startswith("fault")],
            "steady_from_s": float(self.time[first]) if first < ticks else None,
            "settled": settled,
            "axes": axis_statistics(self.axes, self.error[first:], self.force[first:]),
        }

    def compare(self, other: "Run") -> dict[str, Difference]:
        """Largest difference to another run, tick by tick as far as both go: per axis setpoint, error (m), force (N).

        Raises ValueError where the runs have other axes.
        """
        if self.axes != other.axes:
            raise ValueError(f"the runs have the axes {', '.join(self.axes)} and {', '.join(other.axes)}")
        n = min(len(self.time), len(other.time))

        def largest(mine: Array, theirs: Array) -> list[float]:
            difference = np.abs(mine[:n] - theirs[:n])
            found: list[float] = np.where(np.isnan(difference), 0.0, difference).max(axis=0, initial=0.0).tolist()
            return found

        setpoint = largest(self.setpoint, other.setpoint)
        error = largest(self.error, other.error)
        force = largest(self.force, other.force)
        rows = zip(self.axes, setpoint, error, force, strict=True)
        return {name: {"setpoint": a, "error": b, "force": c} for name, a, b, c in rows}

    def plot(self, path: str | os.PathLike[str]) -> Path:
        """Draw setpoint, error and force of every axis as .png, .svg, .pdf, ...; returns the path."""
        from hil.cli.pictures import tracking_picture

        tracking_picture(Path(path), self.rig, self, marks=marks_of(self.log, self.columns["index"]))
        return Path(path)

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write the run as one HTML file that needs nothing else: figures, pictures, events, law and rig."""
        from hil.runs.report import Story, report_page

        events = [(e.run_ns * 1e-9, e.line) for e in self.log] or [(event.time, event.text) for event in self.events]
        facts = {"rig hash": rig_hash(self.rig), **self._facts()}
        story = Story(self.summary(), events, facts, self._failure(), self._latched())
        write_text(path, report_page(self.rig, self, story))
        return Path(path)

    def _facts(self) -> dict[str, Any]:
        """What else is known of the run, for people."""
        return {}

    def _failure(self) -> str:
        return ""

    def _latched(self) -> str:
        """The event of the fault that the run ended with; empty where none did."""
        at_end = self.columns["fault"][-1:].any()
        lines = [event.line for event in self.log if event.kind is Kind.FAULT_LATCHED]
        return lines[-1] if at_end and lines else ""

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
        """Columns (ticks,) by name: time_s, state, for every axis such as x_setpoint, x_error, x_force, and for every
        sensor such as force_reading, force_age_ticks.
        """
        found: dict[str, NDArray[Any]] = {"time_s": self.time, "state": np.array(self.state, dtype=str)}
        for i, name in enumerate(self.axes):
            found |= {f"{name}_{key}": getattr(self, key)[:, i] for key in _TABLED}
            if self.true is not None:
                found[f"{name}_true"] = self.true[:, i]
        for i, name in enumerate(self.rig.sensors):
            found[f"{name}_reading"] = self.columns["readings"][:, i]
            found[f"{name}_age_ticks"] = self.columns["reading_age"][:, i]
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

    def __init__(self, rig: RigConfig, columns: Columns, true: Array, report: sim.SimReport) -> None:
        super().__init__(rig, columns, true)
        self.figures, self.log = report, report.events
        self.law_failure, self.trace_sha256 = report.law_failure, report.trace_sha256

    def _facts(self) -> dict[str, Any]:
        return {"trace_sha256": self.trace_sha256, "simulated": "in virtual time, against the emulated stage"}

    def _failure(self) -> str:
        return self.law_failure


class Recording(Run):
    """A recording (MCAP) of a live or simulated run, cut short or damaged or not. truncated: whether it is; lost: ticks
    missing; loss: that in words, empty where nothing is missing.

    exact: the motion is what the cycle wrote, bit for bit. The file has it rounded (hil/telemetry/tick_schema.py), so
    the cycle is run again, as `hil replay` does. Where ticks are missing, this version comes to other frames, or the
    run had a law, estimator or layout that is not hil's own, the rounded values stay. Raises RecordingError.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        data = read_run(Path(path))
        motion = None if "stamp_ns" in data.columns else replays.exact_motion(Path(path))  # older ones hold all bits
        self.exact = motion is not None or "stamp_ns" in data.columns
        super().__init__(data.rig, cast(Columns, only_followed(data.columns | cast(Columns, motion or {}))))
        self.path, self.metadata, self.log = Path(path), data.metadata, data.events
        self.truncated, self.lost, self.loss = data.truncated, data.lost, data.loss

    def _facts(self) -> dict[str, Any]:
        known = {"recording": self.path.name, **{key: self.metadata.get(key, "") for key in ("version", "realtime")}}
        if self.loss:
            known["incomplete"] = self.loss
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
    overrides: Overrides = NO_CHANGES,
    scenario: str | os.PathLike[str] | None = None,
    record: str | os.PathLike[str] | None = None,
    law: str | type[Law] | None = None,
) -> Simulation:
    """Run a rig in virtual time against its emulated stage, for `seconds`: the same bytes every time, on any machine.

    rig: a Rig or a rig file. law: another law's name, or your own class, of a notebook's cell too. overrides:
    key.path=value texts, or {"key.path": value}. scenario: a file of faults to inject, or a shipped one's name.
    record: write a recording there. Raises RigError where the rig cannot run, RecordingError where `record` cannot be
    written.
    """
    words = override_words(overrides)
    chosen = (rig if isinstance(rig, Rig) else load_rig(rig)).changed(*words, law=law)
    config, folder = chosen.config, chosen.folder
    refuse_unschedulable(config, folder)
    faults = load_scenario(by_name("scenarios", Path(scenario)), config) if scenario is not None else None
    recorder = LockstepRecorder(Path(record), config, folder / f"{config.name}.toml") if record is not None else None
    kept: list[bytes] = []

    def observe(tick: Tick, frames: Sequence[Any], result: CycleResult) -> None:
        kept.append(record_head(result.record))
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
    report.overrides = words
    return Simulation(config, columns_of(kept, config), traces.true, report)


def record_head(record: np.void) -> bytes:
    """The part of a tick's record that `columns_of` needs."""
    return record.tobytes()[:_USED]


def columns_of(kept: Sequence[bytes], rig: RigConfig) -> Columns:
    """Columns of the heads of records, one a tick."""
    records = np.frombuffer(b"".join(kept), dtype=_HEAD)
    found = {name: records[name].copy() for name in _PER_TICK}
    found |= {name: records[name][:, : len(rig.axes)].copy() for name in PER_AXIS}
    if rig.sensors:
        found |= {name: records[name][:, : len(rig.sensors)].copy() for name in PER_SENSOR}
    return cast(Columns, only_followed(found))


def replay(
    path: str | os.PathLike[str], *, overrides: Sequence[str] = (), run_its_code: bool = False
) -> replays.Replayed:
    """A recording through a new control cycle, compared byte for byte; overrides: also through that other rig.

    run_its_code: run code that the recording carries, unconfined; else refused. Raises RecordingError, RigError.
    """
    code = replays.code_of_recording(Path(path)) if run_its_code else ()
    return replays.replay_run(Path(path), tuple(overrides), code)
