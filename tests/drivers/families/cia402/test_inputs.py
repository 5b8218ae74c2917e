"""60FDh of CiA 402 drives: limit and home switches in a TPDO of their own, at every SYNC."""

from pathlib import Path
from typing import Any

import pytest

from drivers.families.cia402.inputs import TPDO2_ID, UNTOLD_TICKS, InputWatch
from drivers.protocols.base import OF_DRIVES, DriveStatus, LayoutError
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.bought_drives import EDS, cia402
from tests.support.foreign_drive import CST_DRIVE, U32, Fact, eds_text

FACT = Fact(U32, "ro", "0", True)
TICKS = 3000


def rig_of(folder: Path, fact: Fact | None = FACT, *, told: bool = True, direction: int = 1) -> RigConfig:
    """The paper's stage on CST drives that have 60FDh as `fact` says, with limit switches at x."""
    (folder / EDS).write_text(eds_text(CST_DRIVE | ({(0x60FD, 0): fact} if fact else {})))
    document = cia402()
    document["bus"]["cia402"]["inputs"] = told
    document["axes"]["x"] |= {"direction": direction}
    document["axes"]["x"]["limits"]["switches"] = True
    document["plant"] |= {"switches": [{"axis": "x", "low": -0.02, "high": 0.02}]}
    return RigConfig.model_validate(document)


@pytest.mark.parametrize("direction", [1, -1])
def test_an_axis_that_runs_onto_a_switch_is_stopped(direction: int, tmp_path: Path) -> None:
    run = LockstepRun(rig_of(tmp_path, direction=direction), tmp_path)
    while not run.cycle.fault:
        run.tick()
        assert run.index < TICKS
    assert run.cycle.fault is Fault.LIMIT_SWITCH
    (evidence,) = run.cycle.monitor.armed_evidence()
    assert (evidence.axis, evidence.value) == (0, 0.0 if run.true_position[0] < 0 else 1.0)
    assert 0.02 <= abs(run.true_position[0]) < 0.0205


def test_a_drive_that_ceases_to_tell_its_inputs_is_in_fault(tmp_path: Path) -> None:
    run = LockstepRun(rig_of(tmp_path), tmp_path)
    while run.cycle.state is not State.READY:
        run.tick()
        assert run.index < TICKS
    nodes: Any = run.stage._nodes
    (told,) = [pdo for pdo in nodes[0]._tpdos if pdo.can_id == TPDO2_ID + 3]
    told.can_id = -1
    began = run.index
    while not run.cycle.fault:
        run.tick()
        assert run.index < began + 50
    assert run.cycle.fault is Fault.DRIVE_FAULT
    assert run.index - began > UNTOLD_TICKS


@pytest.mark.parametrize(
    ("word", "status"),
    [
        (0, 0),
        (1, DriveStatus.LIMIT_LOW),
        (2, DriveStatus.LIMIT_HIGH),
        (4, DriveStatus.HOME),
        (0xFFFF0008, 0),  # interlock, and inputs of the maker's
        (7, DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH | DriveStatus.HOME),
    ],
)
def test_the_bits_of_the_word(word: int, status: int) -> None:
    watch = InputWatch()
    assert watch.status(0) == DriveStatus.FAULT
    watch.hear(word.to_bytes(4, "little"), 1)
    assert watch.status(1 + UNTOLD_TICKS) == status
    assert watch.status(2 + UNTOLD_TICKS) == status | DriveStatus.FAULT


@pytest.mark.parametrize(
    ("fact", "told", "says"),
    [
        (FACT, False, "its answers have no bit for LIMIT_LOW|LIMIT_HIGH, which axes.x.limits.switches = true needs"),
        (None, True, "60FDh:00 is not in the EDS"),
        (FACT._replace(mappable=False), True, "60FDh:00 cannot be mapped into a PDO"),
    ],
)
def test_a_drive_that_cannot_tell_them_is_refused(fact: Fact | None, told: bool, says: str, tmp_path: Path) -> None:
    with pytest.raises(LayoutError) as caught:
        host_layout(rig_of(tmp_path, fact, told=told), tmp_path)
    assert says in str(caught.value)


def test_no_other_input_is_told(tmp_path: Path) -> None:
    told = DriveStatus(host_layout(rig_of(tmp_path), tmp_path).tells & ~OF_DRIVES)
    assert told == DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH | DriveStatus.HOME


def test_their_frames_are_counted_in_the_bus_load(tmp_path: Path) -> None:
    messages = host_layout(rig_of(tmp_path), tmp_path).messages(1_000_000)
    assert [(m.can_id, m.length) for m in messages if m.name.startswith("inputs")] == [(0x283, 4), (0x289, 4)]
