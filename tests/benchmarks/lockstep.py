"""`make bench ARGS=lockstep`: virtual seconds per second of a whole rig (protocol, wire, drives, cycle) on a core."""

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from drivers.frame import Frame
from hil.cli.options import Overrides, RigFile
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CycleResult, Tick
from hil.operate.bench.blocks import (
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    publish,
    spread,
    values_of,
)
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import usable

WARM_UP_TICKS = 500


def lockstep(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    laws: Annotated[
        str, typer.Option(help="laws to measure, separated by commas")
    ] = "pd-feedforward,structured-kalman",
    blocks: Annotated[int, typer.Option(min=1)] = 5,
    seconds: Annotated[float, typer.Option(min=0.1, max=1e6, help="virtual seconds per block")] = 5.0,
    as_json_to: JsonTarget = None,
) -> None:
    """How much faster than real time a whole rig runs in lockstep, on one core."""
    names = laws.split(",")
    rigs = {name: usable(load_rig(rig, [f"law.name={name}", *(overrides or [])]), rig) for name in names}
    cases = [Case(name, partial(measure, config, rig.parent, seconds)) for name, config in rigs.items()]
    measured = interleave(cases, blocks)
    factors = {name: spread(values_of(measured, name, "realtime_factor")) for name in names}
    result = {
        "realtime_factor": factors[names[0]].median,
        "laws": {name: factor._asdict() for name, factor in factors.items()},
        "blocks": as_json(measured),
    }
    figures = ["realtime_factor", "cpu_factor", "cycle_us", "wire_and_plant_us"]
    lines = [f"{name}: {factor.median:.1f} times real time" for name, factor in factors.items()]
    publish(result, [block_table("lockstep", measured, figures)], as_json_to, lines)


def measure(config: RigConfig, base_dir: Path, seconds: float) -> Figures:
    """One block. realtime_factor: by the clock on the wall; cpu_factor: by CPU time, whatever the neighbours do."""
    run = LockstepRun(config, base_dir)
    for _ in range(WARM_UP_TICKS):
        run.tick()
    ticks = round(seconds * 1e9 / config.period_ns)
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(ticks):
        run.tick()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    cycle = _cycle_share(run, min(ticks, 1000))
    return {
        "realtime_factor": seconds / wall,
        "cpu_factor": seconds / cpu,
        "cycle_us": cycle,
        "wire_and_plant_us": cpu / ticks * 1e6 - cycle,
    }


class _TimedCycle:
    """A run's cycle, with the CPU time of its steps added up; everything else is the cycle's own."""

    def __init__(self, cycle: ControlCycle) -> None:
        self._cycle = cycle
        self.spent_ns = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cycle, name)

    def step(self, tick: Tick, frames: Sequence[Frame]) -> CycleResult:
        """As the cycle's."""
        began = time.process_time_ns()
        result = self._cycle.step(tick, frames)
        self.spent_ns += time.process_time_ns() - began
        return result


def _cycle_share(run: LockstepRun, ticks: int) -> float:
    """CPU time of the cycle's own step in a tick, us."""
    timed = _TimedCycle(run.cycle)
    run.cycle = timed  # type: ignore[assignment]
    for _ in range(ticks):
        run.tick()
    return timed.spent_ns / ticks / 1e3
