"""What is fuzzed: each kind of file with good examples of it, who reads it, and what it says of a bad one."""

import io
import random
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

import hil
from drivers.eds import reader as eds
from drivers.protocols.dbc_codec import LayoutError, compile_codec, load_dbc
from hil.analysis.frequency_response import read_response
from hil.rig.bus_load import rig_layout
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.rig.task_file import TaskFileError, read_task_file
from hil.runs.trace_file import TraceError, read_trace
from hil.telemetry.recording import RecordingError
from sim_plant.scenario.language import ScenarioError, load_scenario
from tests.fuzz.damage import damaged
from tests.support.paths import RIGS, ROOT

_TRACES = ("log", "asc", "blf", "csv", "trc", "db")
_SECONDS = 0.2  # of a recorded run


class Kind(NamedTuple):
    """originals: makes good files in a folder. read: reads one. refusals: what it may raise. damage: how one is made
    bad.
    """

    suffix: str
    originals: Callable[[Path], list[Path]]
    read: Callable[[Path], object]
    refusals: tuple[type[Exception], ...]
    damage: Callable[[bytes, random.Random], bytes] = damaged


def _found(*patterns: str) -> Callable[[Path], list[Path]]:
    return lambda _folder: sorted(path for pattern in patterns for path in ROOT.glob(pattern))


def _read_rig(path: Path) -> None:
    rig = load_rig(path)
    rig_layout(rig, RIGS).messages(rig.period_ns)


def _read_dbc(path: Path) -> None:
    for message in load_dbc(path).messages:
        compile_codec(message)


def _simulated(folder: Path) -> hil.Run:
    return hil.simulate(RIGS / "paper.toml", _SECONDS, record=folder / "run.mcap")


def _recordings(folder: Path) -> list[Path]:
    _simulated(folder)
    return [folder / "run.mcap"]


def _read_recording(path: Path) -> None:
    """As `hil report` and `hil replay` do. Each has to say the same of what is no recording."""
    hil.load_run(path)
    hil.replay(path)


def _damaged_recording(content: bytes, chance: random.Random) -> bytes:
    """Half of them inside: with all checksums right, as one has made it who means harm."""
    if chance.random() < 0.5:
        return damaged(content, chance)
    try:
        return _rewritten(content, chance)
    except (OverflowError, ValueError):
        return damaged(content, chance)


def _rewritten(content: bytes, chance: random.Random) -> bytes:
    """A recording again, one message or attachment in ten damaged."""
    made = io.BytesIO()
    writer = Writer(made, chunk_size=65536, compression=CompressionType.ZSTD)
    writer.start(profile="hil", library="")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}

    def perhaps(data: bytes) -> bytes:
        return damaged(data, chance) if chance.random() < 0.1 else data

    for item in _flat(content):
        match type(item).__name__:
            case "Attachment":
                writer.add_attachment(0, 0, item.name, item.media_type, perhaps(item.data))
            case "Schema":
                schemas[item.id] = writer.register_schema(item.name, item.encoding, perhaps(item.data))
            case "Channel":
                schema = schemas[item.schema_id]
                channels[item.id] = writer.register_channel(item.topic, item.message_encoding, schema, item.metadata)
            case "Message":
                at = item.log_time, item.publish_time
                writer.add_message(channels[item.channel_id], at[0], perhaps(item.data), at[1], item.sequence)
    writer.finish()  # type: ignore[no-untyped-call]
    return made.getvalue()


def _flat(content: bytes) -> Iterator[Any]:
    known: set[tuple[str, int]] = set()
    for item in StreamReader(io.BytesIO(content), emit_chunks=True).records:
        inner = breakup_chunk(item) if isinstance(item, Chunk) else [item]
        for one in inner:
            name = type(one).__name__
            if name in ("Schema", "Channel"):  # they stand once more at the end
                if (name, one.id) in known:
                    continue
                known.add((name, one.id))
            yield one


def _exported(folder: Path) -> list[Path]:
    return [Path(_simulated(folder).export(folder / "run.npz"))]


def _damaged_archive(content: bytes, chance: random.Random) -> bytes:
    """Half of them inside: the archive's checksums are right."""
    if chance.random() < 0.5:
        return damaged(content, chance)
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, damaged(data, chance) if chance.random() < 0.2 else data)
    return made.getvalue()


def _task_files(suffix: str, folder: Path) -> list[Path]:
    t = np.linspace(0.0, 0.5, 60)
    columns = {"time_s": t, "x": 1e-3 * np.sin(6.0 * t), "y": 1e-3 * np.cos(6.0 * t)}
    path = folder / f"task.{suffix}"
    if suffix == "npz":
        np.savez_compressed(path, **columns)  # type: ignore[arg-type]
    else:
        rows = np.column_stack(list(columns.values()))
        np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="")
    return [path]


def _responses(folder: Path) -> list[Path]:
    path = folder / "measured.csv"
    lines = [f"{frequency},{1.0 / frequency**2},{-180.0 - frequency}" for frequency in range(1, 40)]
    path.write_text("\n".join(["frequency_hz,magnitude,phase_deg", *lines]) + "\n")
    return [path]


def _traces(suffix: str, folder: Path) -> list[Path]:
    path = folder / f"trace.{suffix}"
    with can.Logger(path) as writer:
        for number in range(40):
            fd = number % 2 == 1 and suffix not in ("trc", "csv", "db")
            writer(
                can.Message(
                    timestamp=1000.0 + number * 1e-3,
                    arbitration_id=0x100 + number % 5 if number % 3 else 0x18DA0100 + number,
                    is_extended_id=not number % 3,
                    is_fd=fd,
                    bitrate_switch=fd,
                    data=bytes(range(16 if fd else number % 9)),
                )
            )
    return [path]


def _read_trace(path: Path) -> None:
    for _ in read_trace(path):
        pass


KINDS: dict[str, Kind] = {
    "rig": Kind("toml", _found("deploy/rigs/*.toml"), _read_rig, (RigError,)),
    "scenario": Kind("toml", _found("deploy/scenarios/*.toml"), load_scenario, (ScenarioError,)),
    "dbc": Kind("dbc", _found("deploy/rigs/*.dbc", "drivers/families/*/*.dbc"), _read_dbc, (LayoutError,)),
    "eds": Kind("eds", _found("drivers/**/*.eds"), eds.read_eds, (eds.EdsError, OSError)),
    "recording": Kind("mcap", _recordings, _read_recording, (RecordingError, RigError), _damaged_recording),
    "export": Kind("npz", _exported, hil.load_run, (RecordingError, RigError), _damaged_archive),
    "task-csv": Kind("csv", partial(_task_files, "csv"), read_task_file, (TaskFileError,)),
    "task-npz": Kind("npz", partial(_task_files, "npz"), read_task_file, (TaskFileError,), _damaged_archive),
    "response": Kind("csv", _responses, read_response, (RigError,)),
    **{f"trace-{suffix}": Kind(suffix, partial(_traces, suffix), _read_trace, (TraceError,)) for suffix in _TRACES},
}
