"""`make bench ARGS=batch`: plants times ticks per second of the batch engine, on one core and on all of them."""

import dataclasses
import os
import time
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hil.cli.options import Overrides, RigFile
from hil.cli.processes import worker_pool
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
from hil.virtual.batch import BatchRun
from sim_plant.physics.stage import Truth

SPREAD = 0.2  # of mass and friction, so that no two plants are alike


def batch(
    rig: RigFile = Path("paper"),
    overrides: Overrides = None,
    law: Annotated[str, typer.Option(help="law to measure")] = "structured-kalman",
    plants: Annotated[int, typer.Option(min=1, help="plants per core")] = 2500,
    ticks: Annotated[int, typer.Option(min=1, help="ticks per block")] = 300,
    blocks: Annotated[int, typer.Option(min=1)] = 5,
    as_json_to: JsonTarget = None,
) -> None:
    """Plants times ticks per second of the batch engine."""
    sets = [f"law.name={law}", *(overrides or [])]
    load_rig(rig, sets)
    cores = len(os.sched_getaffinity(0))
    with worker_pool(cores, "spawn") as pool:

        def block(workers: int) -> Figures:
            began = time.perf_counter()
            work = pool.map(measure, repeat(rig), repeat(sets), repeat(plants), repeat(ticks), range(workers))
            walls, cpus = zip(*work, strict=True)
            wall = time.perf_counter() - began
            done = workers * plants * ticks
            return {
                "plant_ticks_per_s": done / max(walls),
                "with_set_up": done / wall,
                "per_cpu_s_of_a_core": done / sum(cpus),
            }

        counts = {1: "1 core", cores: f"{cores} cores"}
        cases = [Case(name, partial(block, workers)) for workers, name in sorted(counts.items())]
        block(cores)  # imports and filter design
        measured = interleave(cases, blocks)
    rates = {case.name: spread(values_of(measured, case.name, "plant_ticks_per_s")) for case in cases}
    result = {
        "plant_ticks_per_s": rates[cases[-1].name].median,
        "law": law,
        "plants_per_core": plants,
        "cases": {name: rate._asdict() for name, rate in rates.items()},
        "blocks": as_json(measured),
    }
    figures = ["plant_ticks_per_s", "with_set_up", "per_cpu_s_of_a_core"]
    table = block_table(f"batch, {law}, {plants} plants per core", measured, figures, 0)
    publish(result, [table], as_json_to, [f"{name}: {rate.median:,.0f} plant-ticks/s" for name, rate in rates.items()])


def measure(rig: Path, overrides: list[str], plants: int, ticks: int, seed: int) -> tuple[float, float]:
    """Seconds that `ticks` ticks of `plants` plants with seeded parameters take in this process: by the clock on the
    wall, and of CPU time, whatever the neighbours do."""
    config = load_rig(rig, overrides)
    nominal = Truth.from_config(config.plant, len(config.axes), config.axis_names)
    random = np.random.default_rng(seed)
    shape = (plants, len(config.axes))
    arrays = {field.name: np.broadcast_to(getattr(nominal, field.name), shape) for field in dataclasses.fields(nominal)}
    for name in ("mass", "coulomb", "viscous"):
        arrays[name] = arrays[name] * random.uniform(1 - SPREAD, 1 + SPREAD, shape)
    run = BatchRun(config, Truth(**{name: np.array(values) for name, values in arrays.items()}))
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(ticks):
        run.tick()
    return time.perf_counter() - wall, time.process_time() - cpu
