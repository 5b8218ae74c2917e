"""Sensors beside every layout, in lockstep: their readings in the record, their faults, and what a rig without pays."""

from pathlib import Path

import numpy as np
import pytest

import hil
from drivers.protocols.base import Reject
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.file import load_rig, rig_hash
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig, RigError
from hil.runs.summary import load_run
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from sim_plant.scenario.language import Scenario
from tests.support.judged import analysed
from tests.support.kept_readings import Kept
from tests.support.paths import RIGS

FORCE = 'sensors.force={can_id=0x3F1, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}'
# Punctured at 0.86 mN; the sensor's amplifier shows the fall within 3 ms.
CELL = "plant.cells=[{axis='z', surface=-0.0038, direction=-1, stiffness=1.75e8, puncture_depth=170e-6}]"
MEASURED = "plant.sensors=[{sensor='force', measures='cell_force', axis='z', lag=5e-4}]"
SHIPPED = sorted(path.stem for path in RIGS.glob("*.toml"))


def test_a_force_that_falls_by_three_quarters_of_a_millinewton_in_3_ms_is_no_fault_and_in_the_record() -> None:
    kept = Kept(load_rig(RIGS / "microscope-ideal.toml", (FORCE, CELL, MEASURED))).ticks(3200)
    assert (kept.run.cycle.state, kept.run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert not any(kept.run.cycle.monitor.counts)
    assert kept.run.cycle.inbox.rejects == [0] * len(Reject)
    top = int(np.nanargmax(kept.values))
    assert kept.values[top] - kept.values[top + 3] >= 0.75e-3
    assert kept.ages[5:].max() == 0, "sampled in step with the tick, and there in the next"
    rest = kept.values[top + 20 : top + 200]
    assert np.std(rest) == pytest.approx(5e-6, rel=0.25)


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_a_sensor_stands_beside_every_layout(name: str) -> None:
    rig = load_rig(RIGS / f"{name}.toml", (FORCE,))
    without = load_rig(RIGS / f"{name}.toml")
    kept = Kept(rig).ticks(400)
    assert kept.run.cycle.fault is Fault.NONE
    assert kept.run.cycle.inbox.rejects == Kept(without).ticks(400).run.cycle.inbox.rejects
    assert kept.ages[200:].max() == 0
    assert 2e-6 < np.std(kept.values[200:]) < 10e-6
    assert analysed(rig).bus_load > analysed(without).bus_load


def test_a_sensor_changes_no_frame_of_the_drives() -> None:
    def commands(rig: RigConfig) -> list[bytes]:
        sent: list[bytes] = []
        run = LockstepRun(rig, RIGS, observer=lambda t, f, result: sent.extend(frame.data for frame in result.frames))
        for _ in range(800):
            run.tick()
        return sent

    assert commands(load_rig(RIGS / "paper.toml", (FORCE,))) == commands(load_rig(RIGS / "paper.toml"))


def test_a_rig_without_sensors_is_what_it_was() -> None:
    rig = load_rig(RIGS / "paper.toml")
    assert "sensors" not in rig.model_dump(mode="json")
    assert "sensors" not in rig.model_dump(mode="json")["plant"]
    assert rig_hash(rig) == rig_hash(load_rig(RIGS / "paper.toml", ("sensors={}", "plant.sensors=[]")))
    kept = Kept(rig).ticks(50)
    assert kept.run.cycle.readings is None
    assert not kept.values.any()
    assert not kept.ages.any()


@pytest.mark.parametrize("fd", [False, True])
def test_a_delay_of_the_sensor_is_within_the_tick(fd: bool) -> None:
    force = FORCE.replace("unit", f"stuck_ticks=0, fd={str(fd).lower()}, unit")
    plant = "plant.sensors=[{sensor='force', measures='position', axis='x', delay=3e-4, noise=0.0}]"
    rig = load_rig(RIGS / "paper.toml", (force.replace("0.01]", "1.0]").replace("[-0.01", "[-1.0"), plant))
    kept = Kept(rig).ticks(1500)
    assert kept.run.cycle.fault is Fault.NONE
    assert kept.ages[5:].max() == 0
    shown = np.array([row["position"][0] for row in kept.rows])
    assert np.abs(kept.values[900:] - shown[900:]).max() < 1e-7, "both of the same instant"
    assert np.ptp(shown[900:]) > 1e-3, "while it moves"


SCENARIOS = {
    "sensor_silent": Fault.SENSOR_SILENT,
    "sensor_invalid": Fault.SENSOR_SILENT,
    "sensor_stuck": Fault.SENSOR_STUCK,
    "sensor_value": Fault.SENSOR_RANGE,
}


@pytest.mark.requirement(id="SR-8.1")
@pytest.mark.parametrize("kind", SCENARIOS)
def test_a_sensor_that_fails_stops_the_stage_by_the_faults_name(kind: str) -> None:
    fault = {"kind": kind, "sensor": "force", "at_s": 0.6} | ({"value": 0.011} if kind == "sensor_value" else {})
    scenario = Scenario.model_validate({"fault": [fault]})
    kept = Kept(load_rig(RIGS / "paper.toml", (FORCE,)), scenario=scenario).ticks(700)
    assert (kept.run.cycle.state, kept.run.cycle.fault) == (State.FAULT, SCENARIOS[kind])
    latched = next(place for place, row in enumerate(kept.rows) if row["fault"])
    assert 600 < latched <= 611


def test_one_gap_is_bridged_and_a_wrong_sequence_number_is_counted() -> None:
    faults = [
        {"kind": "sensor_silent", "at_s": 0.6, "duration_ticks": 2},
        {"kind": "sensor_sequence", "at_s": 0.7},
    ]
    scenario = Scenario.model_validate({"fault": faults})
    kept = Kept(load_rig(RIGS / "paper.toml", (FORCE,)), scenario=scenario).ticks(800)
    assert (kept.run.cycle.state, kept.run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert kept.ages[550:].max() == 2
    assert kept.run.cycle.monitor.named_counts()["sensor_sequence"] == 1


def test_a_sensor_that_was_never_there_stops_the_first_motion_and_a_reset_does_not_mend_it() -> None:
    scenario = Scenario.model_validate({"fault": [{"kind": "sensor_silent", "at_s": 0.0}]})
    kept = Kept(load_rig(RIGS / "paper.toml", (FORCE,)), scenario=scenario).ticks(300)
    assert kept.run.cycle.fault is Fault.SENSOR_SILENT
    assert np.isnan(kept.values).all()
    assert not any(row["force"].any() for row in kept.rows[-100:])


def test_replay_needs_the_recording_alone(tmp_path: Path) -> None:
    rig = load_rig(RIGS / "paper.toml", (FORCE,))
    path = tmp_path / "run.mcap"
    recorder = LockstepRecorder(path, rig, RIGS / "paper.toml")
    faults = [{"kind": "sensor_silent", "sensor": "force", "at_s": 0.6}]
    run = LockstepRun(rig, RIGS, observer=recorder.observe, scenario=Scenario.model_validate({"fault": faults}))
    for _ in range(700):
        run.tick()
    recorder.close()
    replayed = replay_run(path)
    assert (replayed.ticks, replayed.different) == (700, 0)
    assert replayed.latched is not None
    assert (replayed.latched.name, replayed.latched.axis) == ("sensor_silent", "force")


def test_a_frame_that_was_held_up_makes_an_older_reading() -> None:
    delay = {"kind": "wire_delay", "node": "force", "at_s": 0.6, "duration_s": 0.1, "delay_s": 1.1e-3, "count": 100}
    kept = Kept(load_rig(RIGS / "paper.toml", (FORCE,)), scenario=Scenario.model_validate({"fault": [delay]})).ticks(
        800
    )
    assert (kept.run.cycle.state, kept.run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert set(kept.ages[610:690].tolist()) == {1}, "sampled a tick earlier, although one comes in every tick"
    assert set(kept.ages[720:].tolist()) == {0}


def test_what_a_sensor_said_is_in_the_columns_of_a_run_its_export_and_its_recording(tmp_path: Path) -> None:
    light = 'sensors.state={can_id=0x3F2, unit="W", scale=0.5, noise=0.0, stuck_ticks=0, range=[-1.0, 1.0]}'
    rig = hil.load_rig(RIGS / "paper.toml", (FORCE, light))
    run = hil.simulate(rig, 0.3, record=tmp_path / "run.mcap")
    readings, ages = run.columns["readings"], run.columns["reading_age"]
    assert (readings.shape, ages.shape) == ((300, 2), (300, 2))
    assert np.std(readings[10:, 0]) == pytest.approx(5e-6, rel=0.25)
    assert not readings[10:, 1].any()
    assert not ages[10:].any()
    run.export(tmp_path / "run.csv")
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_array_equal(table["force_reading"], readings[:, 0])
    np.testing.assert_array_equal(table["state_age_ticks"], ages[:, 1])
    run.export(tmp_path / "run.npz")
    for again in (hil.load_run(tmp_path / "run.npz"), hil.load_run(tmp_path / "run.mcap")):
        np.testing.assert_array_equal(again.columns["readings"], readings)
        np.testing.assert_array_equal(again.columns["reading_age"], ages)
    shown = load_run(tmp_path / "run.mcap").columns["readings"][10:, 0]
    assert 0.0 < np.abs(shown - readings[10:, 0]).max() <= 1e-8 / 4, "in the file to half a count"


def test_a_run_without_sensors_has_no_such_columns() -> None:
    run = hil.simulate(RIGS / "paper.toml", 0.05)
    assert not {"readings", "reading_age"} & {*run.columns}
    assert not [name for name in run.table() if name.endswith(("_reading", "_age_ticks"))]


REFUSALS = {
    "sensors.force.can_id=0x1FF0": "less than or equal to 2047",
    "sensors.force.range=[0.01, -0.01]": "range = [0.01, -0.01]: the first must be below the second",
    "sensors.force.range=[-30.0, 30.0]": "a frame carries -21.4748 to 21.4748",
    "sensors.force.noise=0.0": "noise = 0, stuck_ticks = 8",
    "sensors.force.noise=2e-8": "stuck_ticks = 8: with noise = 2e-08 and scale = 1e-08",
    "sensors.x={can_id=0x3F2, unit='N', scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}": "sensors.x: an axis",
    "sensors.b={can_id=0x3F1, unit='N', scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}": "identifier of sensors.force",
    "plant.sensors=[{sensor='light', measures='position', axis='x'}]": "sensor = 'light': no such sensor",
    "plant.sensors=[{sensor='force', measures='position', axis='q'}]": "no axis 'q'",
    "sensors.force.kind='analog'": "hil, dbc, cia404",
}


@pytest.mark.parametrize("override", REFUSALS)
def test_a_sensor_that_cannot_be_is_refused_with_key_value_and_range(override: str) -> None:
    with pytest.raises(RigError) as refused:
        load_rig(RIGS / "paper.toml", (FORCE, override))
    assert REFUSALS[override] in str(refused.value)


def test_an_identifier_of_the_layout_is_refused() -> None:
    layout = host_layout(load_rig(RIGS / "paper.toml"), RIGS)
    for message in layout.messages(1_000_000):
        rig = load_rig(RIGS / "paper.toml", (FORCE, f"sensors.force.can_id={message.can_id}"))
        with pytest.raises(RigError, match=f"sensors.force.can_id = {message.can_id:#x}: '{message.name}'"):
            refuse_unschedulable(rig, RIGS)


def test_an_fd_sensor_on_a_classic_layout_is_refused() -> None:
    rig = load_rig(RIGS / "odrive.toml", (FORCE, "sensors.force.fd=true"))
    with pytest.raises(RigError, match=r"sensors.force.fd = true: bus.protocol = .* is one of classic CAN"):
        refuse_unschedulable(rig, RIGS)


def test_a_scenario_names_sensors_of_the_rig_alone() -> None:
    for fault, text in (
        ({"kind": "sensor_silent", "axis": "x", "at_s": 1.0}, "takes `sensor` instead"),
        ({"kind": "encoder_silent", "sensor": "force", "at_s": 1.0}, "of the sensor_... kinds alone"),
    ):
        with pytest.raises(ValueError, match=text):
            Scenario.model_validate({"fault": [fault]})
    scenario = Scenario.model_validate({"fault": [{"kind": "sensor_silent", "sensor": "light", "at_s": 1.0}]})
    with pytest.raises(ValueError, match="sensor = 'light': not known"):
        scenario.check(["x"], sensors=["force"])
    with pytest.raises(ValueError, match="the rig has no"):
        scenario.check(["x"])
