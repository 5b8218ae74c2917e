"""Sensors whose frames are not ours, on an emulated bus: of a DBC file, of CiA 404, and of a class of the user's."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.families.cia402 import cia301
from drivers.frame import Frame
from hil.control.law_registry import law_class
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.carried_code import carried_code
from hil.rig.schema import RigError
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from sim_plant.nodes.sensor import invalid, silent, stuck, tapped
from tests.support.kept_readings import Kept
from tests.virtual.sensor_files import KINDS, eds, rig_with

# Punctured at 0.86 mN
CELL = "plant.cells=[{axis='z', surface=-0.0038, direction=-1, stiffness=1.75e8, puncture_depth=170e-6}]"


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_force_that_falls_within_3_ms_is_no_fault_and_in_the_record(kind: str, tmp_path: Path) -> None:
    rig = rig_with(kind, tmp_path, CELL)
    kept = Kept(rig, tmp_path).ticks(4200)
    assert (kept.run.cycle.state, kept.run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert kept.run.cycle.problems == []
    top = int(np.nanargmax(kept.values))
    assert kept.values[top] - kept.values[top + 3] >= 0.75e-3
    assert kept.ages[200:].max() == 0, "sampled in step with the tick, and there in the next"
    assert np.std(kept.values[top + 20 : top + 200]) == pytest.approx(5e-6, rel=0.25)
    assert refuse_unschedulable(rig, tmp_path).n_axes == 4, "the traffic fits"


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_run_with_it_replays_byte_for_byte_from_the_file_alone(kind: str, tmp_path: Path) -> None:
    rig = rig_with(kind, tmp_path, CELL)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, tmp_path / "rig.toml")
    run = LockstepRun(rig, tmp_path, observer=recorder.observe)
    for _ in range(700):
        run.tick()
    recorder.close()
    for name in ("force.dbc", "force.eds", "force.py"):
        (tmp_path / name).unlink()
    report = replay_run(tmp_path / "run.mcap", permitted=[code.digest for code in carried_code(rig)])
    assert (report.ticks, report.gap_at) == (run.index, None)
    assert not report.different


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("tap", "fault"), [(silent, Fault.SENSOR_SILENT), (stuck, Fault.SENSOR_STUCK)])
def test_what_it_fails_by_is_a_fault_by_name(kind: str, tap: Any, fault: Fault, tmp_path: Path) -> None:
    kept = Kept(rig_with(kind, tmp_path), tmp_path).until_active()
    tapped(kept.run.stage.sensors, tap)
    assert kept.ticks(20).run.cycle.fault is fault


@pytest.mark.long
@pytest.mark.parametrize("kind", ["dbc", "cia404"])
def test_what_it_calls_not_valid_is_no_reading(kind: str, tmp_path: Path) -> None:
    kept = Kept(rig_with(kind, tmp_path), tmp_path).until_active()
    tapped(kept.run.stage.sensors, invalid)
    assert kept.ticks(10).run.cycle.fault is Fault.SENSOR_SILENT


@pytest.mark.long
@pytest.mark.parametrize(("value", "more"), [(0x6130, "scale=1e-6"), (0x7130, "stuck_ticks=0"), (0x9130, "scale=1e-8")])
def test_a_device_says_its_value_as_a_float_or_a_whole_number(value: int, more: str, tmp_path: Path) -> None:
    device = eds(value, status=False)
    kept = Kept(rig_with("cia404", tmp_path, CELL, f"sensors.force.{more}", device=device), tmp_path).ticks(900)
    assert kept.run.cycle.fault is Fault.NONE
    assert kept.ages[200:].max() == 0
    assert np.std(kept.values[300:700]) == pytest.approx(5e-6, rel=0.25)


def test_a_device_is_told_to_sample_at_sync_and_read_back_before_it_is_started(tmp_path: Path) -> None:
    kept = Kept(rig_with("cia404", tmp_path), tmp_path).ticks(100)
    told = [frame.data.hex() for frame in kept.sent if frame.can_id == 0x660]
    assert told == ["2f191000f0000000", "2f00180201000000", "4000180200000000"]
    assert Frame(0, bytes((1, 96))) in [Frame(frame.can_id, frame.data) for frame in kept.sent]
    first = int(np.flatnonzero(~np.isnan(kept.values))[0])
    assert first < 60


def test_a_device_that_knows_no_counter_in_sync_goes_with_drives_that_are_sent_none(tmp_path: Path) -> None:
    device = eds(counter=False)
    with pytest.raises(ValueError, match=r"sensors.force.file: no object 1019h.*sync_counter = 'off'"):
        Kept(rig_with("cia404", tmp_path, device=device), tmp_path)
    drives = f"bus.cia402={{eds=['{cia301.EDS}'], write_rated_torque=true, stop_options='keep', sync_counter='off'}}"
    kept = Kept(rig_with("cia404", tmp_path, drives, device=device), tmp_path).ticks(400)
    assert kept.ages[-200:].max() == 0


def test_a_device_that_is_lost_is_configured_and_started_again(tmp_path: Path) -> None:
    kept = Kept(rig_with("cia404", tmp_path, "sensors.force.silent_ticks=500"), tmp_path).ticks(300)
    (node,) = kept.run.stage.sensors
    node.device._boot()  # type: ignore[attr-defined]
    kept.ticks(100)
    assert kept.run.cycle.fault is Fault.NONE
    assert kept.ages[-1] == 0


def test_a_device_that_refuses_says_so_by_the_objects_name(tmp_path: Path) -> None:
    fixed = eds().replace("ParameterName=Transmission type\nObjectType=7\nDataType=0x5\nAccessType=rw",
                          "ParameterName=Transmission type\nObjectType=7\nDataType=0x5\nAccessType=ro")  # fmt: skip
    kept = Kept(rig_with("cia404", tmp_path, device=fixed), tmp_path).ticks(100)
    (problem,) = kept.run.cycle.problems
    assert "sensors.force: node 96: 1800h:02 aborted" in problem
    assert np.isnan(kept.values).all()


def test_a_class_that_raises_is_a_bad_frame_and_its_line_is_told(tmp_path: Path) -> None:
    kept = Kept(rig_with("own", tmp_path), tmp_path).ticks(300)
    cycle = kept.run.cycle
    cycle.inbox.collect([Frame(0x3F1, bytes(3))], cycle.sent_sequence)
    assert cycle.problems == []
    rig = rig_with("own", tmp_path, "sensors.force.parameters={counts=0}")
    (problem,) = Kept(rig, tmp_path).run.cycle.problems or [""]
    assert problem == ""
    reader = Kept(rig, tmp_path).run.cycle
    reader.inbox.collect([Frame(0x3F1, bytes(5))], -1)
    (problem,) = reader.problems
    assert "sensors.force.kind = './force.py:Scale': decode: " in problem
    assert "ZeroDivisionError" in problem


REFUSED = {
    "dbc": [
        ("sensors.force.file='none.dbc'", "sensors.force.file: "),
        ("sensors.force.signal='Weight'", "sensors.force.signal = 'Weight': message Reading has Force, Count, State"),
        ("sensors.force.can_id=0x111", "sensors.force.can_id = 0x111: no such message in force.dbc: Reading 0x3f1"),
        ("sensors.force.range=[-1.0, 1.0]", "sensors.force: range"),
        ("sensors.force.node=3", "node: a key of kind = 'cia404', not of 'dbc'"),
        ("sensors.force.signal=''", "signal: kind = 'dbc' needs it"),
    ],
    "cia404": [
        ("sensors.force.can_id=0x1E1", "sensors.force.can_id = 0x1e1: its file has 0x1e0 for TPDO 1 of node 96"),
        ("sensors.force.channel=2", "TPDO 1 (1A00h) carries no process value of channel 2"),
        ("bus.protocol=stage_classic", "sends no SYNC"),
        ("sensors.force.file='none.eds'", "sensors.force.file: "),
    ],
    "own": [
        ("sensors.force.kind='./force.py:Nothing'", "'Nothing' is no class with decode"),
        ("sensors.force.parameters={wrong=1}", "sensors.force.parameters.wrong"),
        ("sensors.force.kind='./none.py:Scale'", "sensors.force.kind"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("kind", "change", "words"), [(k, *pair) for k, pairs in REFUSED.items() for pair in pairs])
def test_what_cannot_be_is_refused_by_its_key(kind: str, change: str, words: str, tmp_path: Path) -> None:
    with pytest.raises((RigError, ValueError)) as refused:
        LockstepRun(rig_with(kind, tmp_path, change), tmp_path)
    assert words in str(refused.value)


LAW = """import hil


class Gives(hil.Law):
    seen = []

    def reset(self, position, force):
        pass

    def force(self, inputs):
        (reading,) = inputs.readings
        Gives.seen.append((reading.value, reading.valid))
        return -50.0 * inputs.velocity_estimate - 2000.0 * (inputs.position_estimate - inputs.start.position)
"""


def test_a_law_of_the_users_sees_the_newest_reading_of_every_sensor(tmp_path: Path) -> None:
    (tmp_path / "gives.py").write_text(LAW)
    rig = rig_with("dbc", tmp_path, "law.name=./gives.py:Gives", "law.gains={}")
    kept = Kept(rig, tmp_path).until_active().ticks(8)
    assert kept.run.cycle.state is State.ACTIVE
    seen = law_class(rig.law).seen
    assert seen[-1] == (kept.values[-1], True)
    assert kept.run.cycle.failure == ""
