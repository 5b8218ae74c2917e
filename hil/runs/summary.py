"""Summary of a run from its recording: the table at the end of `hil demo`, and summary.json."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hil.analysis.figures_of_merit import NOT_SETTLED, axis_statistics
from hil.cli.marks import Mark
from hil.cli.output import axis_table
from hil.control.trajectories import make_trajectory
from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.events.event import Event
from hil.events.followed import only_followed
from hil.events.marks import marks_of
from hil.events.table import Kind
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigConfig
from hil.runs.columns import Columns, seconds_of
from hil.telemetry import codec, events_pb2
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.event_codec import decode
from hil.telemetry.recording import Gap, Gaps, Recorded, Recording, RecordingError, loss_text
from hil.telemetry.tick_codec import columns as tick_columns
from hil.telemetry.tick_schema import TickSchema

_GOALS = (MotionWord.MOVE, MotionWord.JOG, MotionWord.STREAM, MotionWord.MOTION)
MOST_EVENTS = 5000  # of a long run; the recording has all


@dataclass
class RunData:
    """A recording as columns (hil.telemetry.codec.columns), and its metadata."""

    rig: RigConfig
    metadata: dict[str, Any]
    columns: Columns
    counters: pb.Counters
    status: pb.Status | None  # the last one
    lost: int  # ticks that are missing from it
    truncated: bool
    events: list[Event] = field(default_factory=list)  # of its topic "events"; older recordings have none
    gaps: list[Gap] = field(default_factory=list)  # where those ticks are missing, as far as the file tells

    @property
    def loss(self) -> str:
        """What is missing from it, in ticks and seconds, for people; empty where nothing is."""
        return loss_text(self.gaps, self.rig.period_ns * 1e-9, damaged=self.truncated)

    @property
    def latched(self) -> Event | None:
        """The event of the fault that the run ended with."""
        at_end = int(self.columns["fault"][-1]) if len(self.columns["fault"]) else 0
        latched = [event for event in self.events if event.kind is Kind.FAULT_LATCHED]
        return latched[-1] if at_end and latched else None

    @property
    def marks(self) -> list[Mark]:
        """Of its events, for pictures."""
        return marks_of(self.events, self.columns["index"])

    @property
    def error(self) -> NDArray[np.float64]:
        """Following error, m, (ticks, n_axes); NaN where the axis followed no task or had no new sample."""
        return np.where(self.columns["age_ticks"] == 0, self.columns["following_error"], np.nan)

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Setpoint at the sample's instant, m, (ticks, n_axes); NaN as in `error`."""
        return np.where(self.columns["age_ticks"] == 0, self.columns["setpoint_position"], np.nan)

    @property
    def force(self) -> NDArray[np.float64]:
        """Applied force, N, (ticks, n_axes)."""
        return self.columns["force"]

    @property
    def time(self) -> NDArray[np.float64]:
        """When each tick was due, s from the first."""
        return seconds_of(self.columns)

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
    delays: dict[int, int] = {}  # by the tick's index
    last, lost, gaps = pb.Counters(), 0, Gaps()
    events: list[Event] = []
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
                gaps.add(cycle.first, len(cycle.index), cycle.lost, damaged=recording.truncated)
                delays.update(zip(np.cumsum(cycle.index).tolist(), cycle.run_delay_ns, strict=False))
            elif item.topic == "status":
                status = pb.Status.FromString(item.data)
            elif item.topic == "events":
                events.append(decode(events_pb2.Event.FromString(item.data)))
        columns = _joined(batches) if batches else _of_ticks(ticks, recording.metadata)
        waited = [delays.get(index, 0) for index in columns["index"].tolist()]
        columns.setdefault("run_delay_ns", np.array(waited, np.int64))
    except (DecodeError, ValueError, OverflowError, KeyError, TypeError) as error:
        raise RecordingError(f"{path}: its telemetry makes no sense: {error}") from None
    lost += gaps.ticks
    return RunData(
        rig,
        recording.metadata,
        cast(Columns, only_followed(columns)),
        last,
        status,
        lost,
        recording.truncated,
        events,
        gaps.found,
    )


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
    first, settled = steady_window(run)
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
        "latched": run.latched.document if run.latched else None,
        "settled": settled,
        "steady_from_tick": first,
        "steady_from_s": float(seconds_of(columns)[first]) if ticks else 0.0,
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
        "recording": {"ticks": ticks, "lost": run.lost, "truncated": run.truncated, "loss": run.loss},
        "events": [event.document for event in _gravest(run.events)],
        "events_left_out": max(0, len(run.events) - MOST_EVENTS),
    }


def _gravest(events: list[Event]) -> list[Event]:
    """At most MOST_EVENTS of them, in their order."""
    if len(events) <= MOST_EVENTS:
        return events
    kept = sorted(range(len(events)), key=lambda place: (events[place].severity, place))[:MOST_EVENTS]
    return [events[place] for place in sorted(kept)]


def _faults(column: NDArray[Any]) -> Iterable[str]:
    """Names of the faults that latched, in order of first appearance."""
    values, places = np.unique(column, return_index=True)
    return (Fault(int(column[place])).name for place in sorted(places[values != 0]))


def _lateness(lateness: NDArray[np.float64]) -> dict[str, float]:
    if not lateness.size:
        return dict.fromkeys(("p50", "p99", "p999", "max"), float("nan"))
    p50, p99, p999 = np.percentile(lateness, (50, 99, 99.9)).tolist()
    return {"p50": p50, "p99": p99, "p999": p999, "max": float(lateness.max())}


def steady_window(run: RunData) -> tuple[int, bool]:
    """(first tick of the steady window, whether approach and settling were over then): of a task too short for that its
    last half, which is not steady.

    How long the approach is depends on where the axes stood when the task began. Goals are no task.
    """
    columns, rig = run.columns, run.rig
    of_goals = np.isin(columns["motion"], _GOALS) if "motion" in columns else False
    task = np.where((columns["state"] == int(State.ACTIVE)) & np.logical_not(of_goals), columns["task_ns"], -1)
    places = np.flatnonzero(task >= 0)
    if not places.size:
        return 0, True
    start = columns["position"][places[0]]
    motion = make_trajectory(rig.task, rig.axis_names, start, rig.period_ns, rig.counts)
    steady = np.flatnonzero(task >= motion.steady_from_ns)
    return int(steady[0] if steady.size else places[len(places) // 2]), bool(steady.size)


def show(summary: dict[str, Any], rig: RigConfig, console: Console) -> None:
    """The figures as tables for people."""
    clock = summary.get("clock", "live")
    run = f"{rig.name}, {rig.law.name}, {rig.rate_hz:g} Hz, {summary['seconds']:.1f} s {clock}"
    early = "" if summary["settled"] else f"; {NOT_SETTLED}"
    title = f"{run} (following error as measured, from {summary['steady_from_s']:.1f} s on{early})"
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
    if summary["latched"]:
        console.print(summary["latched"]["line"], style="red", markup=False, highlight=False, soft_wrap=True)
