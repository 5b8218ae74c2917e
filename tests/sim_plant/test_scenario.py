"""Fault scenarios in a whole lockstep run: names checked against the rig, faults begun by state and phase."""

from pathlib import Path

import pytest

from hil.cycle.state_machine import State
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun
from hil.virtual.scenario import load_scenario
from sim_plant.scenario.language import Scenario
from tests.support.paths import ROOT

DEPLOY = ROOT / "deploy"
RIG = DEPLOY / "rigs/microscope-ideal.toml"
SHIPPED = sorted(DEPLOY.glob("scenarios/*.toml"))


def run(scenario: Scenario | None, ticks: int) -> LockstepRun:
    lockstep = LockstepRun(
        load_rig(RIG), RIG.parent, scenario=scenario, observer=Invariants(load_rig(RIG), RIG.parent).observe
    )
    for _ in range(ticks):
        lockstep.tick()
    return lockstep


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_scenario_we_ship_fits_the_microscope(path: Path) -> None:
    assert len(load_scenario(path, load_rig(RIG)).fault) == 3


def test_a_phase_or_state_the_rig_does_not_have_is_refused_with_the_allowed_ones(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(
        '[[fault]]\nkind = "garbage"\nat_phase = "lunch"\n[[fault]]\nkind = "garbage"\nat_state = "ASLEEP"\n'
    )
    with pytest.raises(RigError) as caught:
        load_scenario(path, load_rig(RIG))
    assert "at_phase = 'lunch': not known; allowed: home, approach" in str(caught.value)
    assert "at_state = 'ASLEEP': not known; allowed: BOOT" in str(caught.value)
    with pytest.raises(RigError, match="No such file"):
        load_scenario(tmp_path / "missing.toml", load_rig(RIG))


def test_a_scenario_for_a_rig_whose_task_is_impossible_is_refused_for_the_task(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text('[[fault]]\nkind = "garbage"\nat_s = 0.1\n')
    rig = load_rig(RIG, ["task.injection.contact_speed=100"])
    with pytest.raises(RigError, match="contact_speed = 100"):
        load_scenario(path, rig)


def test_a_fault_at_a_state_begins_in_the_tick_that_enters_it_and_is_reacted_to() -> None:
    fault = {"kind": "encoder_silent", "axis": "y", "at_state": "ACTIVE", "after_s": 0.05}
    lockstep = run(Scenario.model_validate({"fault": [fault]}), 200)
    assert lockstep.injector is not None
    ((began_ns, _),) = lockstep.injector.began
    assert began_ns == lockstep.activated_at * 1_000_000 + 50_000_000
    assert lockstep.cycle.state is State.FAULT
    assert lockstep.stage.applied_force == [0.0] * 4


def test_a_scenario_whose_fault_never_comes_changes_no_byte() -> None:
    never = Scenario.model_validate({"fault": [{"kind": "garbage", "at_phase": "dwell"}]})
    assert run(never, 60).trace_sha256 == run(None, 60).trace_sha256
