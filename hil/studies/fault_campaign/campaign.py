"""The whole campaign, over processes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.crew import crew, resumed
from hil.studies.fault_campaign.matrix import Cell, Chunk, displaced, plan_chunks, run_chunk
from hil.virtual.sim import usable

_Work = TypeVar("_Work")


def campaign(
    rigs: Sequence[Path],
    stride: int,
    jobs: int,
    done: Callable[[int, int], None],
    overrides: Sequence[str] = (),
    only: str = "",
    scheduler: str = "",
    *,
    motion: bool = False,
) -> list[Cell]:
    """All cells of all rigs, in the same order whatever the number of processes.

    done: called with cells done and cells in all. overrides: key=value over every rig file. only: what the names of the
    trials contain. scheduler: of a cluster. motion: while goals move the axes, instead of in the states and the task's
    phases. Raises RigError for a rig that cannot be tried.
    """
    work: list[Chunk] = []
    for path in rigs:
        rig = _checked(load_rig(path, overrides), path)
        work += plan_chunks(rig, path.parent, stride=stride, only=only, motion=motion)
    return over_processes(run_chunk, work, [len(chunk.cells) for chunk in work], jobs, done, scheduler)


def over_processes(
    run: Callable[[_Work], list[Cell]],
    work: Sequence[_Work],
    sizes: Sequence[int],
    jobs: int,
    done: Callable[[int, int], None],
    scheduler: str,
) -> list[Cell]:
    """The cells of all work, in its order. sizes: of each piece of work, of which `done` is told the sum so far and the
    whole.
    """
    cells: list[Cell] = []
    so_far, total = 0, sum(sizes)
    # Spawned, not forked: a worker must be single-threaded to fork its cells.
    with crew(jobs, scheduler, "spawn") as hands:
        for size, found in zip(sizes, resumed(hands, run, work), strict=True):
            cells += found
            so_far += size
            done(so_far, total)
    return cells


def _checked(rig: RigConfig, path: Path) -> RigConfig:
    """The rig as the campaign runs it. Raises RigError where no run of it can begin: its task, law or layout."""
    return usable(displaced(rig), path)
