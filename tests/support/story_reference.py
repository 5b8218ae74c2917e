"""Hashes of what happens in random stories, kept in tests/reference/story_hashes.json.

python -m tests.support.reference stories     renew the file, after a change that is meant to change what happens

On a rig: faults of the scenario language and an operator's orders at random ticks; over every record, every frame and
every event told. On a wire: nodes that send, fail, are purged and restarted under a random script; over every attempt
to send, every frame received and every counter.
"""

import hashlib
import json
from collections.abc import Sequence
from random import Random
from typing import Any

from drivers.frame import BRS, FD, Frame
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.wire import Wire
from hil.cycle.event_notes import CycleEvents
from hil.cycle.state_machine import State
from hil.cycle.step import CycleResult
from hil.cycle.tick import CommandKind, Tick
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from sim_plant.scenario.language import KINDS, FaultConfig, Scenario
from tests.support.paths import RIGS, ROOT

FILE = ROOT / "tests" / "reference" / "story_hashes.json"
MS = 1_000_000
TICKS, STORIES, WIRES = 400, 15, 60
SETS: dict[str, tuple[str, list[str]]] = {
    "paper": ("paper", []),
    "paper, a heartbeat, pushes first": (
        "paper",
        ["safety.heartbeat_s=0.1", "axes.x.push={force=1.6, distance=1e-3}", "axes.y.direction=-1"],
    ),
    "microscope-ideal": ("microscope-ideal", []),
    "microscope-ideal, classic": ("microscope-ideal", ["bus.protocol=stage_classic"]),
}


def _fault(draw: Random, axes: Sequence[str]) -> dict[str, Any]:
    name = draw.choice(sorted(KINDS))
    kind = KINDS[name]
    table: dict[str, Any] = {
        "kind": name,
        "at_tick": draw.randrange(20, TICKS),
        "duration_ticks": draw.randrange(1, 40),
    }
    if kind.unit:
        table["value"] = draw.choice((kind.low, kind.high, 1.0, 1e-4, 1e-2, 3.0))
    if name.startswith("wire_"):
        return table | {"node": draw.choice([*axes, "host"]), "count": draw.randrange(20)}
    return table | ({"axis": draw.choice(axes)} if draw.randrange(4) else {})


def _scenario(draw: Random, axes: Sequence[str]) -> Scenario:
    """Up to three faults; what the language refuses is left out."""
    accepted = []
    for _ in range(draw.randrange(1, 4)):
        try:
            accepted.append(FaultConfig.model_validate(_fault(draw, axes)))
        except ValueError:
            continue
    return Scenario(fault=accepted)


def story_hash(name: str, number: int) -> tuple[str, list[str]]:
    """Of one story of a rig; and the faults that latched."""
    base, sets = SETS[name]
    rig = load_rig(RIGS / f"{base}.toml", sets)
    draw = Random(f"{name} {number}")
    orders = {draw.randrange(TICKS): draw.choice(list(CommandKind)) for _ in range(5)}
    stream = CycleEvents([(axis, config.kind) for axis, config in rig.axes.items()], rig.period_ns)
    told, latched = hashlib.sha256(), list[str]()

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        """Resets what latched after a while, and activates what is ready."""
        asked = [orders[index]] if index in orders else []
        if run.cycle.state is State.READY:
            asked.append(CommandKind.ACTIVATE)
        elif index % 50 == 49:
            asked.append(CommandKind.RESET)
        return [*asked, CommandKind.HEARTBEAT] if index % 30 == 0 else asked

    def observe(tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        told.update(result.record.tobytes())
        for event in stream.observe(run.cycle, result.record):
            told.update(json.dumps(event.document).encode())
        if run.cycle.fault.name not in latched:
            latched.append(run.cycle.fault.name)

    run = LockstepRun(rig, RIGS, operator=operator, observer=observe, scenario=_scenario(draw, rig.axis_names))
    for index in range(TICKS):
        if draw.randrange(97) == 0:
            run.skip(draw.choice((1, 2, 5, 30)))
        if index == TICKS // 2:
            run.grants[draw.choice(list(run.grants))] = False
        run.tick()
    for event in stream.close():
        told.update(json.dumps(event.document).encode())
    told.update(run.trace_sha256.encode())
    return told.hexdigest(), latched


def wire_hash(number: int) -> str:
    """Of one segment."""
    draw, told = Random(f"wire {number}"), hashlib.sha256()
    script = [_wire_fault(draw) for _ in range(draw.randrange(1, 5))]

    def attempt(*what: object) -> None:
        told.update(repr(what).encode())

    wire = Wire(1_000_000, draw.choice((1, 2, 5)) * 1_000_000, faults=script, seed=number, observer=attempt)
    nodes = [
        wire.attach(
            name, lambda frame, name=name: attempt(name, frame), queue_length=draw.randrange(1, 6),
            fifo=draw.random() < 0.5, accept=None if draw.randrange(3) else {1, 0x100, 0x300},
        )
        for name in ("host", "drive0", "drive1", "other")
    ]  # fmt: skip
    for step in range(60):
        for _ in range(draw.randrange(4)):
            node, flags = draw.choice(nodes), draw.choice((0, 0, FD, FD | BRS))
            can_id, length = draw.choice((1, 0x100, 0x200, 0x300, 0x7FF, 1 << 31 | 5)), draw.choice((0, 1, 4, 8))
            attempt(node.send(Frame(can_id, draw.randbytes(length), flags), wire.now_ns))
        wire.advance(wire.now_ns + draw.choice((1, 40_000, 200_000, MS, 3 * MS)))
        chosen = draw.choice(nodes)
        if draw.randrange(12) == 0:
            attempt(chosen.purge())
        if step % 9 == 8:
            chosen.restart(wire.now_ns)
        attempt([(node.name, node.counters(), node.tec, node.rec, len(node.queue)) for node in nodes], wire.busy_ns)
    return told.hexdigest()


def _wire_fault(draw: Random) -> WireFault:
    kind = draw.choice(list(FaultKind))
    begins, node = draw.randrange(30 * MS), draw.choice(("host", "drive0", "drive1"))
    return WireFault(
        kind, begins, begins + draw.randrange(1, 9 * MS), node="babbler" if kind is FaultKind.BABBLE else node,
        can_id=draw.choice((None, 1, 0x100)), count=draw.randrange(12), probability=draw.choice((1.0, 0.5, 0.1)),
        delay_ns=draw.randrange(2 * MS), bit=draw.choice((-1, 3, 30)),
    )  # fmt: skip


def hashes() -> dict[str, Any]:
    """The file's content."""
    rigs = {name: [story_hash(name, number)[0] for number in range(STORIES)] for name in SETS}
    return {"rigs": rigs, "wires": [wire_hash(number) for number in range(WIRES)]}


def renew() -> None:
    """Write the file anew."""
    FILE.write_text(json.dumps(hashes(), indent=1) + "\n", encoding="utf-8")
