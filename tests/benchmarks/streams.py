"""`make bench ARGS=streams`: streams of set-points through networks that lose, delay, reorder and fall silent.

A path of one period goes as knots through such a network, through the sidecar's jitter buffer and into the cycle, all
in virtual time: the same figures on any machine. What the plans are held to is checked in every tick.
"""

import math
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from hil.cli.options import Overrides, RigFile
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.limits import motion_limits
from hil.cycle.tick import CycleResult
from hil.operate.bench.blocks import JsonTarget, publish
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.telemetry.jitter_buffer import JitterBuffer
from hil.virtual.goal_link import LockstepLink
from hil.virtual.lockstep import LockstepRun

PERIOD_S: Final = 1.0  # of the path
REACH: Final = 1e-3  # m, from one end of the path to the other
WAY_S: Final = 5e-3  # that every knot takes
REST_S: Final = 0.04  # at most, from the last knot's time to rest
MOST_RATIO: Final = 1.5  # of a clean stream's error to the task's
LONGEST_S: Final = 2.0  # in which the axes must rest
FIELDS: Final = ("motion", "fault", "limited", "position", "setpoint_position", "setpoint_velocity")
Records = dict[str, NDArray[Any]]


class Network(NamedTuple):
    """What happens to knots. loss: share that is lost. swapped: share that comes two intervals later, behind newer
    ones. jitter: of the way, in intervals, evenly from 0. gap_s: nothing arrives for so long, once in 0.4 s.
    """

    name: str
    loss: float = 0.0
    swapped: float = 0.0
    jitter: float = 0.0
    gap_s: float = 0.0


NETWORKS: Final = (
    Network("clean"),
    Network("loss 1 %", loss=0.01),
    Network("loss 5 %", loss=0.05),
    Network("loss 10 %", loss=0.1),
    Network("loss 20 %", loss=0.2),
    Network("loss 30 %", loss=0.3),
    Network("loss 50 %", loss=0.5),
    Network("disorder 20 %", swapped=0.2),
    Network("gaps of 100 ms", gap_s=0.1),
    Network("jitter 1.5 intervals", jitter=1.5),
    Network("all of them", loss=0.05, swapped=0.05, jitter=1.0, gap_s=0.1),
)


class Streamed(NamedTuple):
    """What became of one stream. arrived, late, disordered, limited: knots. error, worst: of the true path against the
    asked one, RMS and most, m. delay: by which the asked one is late, s. rests: from the last knot's time, s; inf: it
    does not. broken: a limit or "fault", "" where all were kept.
    """

    sent: int
    arrived: int
    late: int
    disordered: int
    limited: int
    error: float
    worst: float
    delay: float
    rests: float
    broken: str


def path(time_s: float) -> tuple[float, float]:
    """Position and velocity of the path, m and m/s: at rest at both ends of its period, and beyond."""
    if not 0.0 < time_s < PERIOD_S:
        return 0.0, 0.0
    turn = 2.0 * math.pi / PERIOD_S
    return 0.5 * REACH * (1.0 - math.cos(turn * time_s)), 0.5 * REACH * turn * math.sin(turn * time_s)


def arrivals(network: Network, interval_ns: int, draw: random.Random) -> Iterator[tuple[int, int, float, float]]:
    """Knots that arrive: when, when sent, ns; position and velocity."""
    count = round(PERIOD_S * 1e9 / interval_ns)
    for number in range(count + 1):
        sent_ns = number * interval_ns
        way_ns = round(WAY_S * 1e9 + draw.random() * network.jitter * interval_ns)
        if draw.random() < network.swapped:
            way_ns += 2 * interval_ns
        lost = draw.random() < network.loss or sent_ns * 1e-9 % 0.4 > 0.4 - network.gap_s
        if number == count or not lost:  # the last one says where to rest, and its sender repeats it until it is heard
            yield sent_ns + way_ns, sent_ns, *path(sent_ns * 1e-9)


def through(rig: RigConfig, folder: Path, network: Network, rate_hz: float, seed: int) -> Streamed:
    """One stream of the first axis."""
    interval_ns = round(1e9 / rate_hz)
    knots = sorted(arrivals(network, interval_ns, random.Random(seed)))
    sent, arrived = round(PERIOD_S * rate_hz) + 1, len(knots)
    rows: list[tuple[Any, ...]] = []
    link = LockstepLink(rig, folder, lambda record: rows.append(tuple(np.copy(record[name]) for name in FIELDS)))
    origin = link.look().setpoint[0]
    buffer, begun_ns, first, last_due_ns = JitterBuffer(), link.now_ns(), len(rows), 0
    end_ns = knots[-1][0] + round(LONGEST_S * 1e9)
    while (now_ns := link.now_ns() - begun_ns) < end_ns and (knots or rows[-1][0] != MotionWord.HOLD):
        while knots and knots[0][0] <= now_ns:
            arrived_ns, sent_ns, position, velocity = knots.pop(0)
            due_ns = buffer.due(sent_ns, 0, arrived_ns)
            if due_ns is not None:
                last_due_ns = arrived_ns + due_ns
                left_ns = max(last_due_ns - now_ns, 0)
                link.run.goals.append(
                    Goal(0, GoalKind.KNOT, 1, 0, left_ns, 0, (origin + position, 0.0, 0.0, 0.0), (velocity, 0, 0, 0))
                )
        link.run.tick()
    return _judged(rig, rows[first:], buffer, (sent, arrived), origin, last_due_ns)


def _judged(
    rig: RigConfig,
    rows: list[tuple[Any, ...]],
    buffer: JitterBuffer,
    counts: tuple[int, int],
    origin: float,
    last_due_ns: int,
) -> Streamed:
    """What the records of a stream say."""
    found: Records = {name: np.array([row[number] for row in rows]) for number, name in enumerate(FIELDS)}
    period_s = rig.period_ns * 1e-9
    moved = np.flatnonzero(found["motion"] == MotionWord.STREAM)
    at_rest = bool(found["motion"][-1] == MotionWord.HOLD)
    rests = (int(moved[-1]) + 1) * period_s - last_due_ns * 1e-9 if at_rest and len(moved) else math.inf
    position = found["position"][:, 0] - origin
    delay, off = _fitted(position, period_s)
    return Streamed(
        *counts, buffer.late, buffer.disordered, int(found["limited"][-1] - found["limited"][0]),
        float(np.sqrt(np.mean(off**2))), float(np.abs(off).max()), delay, rests, _broken(rig, found),
    )  # fmt: skip


def _fitted(position: NDArray[np.float64], period_s: float) -> tuple[float, NDArray[np.float64]]:
    """The delay with the least error, s; the errors with it, m. The nearest period, and from there by the path's speed:
    a knot of 30 a second is due between two ticks.
    """
    best: tuple[float, NDArray[np.float64]] = (0.0, position)
    for ticks in range(int(0.6 / period_s)):
        wanted = _delayed(len(position), period_s, ticks * period_s)[0]
        if ticks == 0 or np.sum((position - wanted) ** 2) < np.sum(best[1] ** 2):
            best = ticks * period_s, position - wanted
    speed = _delayed(len(position), period_s, best[0])[1]
    delay = best[0] - float(np.sum(best[1] * speed) / np.sum(speed**2))
    return delay, position - _delayed(len(position), period_s, delay)[0]


def _delayed(count: int, period_s: float, delay: float) -> NDArray[np.float64]:
    """Positions and speeds of the path so much later, (2, count)."""
    return np.array([path(tick * period_s - delay) for tick in range(count)]).T


def _broken(rig: RigConfig, found: Records) -> str:
    """The first limit that a tick broke."""
    limits, period_s = motion_limits(rig)[0], rig.period_ns * 1e-9
    at, speed = found["setpoint_position"][:, 0], found["setpoint_velocity"][:, 0]
    checks = {
        "fault": bool(found["fault"].any()),
        "fence": bool(at.min() < limits.low - 1e-9 or at.max() > limits.high + 1e-9),
        "speed": bool(np.abs(speed).max() > limits.speed * (1 + 1e-9)),
        "acceleration": bool(np.abs(np.diff(speed)).max() > limits.acceleration * period_s * (1 + 1e-6)),
    }
    return next((name for name, broken in checks.items() if broken), "")


def as_task(rig: Path, overrides: list[str], seconds: float = 2.5) -> float:
    """The path's error where it is the rig's task, RMS over its period, m."""
    with tempfile.TemporaryDirectory() as folder:
        rows = [f"{k * 1e-3:.3f},{path(k * 1e-3)[0]:.12g}" for k in range(round(PERIOD_S * 1e3) + 1)]
        file = Path(folder) / "path.csv"
        file.write_text("\n".join(["time_s,x", *rows]) + "\n")
        task = ["task={kind='path', axes=['x'], file='" + str(file) + "', approach_s=0.1, settle_s=0.0}"]
        config = load_rig(rig, [*overrides, *task])
        errors: list[float] = []

        def keep(tick: object, frames: object, result: CycleResult) -> None:
            if result.record["task_ns"] >= 0 and result.record["setpoint_velocity"][0] != 0.0:
                errors.append(float(result.record["following_error"][0]))

        run = LockstepRun(config, rig.parent, observer=keep)
        while run.index * config.period_ns < seconds * 1e9:
            run.tick()
    return float(np.sqrt(np.mean(np.square(errors))))


def streams(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    rates: Annotated[str, typer.Option(help="of knots, Hz, separated by commas")] = "10,30,100,1000",
    only: Annotated[str, typer.Option(help="networks whose name has this")] = "",
    seed: Annotated[int, typer.Option(help="of what the network does")] = 1,
    as_json_to: JsonTarget = None,
) -> None:
    """Streams of set-points through bad networks: limits, error, rest. Exit status 1: a bar was missed."""
    config = load_rig(rig, overrides or [])
    task = as_task(rig, overrides or [])
    table = Table(
        title=f"{config.name}: {REACH * 1e3:g} mm to and fro in {PERIOD_S:g} s; as a task: {task * 1e9:.0f} nm RMS"
    )
    for heading in ("Hz", "network", "sent", "arrived", "late", "order", "limited", "RMS um", "most um", "ms late",
                    "rest ms", "missed"):  # fmt: skip
        table.add_column(heading, justify="left" if heading in ("network", "missed") else "right")
    result, missed = [], 0
    for rate_hz in map(float, rates.split(",")):
        for network in (one for one in NETWORKS if only in one.name):
            one = through(config, rig.parent, network, rate_hz, seed)
            failed = bars_missed(network, one, task)
            missed += bool(failed)
            result.append({"rate_hz": rate_hz, "network": network.name, "missed": failed, **one._asdict()})
            table.add_row(
                f"{rate_hz:g}", network.name, *(str(n) for n in one[:5]), f"{one.error * 1e6:.2f}",
                f"{one.worst * 1e6:.2f}", f"{one.delay * 1e3:.0f}", f"{one.rests * 1e3:.0f}", failed or "-",
            )  # fmt: skip
    publish({"rig": config.name, "task_error": task, "streams": result, "missed": missed}, [table], as_json_to)
    raise typer.Exit(missed > 0)


def bars_missed(network: Network, one: Streamed, task: float) -> str:
    """The bars that a stream missed, "" for none."""
    found = [one.broken] if one.broken else []
    if one.rests > REST_S:
        found.append("rest")
    if network.name == "clean" and one.error > MOST_RATIO * task:
        found.append("error")
    return ", ".join(found)
