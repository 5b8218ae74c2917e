"""The paper's task on drives of two makers on one bus, each by its own EDS, and while a vendor's tool reads along."""

from pathlib import Path
from typing import Any

import pytest

from drivers.families.cia402 import cia301
from drivers.families.cia402.node import Phase
from drivers.frame import Frame
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate
from tests.support.bought_drives import EDS, cia402, write_files
from tests.support.foreign_drive import FULL_DRIVE, U32, Fact, eds_text

OTHER = "other.eds"


def two_makers(folder: Path, **settings: object) -> RigConfig:
    """X on a drive that lacks much, Y on one that has all."""
    write_files(folder)
    (folder / OTHER).write_text(eds_text(FULL_DRIVE, dummies=(3, 6)))
    facts: dict[str, Any] = cia402()
    facts["bus"]["cia402"] |= {"eds": [EDS, OTHER], **settings}
    return RigConfig.model_validate(facts)


@pytest.mark.long
def test_the_papers_task_runs_on_drives_of_two_makers(tmp_path: Path) -> None:
    rig = two_makers(tmp_path)
    report, _ = simulate(rig, tmp_path, 8.0)
    assert report.faults == {}
    assert report.state in (State.ACTIVE.name, State.READY.name)
    (tmp_path / "one").mkdir()
    write_files(tmp_path / "one")
    alone, _ = simulate(RigConfig.model_validate(cia402()), tmp_path / "one", 8.0)
    for axis in ("x", "y"):
        assert report.axes[axis]["max_error"] == pytest.approx(alone.axes[axis]["max_error"], rel=0.2)


def test_each_drive_is_configured_by_its_own_file(tmp_path: Path) -> None:
    run = LockstepRun(two_makers(tmp_path), tmp_path)
    for _ in range(1500):
        run.tick()
    host = run.cycle.protocol.layout if hasattr(run.cycle.protocol, "layout") else run.cycle.protocol
    lacking, full = host.nodes
    assert [node.phase for node in (lacking, full)] == [Phase.RUNNING] * 2
    written = [{step.object_index for step in node._steps if step.size} for node in (lacking, full)]
    only_full = {0x1006, 0x1014, 0x60C2, 0x6072, 0x605C, 0x6007}
    assert not only_full & written[0]
    assert only_full <= written[1]


def test_a_vendors_tool_that_reads_along_puts_nothing_into_fault(tmp_path: Path) -> None:
    """Twenty reads, in states of every kind: the tool's requests, the answers to it, and ours among them."""
    run = LockstepRun(two_makers(tmp_path), tmp_path)
    answers: list[bytes] = []
    asked = [(0x6041 + tick % 7).to_bytes(2, "little") for tick in range(50, 3000, 100)]

    def hear(frame: Frame) -> None:
        if frame.can_id & 0x780 == cia301.SDO_RESPONSE_ID and frame.data[1:3] in asked:
            answers.append(frame.data)

    tool = run.wire.attach("tool", hear, 16)
    for tick in range(3000):
        if tick % 100 == 50:
            node = (3, 9)[tick // 100 % 2]
            request = cia301.SDO.pack(0x40, 0x6041 + tick % 7, 0, bytes(4))
            assert tool.send(Frame(cia301.SDO_REQUEST_ID + node, request), run.wire.now_ns)
        run.tick()
    assert len(answers) == 30
    assert run.cycle.fault is Fault.NONE
    assert run.cycle.state is State.ACTIVE


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({(0x6502, 0): Fact(U32, "ro", "0x1A5")}, "6502h:00 is 0x1a5: offers"),
        ({(0x6071, 0): FULL_DRIVE[0x6071, 0]._replace(mappable=False)}, "6071h:00 cannot be mapped"),
    ],
)
def test_one_drive_that_cannot_be_used_refuses_the_rig_by_axis_and_object(
    change: dict[tuple[int, int], Fact], says: str, tmp_path: Path
) -> None:
    rig = two_makers(tmp_path)
    (tmp_path / OTHER).write_text(eds_text(FULL_DRIVE | change))
    with pytest.raises(ValueError, match=rf"axis 1 .*{says}"):
        simulate(rig, tmp_path, 0.1)
