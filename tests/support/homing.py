"""One homing of a rig's first axis in lockstep, with switches, counter and stops as a test wants them."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.cycle.axis_homing import Step
from hil.cycle.fault_table import ROWS, Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS, ROOT

PLACE = -0.02  # m, where the switch closes, the index or the stop is
FARTHEST = 0.1  # m
START, ZERO = 0.01, 0.0031  # m, where the table stands, and where its counter was switched on
ABOVE, FORCE = PLACE + 0.012, 3.0  # m, N: where a table stands that its drive homes, and what the drive may ask for
BY = {
    "switch": f"home={PLACE}",
    "limit": f"low={PLACE}",
    "index": f"index={PLACE}",
    "stop": "",
    "drive": "",
    "here": "",
    "absolute": "",
}
SEARCHING = ("switch", "limit", "index", "stop")
LIMIT_TICKS = 30_000  # of one homing


class Homed(NamedTuple):
    """state, fault: at the end. why: HOMING_FAILED's words. steps: sub-states, in order. off: m by which positions are
    wrong. way: m, the greatest from where the table stood. known: the axis counts as homed.
    """

    state: State
    fault: Fault
    why: str
    steps: list[Step]
    off: float
    way: float
    known: bool


def homing_rig(
    by: str, folder: Path, *, contact: str = "sound", start: float = START, zero: float = ZERO, home: str = "",
    more: Sequence[str] = (),
) -> RigConfig:  # fmt: skip
    """The paper's rig, whose X axis homes so; a copy of it with a stage between stops for `stop`. zero: m."""
    shutil.copy(RIGS / "paper.toml", folder)
    shutil.copy(ROOT / "tests/support/walled.py", folder)
    place = f", {BY[by]}" if BY[by] else ""
    counter = "" if by in ("absolute", "drive") else f", zero={zero}"
    searches = by in SEARCHING
    way = f", farthest={FARTHEST}, speed=0.1, latch_speed=0.01, at={PLACE}" if searches else ""
    walls = ["plant.stage=./walled.py:Walled", f"plant.parameters={{low={PLACE}, high=1.0}}"] if by == "stop" else []
    return load_rig(
        folder / "paper.toml",
        [
            f'plant.switches=[{{axis="x"{place}{counter}, contact="{contact}"}}]',
            f'axes.x.home={{by="{by}"{way}{", force=4.0" if by == "stop" else ""}{home}}}',
            f"axes.x.limits.switches={'true' if by == 'limit' else 'false'}",
            f"plant.initial_position=[{start}, 0.0]",
            *walls,
            *more,
        ],
    )


def homed_by_drive(
    document: dict[str, Any], home: Mapping[str, Any], there: Mapping[str, Any], *, start: float, weight: float,
    braked: bool, **drive: Any,
) -> RigConfig:  # fmt: skip
    """The rig of a document, whose X its drive homes so. there: X's [[plant.switches]]. weight: N, of the model, which
    is never quite true. drive: keys of its [plant.drive].
    """
    x, plant = document["axes"]["x"], document["plant"]
    asked = {"by": "drive", "farthest": FARTHEST, "speed": 0.05, "latch_speed": 0.02, "force": FORCE, "at": PLACE}
    x["home"] = asked | dict(home)
    x["model"]["gravity"] = weight
    for axis in document["axes"].values():
        del axis["push"]
    document["drives"] = document.get("drives", {}) | {"brake": [braked, False]}
    plant["gravity"] = [1.04 * weight, 0.0]
    plant |= {"switches": [{"axis": "x", **there}], "initial_position": [start, 0.0]}
    plant["drive"] |= drive
    return RigConfig.model_validate(document)


def homed_on(
    rig: RigConfig, folder: Path, tampered: Callable[[LockstepRun], None] | None = None
) -> tuple[LockstepRun, Homed]:
    """As home_once; where it failed, the drives are without torque in the very next tick."""
    run, homed = home_once(rig, folder, tampered=tampered)
    if homed.fault is not Fault.NONE:
        run.tick()
        assert not any(servo.force for servo in run.stage.drives), "no torque is left"
    return run, homed


def on_the_way(do: Callable[[LockstepRun], object]) -> Callable[[LockstepRun], None]:
    """Once, 5 mm behind where the table stood."""
    done: list[int] = []

    def tamper(run: LockstepRun) -> None:
        if run.true_position[0] < ABOVE - 5e-3 and not done:
            done.append(1)
            do(run)

    return tamper


def stopped_by(command: CommandKind, rig: RigConfig, folder: Path) -> LockstepRun:
    """A homing by the drive that an operator ends on the way: there is no torque from the next tick on."""

    def stop(run: LockstepRun) -> None:
        asked = [command]
        run._operator = lambda run, index: [asked.pop()] if asked else ()

    run, homed = home_once(rig, folder, tampered=on_the_way(stop))
    assert not homed.known
    run.tick()
    place = run.true_position[0]
    assert not any(servo.force for servo in run.stage.drives)
    for _ in range(300):
        run.tick()
        assert not any(servo.force for servo in run.stage.drives)
    assert abs(run.true_position[0] - place) < 5e-3
    assert run.cycle.state is (State.READY if command is CommandKind.STOP else State.ESTOP)
    return run


def reset_to_ready(run: LockstepRun) -> None:
    """A reset leads to READY."""
    asked = [CommandKind.RESET]
    run._operator = lambda run, index: [asked.pop()] if asked else ()
    for _ in range(3000):
        run.tick()
        if run.cycle.state is State.READY:
            break
    assert run.cycle.state is State.READY, run.cycle.problems


def home_once(
    rig: RigConfig,
    folder: Path,
    keep: Callable[[np.void], None] | None = None,
    places: list[list[float]] | None = None,
    *,
    tampered: Callable[[LockstepRun], None] | None = None,
    run: LockstepRun | None = None,
) -> tuple[LockstepRun, Homed]:
    """Until it is homed, or a fault has stopped it. keep: called with the record of every tick. places: true positions
    of all axes after every tick are added here. tampered: called before every tick of HOMING. run: goes on, READY.
    """
    asked: list[int] = []

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        if run.cycle.state is not State.READY or asked:
            return ()
        asked.append(index)
        return (CommandKind.HOME,)

    run = run or LockstepRun(rig, folder)
    run._operator = operator
    start, way, steps, why = float("nan"), 0.0, [Step.NONE], ""
    homing = run.cycle.homing
    assert homing is not None
    while not asked or run.cycle.state in (State.HOMING, State.STOPPING):
        if tampered is not None and run.cycle.state is State.HOMING:
            tampered(run)
        record = run.tick().record
        if keep is not None:
            keep(record)
        place = float(run.true_position[0])
        if places is not None:
            places.append(run.true_position.tolist())
        if run.cycle.state is State.HOMING and start != start:
            start = place
        way = max(way, abs(place - start)) if start == start else 0.0
        step = Step(int(record["homing"]) & 15)
        if step is not steps[-1]:
            steps.append(step)
        for found in run.cycle.monitor.evidence:
            if found.fault == Fault.HOMING_FAILED:
                why = ROWS[Fault.HOMING_FAILED].words[int(found.value)]
        assert run.index < LIMIT_TICKS
    clock, zero = run.cycle.sampling.clocks[0], 0.0
    counter = run.stage.drives[0].counter
    if counter is not None:
        zero = counter.zero
    off = clock.offset * rig.axes["x"].encoder_resolution - zero
    return run, Homed(run.cycle.state, run.cycle.fault, why, steps[1:-1], off, way, homing.known[0])
