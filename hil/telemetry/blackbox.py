"""`hil blackbox`: the last seconds of a control process that was killed, out of its ring, as a recording."""

import contextlib
import itertools
import time
from pathlib import Path
from typing import Annotated

import typer

from hil.live.ring import RingError, RingReader, previous_path
from hil.live.runtime_paths import RuntimePaths, runtime_paths
from hil.rig.file import load_rig
from hil.telemetry.recorder import Recorder, write_batch


def save_ring(reader: RingReader, path: Path) -> int:
    """Write all a ring still holds to a recording; returns the number of ticks. Raises OSError when it does not fit."""
    recorder = Recorder(path, reader.metadata)
    saved = 0
    while len((batch := reader.read()).records):
        write_batch(recorder, batch.records, first=batch.first, lost=batch.lost)
        saved += len(batch.records)
    recorder.close()
    if recorder.errors:
        raise OSError(f"{path}: the recording could not be written")
    return saved


def killed_rings(paths: RuntimePaths) -> list[Path]:
    """Rings of this rig whose writer was killed, the oldest first."""
    found = []
    for path in (previous_path(paths.ring), paths.ring):
        try:
            with RingReader(path) as reader:
                if reader.written and not (reader.ended or reader.saved or reader.writer_alive):
                    found.append(path)
        except RingError:
            continue
    return found


def save_black_boxes(paths: RuntimePaths, directory: Path | None) -> list[Path]:
    """Save every killed ring once, as blackbox.mcap, blackbox-2.mcap, ... in `directory`, or in one made for them."""
    saved: list[Path] = []
    for ring in killed_rings(paths):
        directory = directory or run_directory()
        target = directory / f"blackbox{f'-{len(saved) + 1}' if saved else ''}.mcap"
        with RingReader(ring) as reader:
            save_ring(reader, target)
            reader.mark_saved()
        saved.append(target)
    return saved


def run_directory() -> Path:
    """A new directory runs/<time>, in local time, for what a run leaves."""
    name = time.strftime("%Y%m%d-%H%M%S")
    for number in itertools.count(1):
        directory = Path("runs", name if number == 1 else f"{name}-{number}")
        with contextlib.suppress(FileExistsError):  # of a run that began in the same second
            directory.mkdir(parents=True)
            break
    return directory


def blackbox(
    rig: Annotated[Path, typer.Argument(help="rig file")],
    out: Annotated[Path | None, typer.Option(help="directory for blackbox.mcap [runs/<time>]")] = None,
) -> None:
    """Save what a killed control process left behind."""
    saved = save_black_boxes(runtime_paths(load_rig(rig).name), out)
    for path in saved:
        print(f"saved {path}; look into it with: hil replay {path}")
    if not saved:
        print("nothing to save: no control process of this rig was killed since the last time")
