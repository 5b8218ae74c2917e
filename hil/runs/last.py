"""The newest run of this folder: what `hil plot`, `hil report`, ... take where no run is named."""

import errno
import sys
from pathlib import Path

RUNS = Path("runs")  # where demo, sidecar and blackbox leave their folders


def last_runs(count: int, runs: Path = RUNS) -> list[Path]:
    """The newest `count` folders of `runs` that hold a recording, oldest first, by the time of the recording.

    Raises FileNotFoundError where there are fewer.
    """
    found = sorted(runs.glob("*/run.mcap"), key=lambda path: (path.stat().st_mtime_ns, path.parent.name))
    if len(found) < count:
        few = "no run" if not found else "only one run"
        raise FileNotFoundError(errno.ENOENT, f"{few} here; name a recording, or make one: hil demo", f"{runs}/")
    return [path.parent for path in found[-count:]]


def named_or_last(run: Path | None) -> Path:
    """The run that was named, or the newest of this folder, which is said on standard error."""
    if run is not None:
        return run
    (newest,) = last_runs(1)
    print(f"hil: the last run, {newest}", file=sys.stderr)
    return newest
