"""Summary of a run from its recording: the table at the end of `hil demo`, and summary.json."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hil.cli.output import axis_table
from hil.control.trajectories import make_trajectory
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigConfig
from hil.telemetry import codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.recording import Recorded, Recording, RecordingError
from hil.telemetry.tick_codec import columns as tick_columns
from hil.telemetry.tick_schema import TickSchema
from hil.virtual.figures_of_merit import axis_statistics

_FOLLOWING = (int(State.HOMING), int(State.ACTIVE))


@dataclass
class RunData:
    """A recording as columns (hil.telemetry.codec.columns), and its metadata."""

    rig: RigConfig
    metadata: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    counters: pb.Counters
    status: pb.Status | None  # the last one
    lost: int  # ticks that are missing from it
    truncated: bool

    @property
    def error(self) -> NDArray[np.float64]:
        """Following error, m, (ticks, n_axes); NaN where the axis followed no task or had no new sample."""
        fresh = (self.columns["age_ticks"] == 0) & (self.columns["task_ns"] >= 0)[:, None]
        following = np.isin(self.columns["state"], _FOLLOWING)[:, None]
        return np.where(fresh & following, self.columns["following_error"], np.nan)

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Setpoint at the sample's instant, m, (ticks, n_axes); NaN as in `error`."""
        return np.where(np.isnan(self.error), np.nan, self.columns["setpoint_position"])

    @property
    def force(self) -> NDArray[np.float64]:
        """Applied force, N, (ticks, n_axes)."""
        return self.columns["force"]

    @property
    def lateness(self) -> NDArray[np.float64]:
        """Start of every tick after its deadline, s."""
        result: NDArray[np.float64] = (self.columns["now_ns"] - self.columns["scheduled_ns"]) * 1e-9
        return result


def load_run(path: Path) -> RunData:
    """Read a recording, cut short or not. Raises RecordingError, or RigError when its rig is of another version."""
    recording = Recording(path)
    with rig_of_run(recording.metadata) as (rig, _):
        pass
    status = None
    batches: list[dict[str, NDArray[Any]]] = []
    ticks: list[Recorded] = []
    delays: list[int] = []
    last, lost = pb.Counters(), 0
    try:
        for item in recording:
            if item.topic == "telemetry":
                message = pb.Telemetry.FromString(item.data)
                batches.append(codec.columns(message))
                last = message.counters
                lost += message.lost
            elif item.topic == "tick":
                ticks.append(item)
            elif item.topic == "cycle":
                cycle = pb.Cycle.FromString(item.data)
                last = cycle.counters
                lost += cycle.lost
                delays.extend(cycle.run_delay_ns)
            elif item.topic == "status":
                status = pb.Status.FromString(item.data)
        columns = _joined(batches) if batches else _of_ticks(ticks, recording.metadata)
        columns.setdefault("run_delay_ns", np.resize(np.array(delays, np.int64), len(columns["index"])))
    except (DecodeError, ValueError, OverflowError, KeyError, TypeError) as error:
        raise RecordingError(f"{path}: its telemetry makes no sense: {error}") from None
    return RunData(rig, recording.metadata, columns, last, status, lost, recording.truncated)


def _of_ticks(ticks: list[Recorded], metadata: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Columns of Tick messages: values as a viewer shows them, rounded to the schema's steps."""
    schema, offset_ns = TickSchema(metadata["rig"]), int(metadata.get("wall_offset_ns", 0))
    messages = (schema.message.FromString(item.data) for item in ticks)
    return tick_columns(messages, (item.time_ns - offset_ns for item in ticks), schema)


def _joined(batches: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def summarise(run: RunData) -> dict[str, Any]:
    """The figures of summary.json; SI units."""
    columns, counters = run.columns, run.counters
    first = steady_from(run)
    produced = run.status.produced if run.status else len(columns["index"]) + run.lost
    sent, dropped = (run.status.sent, run.status.dropped) if run.status else (len(columns["index"]), run.lost)
    ticks = len(columns["index"])
    return {
        "rig": run.rig.name,
        "rig_hash": run.metadata["rig_hash"],
        "law": run.rig.law.name,
        "rate_hz": run.rig.rate_hz,
        "realtime": run.metadata.get("realtime", ""),
        "ticks": ticks,
        "seconds": float(columns["now_ns"][-1] - columns["now_ns"][0]) * 1e-9 if ticks else 0.0,
        "final_state": State(int(columns["state"][-1])).name if ticks else None,
        "faults": list(_faults(columns["fault"])),
        "steady_from_tick": first,
        "axes": axis_statistics(run.rig.axis_names, run.error[first:], run.force[first:]),
        "lateness": _lateness(run.lateness),
        "missed": {
            "own": counters.missed_own,
            "host": counters.missed_host,
            "longest_streak": counters.longest_streak,
        },
        "frames": {
            "sent": counters.sent,
            "received": counters.received,
            "lost": counters.samples_lost,
            "refused": counters.refused,
            "rejected": int(sum(counters.rejects)),
        },
        "telemetry": {"produced": produced, "sent": sent, "dropped": dropped},
        "recording": {"ticks": ticks, "lost": run.lost, "truncated": run.truncated},
    }


def _faults(column: NDArray[Any]) -> Iterable[str]:
    """Names of the faults that latched, in order of first appearance."""
    values, places = np.unique(column, return_index=True)
    return (Fault(int(column[place])).name for place in sorted(places[values != 0]))


def _lateness(lateness: NDArray[np.float64]) -> dict[str, float]:
    if not lateness.size:
        return dict.fromkeys(("p50", "p99", "p999", "max"), float("nan"))
    p50, p99, p999 = np.percentile(lateness, (50, 99, 99.9)).tolist()
    return {"p50": p50, "p99": p99, "p999": p999, "max": float(lateness.max())}


def steady_from(run: RunData) -> int:
    """First tick of the steady window: after the approach and settling, or the whole task when it was shorter."""
    columns = run.columns
    task = np.where(np.isin(columns["state"], _FOLLOWING), columns["task_ns"], -1)
    rig = run.rig
    settled = make_trajectory(rig.task, rig.axis_names, np.zeros(len(rig.axes)), rig.period_ns).steady_from_ns
    for threshold in (settled, 0):
        places = np.flatnonzero(task >= threshold)
        if places.size:
            return int(places[0])
    return 0


def show(summary: dict[str, Any], rig: RigConfig, console: Console) -> None:
    """The figures as tables for people."""
    title = (
        f"{rig.name}, {rig.law.name}, {rig.rate_hz:g} Hz, {summary['seconds']:.1f} s live (following error as measured)"
    )
    console.print(axis_table(rig, summary["axes"], title))
    table = Table.grid(padding=(0, 2))
    late, missed = summary["lateness"], summary["missed"]
    microseconds = [f"{late[key] * 1e6:.0f}" for key in ("p50", "p99", "p999", "max")]
    table.add_row("tick lateness", "p50 {} / p99 {} / p99.9 {} / max {} µs".format(*microseconds))
    table.add_row("missed ticks", f"{missed['own']} own, {missed['host']} the host's, of {summary['ticks']}")
    frames = summary["frames"]
    table.add_row("frames", f"{frames['sent']} sent, {frames['received']} received, {frames['lost']} samples lost")
    counts = summary["telemetry"]
    table.add_row("telemetry", f"{counts['produced']} produced = {counts['sent']} sent + {counts['dropped']} dropped")
    table.add_row("faults", ", ".join(summary["faults"]) or "none")
    table.add_row("real time", summary["realtime"] or "-")
    console.print(table)
