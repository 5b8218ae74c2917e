"""Outputs whose node is not ours, on an emulated bus: by a DBC file, and CANopen devices of CiA 401 and CiA 404."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hil
from drivers.frame import Frame
from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.carried_code import carried_code
from hil.rig.schema import RigConfig, RigError
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from sim_plant.nodes.other_outputs import CanopenOutputNode
from sim_plant.nodes.output import OutputNode
from tests.support.kept_readings import Kept
from tests.virtual.output_files import KINDS, eds, light_beside, rig_with

VALVE = 4  # bit 2


def asks(bits: Callable[[int], int]) -> Callable[[hil.Observation], hil.References]:
    """A motion at rest that asks for these outputs by tick."""
    return lambda seen: hil.References([0.0] * 4, [0.0] * 4, outputs=bits(seen.tick))


class Switched(Kept):
    """node: of the outputs. on: its bits after each tick. said: `outputs` of the records."""

    def __init__(self, rig: RigConfig, folder: Path, bits: Callable[[int], int] = lambda tick: VALVE) -> None:
        super().__init__(rig, folder)
        decided = self.run.cycle.supervisor.goals.decided
        assert decided is not None
        decided.motion.told = asks(bits)
        self.node: OutputNode = self.run.stage.outputs.nodes[0]
        self.on: list[int] = []

    def ticks(self, count: int) -> "Switched":
        for _ in range(count):
            self.run.tick()
            self.on.append(self.node.bits)
        return self

    def begin(self) -> "Switched":
        """Until the motion runs."""
        while self.run.cycle.supervisor.goals.word is not MotionWord.MOTION:
            assert self.ticks(1).run.index < 2000
        return self

    @property
    def said(self) -> list[int]:
        return [int(row["outputs"]) for row in self.rows]


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_valve_opens_as_asked_and_no_longer_than_it_may(kind: str, tmp_path: Path) -> None:
    rig = rig_with(kind, tmp_path)
    told = Switched(rig, tmp_path, lambda tick: VALVE if 10 <= tick < 30 or tick >= 60 else 0).begin().ticks(200)
    assert told.run.cycle.fault is Fault.NONE
    assert told.run.cycle.problems == []
    assert set(told.said) == set(told.on) == {0, VALVE}
    assert sum(bits > 0 for bits in told.said) == 20 + 50
    assert told.on[1:] == told.said[1:], "the node switches in the tick in which the host does"
    slower = rig_with(kind, tmp_path, "rate_hz=800")  # at 1 kHz four CANopen drives leave no room on the bus
    assert refuse_unschedulable(slower, tmp_path).n_axes == 4, "the traffic fits"


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_it_closes_in_the_tick_of_a_fault_and_when_the_host_is_silent(kind: str, tmp_path: Path) -> None:
    told = Switched(rig_with(kind, tmp_path, "outputs.valve.longest_s=9"), tmp_path).begin().ticks(20)
    assert told.on[-1] == VALVE
    told.run.stop = True
    told.ticks(2)
    assert told.run.cycle.state is not State.ACTIVE
    assert told.on[-1] == 0
    told = Switched(rig_with(kind, tmp_path, "outputs.valve.longest_s=9"), tmp_path).begin().ticks(20)
    now_ns = told.run.stage.now_ns
    told.run.stage.advance(now_ns + 8_000_000)
    assert told.node.bits == VALVE
    told.run.stage.advance(now_ns + 11_000_000)
    assert told.node.bits == 0


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_run_with_it_replays_byte_for_byte_from_the_file_alone(kind: str, tmp_path: Path) -> None:
    rig = rig_with(kind, tmp_path)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, tmp_path / "rig.toml")
    run = LockstepRun(rig, tmp_path, observer=recorder.observe)
    for _ in range(700):
        run.tick()
    recorder.close()
    for name in ("valves.dbc", "valves.eds"):
        (tmp_path / name).unlink()
    report = replay_run(tmp_path / "run.mcap", permitted=[code.digest for code in carried_code(rig)])
    assert (report.ticks, report.gap_at) == (run.index, None)
    assert not report.different


def canopen(told: Switched) -> CanopenOutputNode:
    """Its node."""
    assert isinstance(told.node, CanopenOutputNode)
    return told.node


def test_a_device_is_told_to_fall_to_0_and_read_back_before_it_is_started(tmp_path: Path) -> None:
    told = Switched(rig_with("cia401", tmp_path), tmp_path).ticks(150)
    sdo = [frame.data.hex() for frame in told.sent if frame.can_id == 0x65A]
    assert sdo[:6] == [
        "2f191000f0000000", "2f001402ff000000", "2b17100014000000", "2b0014050a000000", "2f07620200000000",
        "2f066202ff000000",
    ]  # fmt: skip
    assert [text[:2] for text in sdo[6:]] == ["40"] * 6, "all but the counter, and the polarity"
    start = Frame(0, bytes((1, 90)))
    assert start in [Frame(frame.can_id, frame.data) for frame in told.sent]
    values = canopen(told).device.dictionary
    assert [values.number(at << 8 | 2) for at in (0x6206, 0x6207)] == [0xFF, 0]


def test_a_device_without_a_timer_watches_the_hosts_heartbeat(tmp_path: Path) -> None:
    told = Switched(rig_with("cia401", tmp_path, device=eds(timer=False)), tmp_path).ticks(150)
    assert "23161001" + "64007f00" in [frame.data.hex() for frame in told.sent if frame.can_id == 0x65A]
    assert told.run.cycle.problems == []


def test_nothing_is_set_before_the_device_runs_and_it_is_started_again_after_a_boot_up(tmp_path: Path) -> None:
    told = Switched(rig_with("cia401", tmp_path, "outputs.valve.longest_s=9"), tmp_path).begin().ticks(20)
    canopen(told).device._boot()
    told.ticks(30)
    assert told.said[-1] == told.on[-1] == 0, "the host knows that it is not switched"
    told.ticks(120)
    assert told.run.cycle.fault is Fault.NONE
    assert told.run.cycle.outputs is not None
    assert told.run.cycle.outputs._writers[0].ready
    assert told.on[-1] == 0, "not again before it was not asked for"


def test_a_device_that_is_silent_is_told_by_name(tmp_path: Path) -> None:
    told = Switched(rig_with("cia401", tmp_path), tmp_path)
    canopen(told).device.on_frame = lambda frame: []  # type: ignore[method-assign]
    told.ticks(300)
    (problem,) = told.run.cycle.problems
    assert problem == "outputs.valve: node 90: no answer to 1019h:00"


def test_a_device_that_refuses_says_so_by_the_objects_name(tmp_path: Path) -> None:
    told = Switched(rig_with("cia401", tmp_path, device=eds(access="ro")), tmp_path).begin().ticks(20)
    (problem,) = told.run.cycle.problems
    assert "outputs.valve: node 90: 6207h:02 aborted" in problem
    assert not any(told.on + told.said)


def test_a_frame_that_is_none_of_a_node_changes_nothing(tmp_path: Path) -> None:
    told = Switched(rig_with("dbc", tmp_path, "outputs.valve.longest_s=9"), tmp_path).begin().ticks(20)
    before = told.node.taken
    for data in (b"", bytes(3), told.sent[-1].data):
        told.node.hear(Frame(0x3E0, data), told.run.stage.now_ns)
    assert (told.node.taken, told.node.bits) == (before, VALVE)
    assert told.node.ignored == 3, "too short twice, and one with the count of the last"


def test_two_outputs_share_a_frame_and_each_has_its_place(tmp_path: Path) -> None:
    light = (
        KINDS["dbc"].replace("outputs.valve", "outputs.light").replace("bit=2", "bit=0").replace('"Valve"', '"Light"')
    )
    told = Switched(rig_with("dbc", tmp_path, light), tmp_path, lambda tick: tick % 8).begin().ticks(40)
    assert {frame.data[0] for frame in told.sent if frame.can_id == 0x3E0} == {0, 8}
    assert set(told.on) == {0, 1, VALVE, 1 | VALVE}
    assert np.array_equal(told.on[1:], told.said[1:])


REFUSED = {
    "dbc": [
        ("outputs.valve.file='none.dbc'", "outputs.valve.file: "),
        ("outputs.valve.signal='Gate'", "outputs.valve.signal = 'Gate': message Switches has Light, "),
        ("outputs.valve.signal='Level'", "outputs.valve.signal = 'Level': it carries no 0 and 1"),
        ("outputs.valve.can_id=0x111", "outputs.valve.can_id = 0x111: no such message in valves.dbc: Switches"),
        ("outputs.valve.fd=true", "outputs.valve.fd = true: message Switches of valves.dbc is a classic frame"),
        ("outputs.valve.signal=''", "signal: kind = 'dbc' needs it"),
        ("outputs.valve.node=3", "node: a key of kind = 'cia401' or 'cia404', not of 'dbc'"),
        (light_beside("dbc"), "outputs.light.signal: outputs.valve has it, too"),
        (light_beside("dbc", valves="b"),
         "outputs.light.file = 'b.dbc': outputs.valve, in the same frame, has 'valves.dbc'"),
        ("outputs.valve.kind=other", "outputs.valve.kind"),
    ],
    "cia401": [
        ("outputs.valve.can_id=0x25B", "outputs.valve.can_id = 0x25b: its file has 0x25a for RPDO 1 of node 90"),
        ("outputs.valve.channel=17", "RPDO 1 (1600h) does not carry 6200h:03"),
        ("outputs.valve.kind=cia404", "1000h of its file says device profile 401, expected 404"),
        ("bus.protocol=stage_classic", "has no CANopen master"),
        ("outputs.valve.file='none.eds'", "outputs.valve.file: "),
        ("outputs.valve.channel=0", "channel: kind = 'cia401' needs it"),
        ("bus.node_id=87", "outputs.valve.node = 90: it is the node of a drive"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("kind", "change", "words"), [(k, *pair) for k, pairs in REFUSED.items() for pair in pairs])
def test_what_cannot_be_is_refused_by_its_key(kind: str, change: str, words: str, tmp_path: Path) -> None:
    with pytest.raises((RigError, ValueError)) as refused:
        LockstepRun(rig_with(kind, tmp_path, change), tmp_path)
    assert words in str(refused.value)


@pytest.mark.parametrize("without", ["6206", "6207"])
def test_a_device_whose_outputs_nobody_can_let_fall_is_refused(without: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"outputs.valve.file: no object {without}h:02: what its outputs do when"):
        LockstepRun(rig_with("cia401", tmp_path, device=eds(without=without)), tmp_path)
