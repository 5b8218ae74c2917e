"""A service that runs for days: the thousandth activation, reset, fault or wrap is the first one, tick by tick.

One control cycle lives through the same short lives again and again, in an order that never repeats: each begins with
an operator's reset, stays one tick short of every limit it can without a fault, and ends in one of many ways. What a
life shows must be what the same life shows in a process of its own; a streak, a counter or an estimate that outlives
an activation makes some later life differ.
"""

import random
from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers.bus.counters import BusState
from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS
from tests.support.scripted_drives import Script, ScriptedDrives, Shown

SHORT = [
    "bus.protocol=stage_classic",  # sequence numbers wrap every 32 ticks
    "safety.ready_ticks=4", "safety.enable_timeout_ticks=9", "safety.disable_timeout_ticks=9", "safety.stop_s=0.01",
    "safety.silent_stop_ticks=3", "safety.silent_zero_ticks=6", "safety.overrun_streak=3", "safety.stuck_ticks=9",
    "safety.bad_frame_limit=4", "safety.transmit_refused_limit=3", "timing.allow_degraded=true",
]  # fmt: skip
SETTLED = 6  # ticks: every axis has answered again, and the filters begin from there
WELL = Script()
STUBBORN = Script(obeys=False)
SILENT = Script(silent=(1,))
REFUSED = Script(counted={"refused": 1})
NO_ACK = Script(counted={"no_ack": 1})
LATE = Script(slots=2)


def operator(kind: CommandKind, during: Script = WELL) -> Script:
    return replace(during, commands=(kind,))


# Streaks that go on over a reset or an activation: the ticks before it and those after it count apart.
BEFORE = Script(slots=2, counted={"refused": 1})
EDGE = Script(slots=2, counted={"refused": 1, "no_ack": 1})
GLITCH = replace(EDGE, counts=10**6)


# What a life may end with, and the fault that latches in it; each has streaks that are one tick short in `brush`.
ENDS: dict[str, tuple[list[Script], Fault]] = {
    "stopped": ([operator(CommandKind.STOP), *[WELL] * 12], Fault.NONE),
    "emergency stop": ([operator(CommandKind.ESTOP), WELL], Fault.NONE),
    "silence": ([SILENT] * 3 + [WELL] * 12, Fault.ENCODER_LOST),
    "all silent": ([Script(silent=(0, 1))] * 7, Fault.ENCODER_LOST),
    "damaged": ([Script(damaged=2), Script(damaged=2)], Fault.BAD_FRAMES),
    "drive fault": ([Script(status=int(DriveStatus.FAULT))], Fault.DRIVE_FAULT),
    "drive watchdog": ([Script(status=int(DriveStatus.WATCHDOG)), WELL], Fault.DRIVE_WATCHDOG),
    "jump": ([Script(counts=10**6)] * 3, Fault.ENCODER_JUMP),
    "refused": ([REFUSED] * 3, Fault.TRANSMIT_BLOCKED),
    "no acknowledgement": ([NO_ACK] * 2, Fault.NO_ACK),
    "bus-off": ([Script(bus=BusState.BUS_OFF)] * 3, Fault.BUS_OFF),
    "interface down": ([Script(counted={"down": 1})], Fault.INTERFACE_DOWN),
    "late": ([LATE] * 3 + [WELL] * 12, Fault.OVERRUN_BURST),
    "flood": ([Script(unknown=12)] + [WELL] * 12, Fault.RECEIVE_FLOOD),
    "enabled over a reset": (
        [
            operator(CommandKind.ESTOP),
            *[STUBBORN] * 7,
            operator(CommandKind.RESET, STUBBORN),
            *[STUBBORN] * 8,
            *[WELL] * 9,
        ],
        Fault.NONE,
    ),
    "stays enabled": ([operator(CommandKind.ESTOP), *[STUBBORN] * 9], Fault.DRIVE_STAYS_ENABLED),
}


def brush() -> Iterator[Script]:
    """Every streak to one tick short of its limit, and broken off by what follows."""
    yield from [SILENT] * 2
    yield from [REFUSED] * 2
    yield NO_ACK
    yield from [LATE] * 2
    yield Script(counts=10**6)  # a single glitch
    yield Script(unknown=11)
    yield WELL


def life(end: str) -> Iterator[Script]:
    """From a reset to one end."""
    yield operator(CommandKind.ESTOP)  # the one way out of every state
    yield operator(CommandKind.RESET)
    yield from [
        BEFORE,
        operator(CommandKind.RESET, EDGE),
        EDGE,
        BEFORE,
    ]  # whatever was before, drives have been spoken to
    yield from [WELL] * 12  # the drives see the reset; READY
    yield from brush()
    yield from [BEFORE, operator(CommandKind.ACTIVATE, GLITCH)]
    yield from [replace(GLITCH, obeys=False), replace(BEFORE, obeys=False)]
    if end == "never enabled":
        yield from [STUBBORN] * 7
        return
    yield from [STUBBORN] * 5  # a slow drive, one tick short of the time it has
    yield from [WELL] * 2
    yield from brush()
    yield Script(damaged=3)  # one short of a fault: the bucket is emptied by the reset alone
    yield operator(CommandKind.ACTIVATE)  # refused, and counted
    yield from ENDS[end][0]


LIVES = [*ENDS, "never enabled"]


@pytest.fixture(scope="module")
def rig() -> RigConfig:
    return load_rig(RIGS / "paper.toml", SHORT)


def newborn(rig: RigConfig) -> ScriptedDrives:
    drives = ScriptedDrives(rig)
    drives.tick()
    return drives


def live(drives: ScriptedDrives, end: str) -> list[Shown]:
    drives.sample_ns = 50_000 + 10_000 * LIVES.index(end)  # drives differ in what is learnt of their clocks, too
    return [drives.tick(script) for script in life(end)]


@pytest.fixture(scope="module")
def first(rig: RigConfig) -> dict[str, list[Shown]]:
    """Each life in a process that has lived no other."""
    return {end: live(newborn(rig), end) for end in LIVES}


@pytest.mark.parametrize("end", LIVES)
def test_a_life_is_what_its_script_says(first: dict[str, list[Shown]], end: str) -> None:
    shown = first[end]
    fault = Fault.ENABLE_TIMEOUT if end == "never enabled" else ENDS[end][1]
    reset = 3  # the tick of the second one
    assert [s.state for s in shown[reset + 2 : reset + 4]] == [State.CONNECTED, State.READY], "after four good ticks"
    latched = [s.fault for s in shown[2:]]
    assert {*latched} == {Fault.NONE, fault}
    expected = {"stopped": State.READY, "emergency stop": State.ESTOP, "stays enabled": State.ESTOP}
    expected["enabled over a reset"] = State.READY
    assert shown[-1].state is expected.get(end, State.FAULT)
    active = [s for s in shown if s.state is State.ACTIVE]
    assert active
    if end != "never enabled":
        assert any(s.command and any(s.command.force) for s in active), "there was a force to begin with"
    assert sum(s.refused for s in shown) == (end != "never enabled")


def same_lives(rig: RigConfig, first: dict[str, list[Shown]], lives: int) -> ScriptedDrives:
    drives, order = newborn(rig), random.Random(29)
    for number in range(lives):
        end = order.choice(LIVES)
        for tick, (shown, expected) in enumerate(zip(live(drives, end), first[end], strict=True)):
            if tick < SETTLED:
                continue  # what was there before the reset is still being shown
            assert shown == expected, f"life {number}, {end}, tick {tick}"
    return drives


def test_a_hundred_lives_later_each_is_still_what_it_was(rig: RigConfig, first: dict[str, list[Shown]]) -> None:
    drives = same_lives(rig, first, 100)
    assert drives.cycle.sent_sequence > 80 * 32


@pytest.mark.slow
def test_five_thousand_lives_later_each_is_still_what_it_was(rig: RigConfig, first: dict[str, list[Shown]]) -> None:
    drives = same_lives(rig, first, 5000)
    assert drives.cycle.sent_sequence > 2**17, "wrapped thousands of times, beyond 16 bits too"
