"""`make bench ARGS=latency`: from a goal that is written to the frame that it changes, on a rig that runs.

By turns in one run: a program on this computer, which writes the goal page itself, and one that comes over TLS through
the sidecar. A goal acts in the frame of the tick that takes it (tests/cycle/test_goals.py), so it is that tick that
counts: the first one that woke behind the writing is number 1. The axes stay at rest, as a busy host would make a
moving stage oscillate. The rig is the paper's on the local bus at 250 Hz, without real time.
"""

import os
import random
import tempfile
import time
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import typer

from hil.cycle.goal import Goal, GoalKind, MotionError, Refusal
from hil.live.goal_link import GoalLink, PageLink
from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths
from hil.operate.bench.blocks import (
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    percentiles,
    publish,
    spread,
    values_of,
)
from hil.telemetry.credentials import Credentials
from hil.telemetry.remote_link import RemoteLink
from tests.support.remote_rig import remote_rig

PAGE, TLS = "goal page", "TLS, sidecar"
MOST_TICKS: Final = {"p50": 1.0, "p99": 2.0}  # from the same computer
MOST_MS, MOST_RATIO = 3.0, 3.0  # by the sidecar, at p90: idle, or in parts of the page's in the same run
LOOKED_AT = 2000  # ticks of the ring


def latency(
    goals: Annotated[int, typer.Option(min=10, help="per block")] = 100,
    blocks: Annotated[int, typer.Option(min=1)] = 3,
    as_json_to: JsonTarget = None,
) -> None:
    """Ticks and ms until a goal acts. Exit status 1: a bar was missed."""
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as directory:
        folder = Path(directory)
        os.environ["HIL_RUNTIME_DIR"] = str(folder / "runtime")
        with remote_rig(folder) as remote:
            operator = Credentials(remote.made / "operator")
            with RemoteLink(remote.commands, operator) as link:
                link.hold()
            here = runtime_paths("paper").ring.parent
            cases = [
                Case(PAGE, lambda: _block(PageLink(here), goals)),
                Case(TLS, lambda: _block(RemoteLink(remote.commands, operator), goals)),
            ]
            measured = interleave(cases, blocks)
    found = {name: {key: spread(values_of(measured, case, key)).median for key in ("ticks p50", "ticks p99", "p90")}
             for name, case in (("page", PAGE), ("tls", TLS))}  # fmt: skip
    ratio = found["tls"]["p90"] / found["page"]["p90"]
    missed = [name for name, most in MOST_TICKS.items() if found["page"][f"ticks {name}"] > most]
    if found["tls"]["p90"] > MOST_MS and ratio > MOST_RATIO:
        missed.append("sidecar")
    table = block_table("a goal until it acts, ms", measured, ["p50", "p90", "p99", "max", "ticks p50", "ticks p99"])
    result = {**found, "ratio": ratio, "missed": missed, "blocks": as_json(measured)}
    publish(result, [table], as_json_to)
    print(f"TLS over page at p90: {ratio:.2f} (at most {MOST_RATIO:g}); missed: {', '.join(missed) or 'none'}")
    raise typer.Exit(bool(missed))


def _block(link: GoalLink, goals: int) -> Figures:
    """Goals one by one, at odd moments; ms and ticks until each acts."""
    draw, found = random.Random(goals), []
    with link, RingReader(runtime_paths("paper").ring) as ring:  # type: ignore[attr-defined]
        link.take(by_force=True)
        for k in range(goals):
            link.wait(0.005 + 0.01 * draw.random())
            written_ns = time.monotonic_ns()
            number, refusal = link.send(Goal(0, GoalKind.HALT))
            if refusal is not Refusal.NONE:
                raise MotionError(f"goal {k}: {refusal.name}; {link.look()}")
            found.append(_until(ring, number, written_ns))
    ms, ticks = np.array(found).T
    of_ticks = percentiles(ticks)
    told = percentiles(ms) | {"p90": float(np.percentile(ms, 90.0))}
    return told | {"ticks p50": of_ticks["p50"], "ticks p99": of_ticks["p99"]}


def _until(ring: RingReader, number: int, written_ns: int) -> tuple[float, int]:
    """ms until the tick that took that goal, and its number among the ticks that woke since."""
    first = max(ring.written - LOOKED_AT, 0)
    records = ring.look(first, LOOKED_AT, ("now_ns", "n_goals", "goals")).records
    taken = (records["goals"]["number"] == number).any(axis=1) & (records["n_goals"] > 0)
    place = int(np.flatnonzero(taken)[-1])
    ticks = int((records["now_ns"][: place + 1] > written_ns).sum())
    return (int(records["now_ns"][place]) - written_ns) * 1e-6, ticks
