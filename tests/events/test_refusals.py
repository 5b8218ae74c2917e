"""Why a command was refused, told from the records of a cycle that refused it."""

import json
from typing import Any

import numpy as np
import pytest

from drivers.bus.counters import BusState
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, OperatorCommand
from hil.events.refusals import Guards, HandledCommand, Refusals, guards_of
from hil.events.stream import stream_of
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from tests.support.paths import RIGS
from tests.support.records import kept
from tests.support.scripted_drives import Script, ScriptedDrives, Shown

ACTIVATE, HOME, RESET, STOP = CommandKind.ACTIVATE, CommandKind.HOME, CommandKind.RESET, CommandKind.STOP
WELL = Script()


class Rig(ScriptedDrives):
    """Scripted drives of the paper's rig, and what is told of the commands to them."""

    def __init__(self, *overrides: str) -> None:
        super().__init__(load_rig(RIGS / "paper.toml", ["safety.ready_ticks=5", "task.kind=hold", *overrides]))
        self.records: list[np.void] = []

    def tick(self, script: Script = WELL) -> Shown:
        """One control period, whose record is kept."""
        shown = super().tick(script)
        assert self.record is not None
        self.records.append(kept(self.record))
        return shown

    def ready(self) -> "Rig":
        while self.tick().state is not State.READY:
            assert len(self.records) < 50
        return self

    def why(self, *commands: CommandKind, **script: Any) -> str:
        """What the last of these commands, all of one tick, was refused by; empty: by nothing."""
        self.tick(Script(commands, **script))
        described = json.loads(json.dumps(describe_run(self.rig, RIGS)["rig"]))
        told = stream_of(described, self.rig.period_ns).tell(np.array(self.records))
        last = [event for event in told if event.kind.name == "COMMAND"][-1]
        return "" if last.name.endswith("accepted") else last.cause.partition("; the state is ")[0]


def test_a_state_that_takes_no_such_command_says_so() -> None:
    rig = Rig()
    rig.tick()
    assert rig.why(ACTIVATE) == "CONNECTED takes no ACTIVATE"
    assert rig.ready().why(STOP) == "READY takes no STOP"
    assert rig.why(ACTIVATE) == ""


@pytest.mark.parametrize(
    ("grant", "overrides", "why"),
    [
        ("rig_ok", (), "the rig file has changed since the start"),
        ("recorder_ok", ("telemetry.recording_required=true",), "no recorder is alive (telemetry.recording_required)"),
        ("realtime_ok", ("timing.allow_degraded=false",), "the kernel did not grant real time (timing.allow_degraded)"),
    ],
)
def test_a_grant_that_is_missing_is_named_where_the_rig_asks_for_it(
    grant: str, overrides: tuple[str, ...], why: str
) -> None:
    rig = Rig(*overrides).ready()
    rig.granted = {grant: False}
    assert rig.why(ACTIVATE) == why
    rig.granted = {}
    assert rig.why(ACTIVATE) == ""


def test_a_heartbeat_that_is_missing_or_old_is_named() -> None:
    rig = Rig("safety.heartbeat_s=0.005").ready()
    why = "no operator's heartbeat within 0.005 s (safety.heartbeat_s)"
    assert rig.why(ACTIVATE) == why
    rig.tick(Script((CommandKind.HEARTBEAT,)))
    for _ in range(6):
        rig.tick()
    assert rig.why(ACTIVATE) == why
    assert rig.why(CommandKind.HEARTBEAT, ACTIVATE) == ""


def test_an_axis_that_moves_is_named_before_the_place_where_the_task_may_begin() -> None:
    rig = Rig().ready()
    rig.tick(Script((CommandKind.ESTOP,)))
    for counts in range(0, 4000, 400):
        rig.tick(Script(counts=counts))
    assert "an axis moves" in rig.why(RESET, counts=4000)


def test_a_fault_whose_cause_is_there_is_named() -> None:
    rig = Rig().ready()
    rig.tick(Script(bus=BusState.BUS_OFF))
    assert rig.cycle.state is State.FAULT
    assert rig.why(RESET, bus=BusState.BUS_OFF) == "bus_off is still there"
    assert rig.why(RESET) == ""


def test_a_task_that_cannot_begin_here_is_what_is_left() -> None:
    rig = Rig().ready()
    rig.cycle.supervisor.start_ranges = [(1.0, 2.0)] * 2
    assert rig.why(ACTIVATE) == "the task cannot begin where the axes stand, or an axis is not known to rest yet"


def test_a_command_that_came_before_is_told_with_both_numbers_and_an_expired_one_with_its_delay() -> None:
    rig = Rig().ready()
    follow, record = Refusals(Guards()), rig.records[-1]
    now = int(record["now_ns"])
    assert follow.cause(record, HandledCommand(ACTIVATE, 1, 7, now), State.READY) == ""
    replayed = follow.cause(record, HandledCommand(ACTIVATE, 0, 7, now), State.READY)
    assert replayed == "replayed: its number 7 is not above 7, that of an earlier command"
    late = follow.cause(record, HandledCommand(ACTIVATE, 0, 8, now - 2_000_000), State.READY)
    assert late == "it expired 2.0 ms before"
    assert follow.cause(record, HandledCommand(99, 0, 8, now), State.READY) == "there is no such command"
    assert OperatorCommand(99, 8, now).kind not in set(CommandKind)


def test_what_a_rig_asks_for_is_read_from_its_description() -> None:
    rig = load_rig(RIGS / "paper.toml", ["safety.heartbeat_s=0.5", "telemetry.recording_required=true"])
    described = json.loads(rig.model_dump_json())
    assert guards_of(described) == Guards(True, not rig.timing.allow_degraded, 0.5)
    assert guards_of({}) == Guards()
