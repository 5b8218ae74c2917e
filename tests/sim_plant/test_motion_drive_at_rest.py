"""The drive that stands alone, while nothing moves it: what a reset restores, and when it is limited by nothing."""

from pathlib import Path

import pytest

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState, NmtCommand
from drivers.frame import Frame
from sim_plant.drives.motion_drive import HM, NEGATIVE_LIMIT, POSITIVE_LIMIT, PP, PV, TQ, MotionDrive
from sim_plant.drives.motor import Motor
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from tests.support.foreign_drive import I8, MOTION_DRIVE, U32, Fact, eds_text
from tests.support.motion_line import Line

MS = 1_000_000
NODE = 9
LIMITED = 1 << 11


@pytest.fixture
def drive(tmp_path: Path) -> MotionDrive:
    """Operational, with objects of its maker's from 2000h on."""
    own = {(index, 0): Fact(U32, "rw", "7") for index in (0x2000, 0x2001, 0x5FFF)}
    (tmp_path / "made.eds").write_text(eds_text(MOTION_DRIVE | own))
    servo = ServoDrive(0, 2.0, 1e-3, NEVER_NS, False, 0)
    made = MotionDrive(NODE, servo, Motor(1e-3, 1e-3, 1e-3, 0), eds=tmp_path / "made.eds")
    made.advance(MS)
    made.on_frame(Frame(0x000, bytes((NmtCommand.START, NODE)), 0, MS))
    return made


def ask(drive: MotionDrive, command: int, index: int, value: int = 0) -> int:
    """The number that is answered to an SDO request."""
    request = cia301.SDO.pack(command, index, 0, value.to_bytes(4, "little"))
    (answer,) = (f for f in drive.on_frame(Frame(0x600 + NODE, request, 0, drive.now_ns)) if f.can_id == 0x580 + NODE)
    assert answer.data[0] != 0x80
    return int.from_bytes(answer.data[4:], "little")


@pytest.mark.parametrize("index", [0x2000, 0x2001, 0x5FFF])
def test_a_reset_of_the_node_restores_the_makers_objects_and_one_of_communication_does_not(
    index: int, drive: MotionDrive
) -> None:
    ask(drive, 0x23, index, 9)
    assert ask(drive, 0x40, index) == 9
    drive.on_frame(Frame(0x000, bytes((NmtCommand.RESET_COMMUNICATION, NODE)), 0, drive.now_ns))
    assert ask(drive, 0x40, index) == 9
    drive.on_frame(Frame(0x000, bytes((NmtCommand.RESET_NODE, NODE)), 0, drive.now_ns))
    assert ask(drive, 0x40, index) == 7


@pytest.mark.parametrize(("stored", "mode"), [(PP, PP), (PV, PV), (HM, HM), (11, 0)])
def test_it_begins_in_the_mode_that_is_stored_where_it_has_that_and_a_reset_returns_to_it(
    stored: int, mode: int, tmp_path: Path
) -> None:
    line = Line(tmp_path, more={(0x6060, 0): Fact(I8, "rw", str(stored), True)})
    assert line.drive.mode == mode
    assert mode == PV or line.word & 0x1000 == 0, "no set-point is acknowledged, and it is not homed yet"
    assert line.write(0x6060, TQ, 1) == 0
    assert line.drive.mode == TQ
    line.nmt(NmtCommand.RESET_NODE)
    assert line.drive.mode == mode


@pytest.mark.parametrize("switch", [POSITIVE_LIMIT, NEGATIVE_LIMIT])
def test_a_motor_that_stands_on_its_limit_switch_is_limited_by_nothing(switch: int, drive: MotionDrive) -> None:
    ask(drive, 0x2F, 0x6060, PV)
    for word in (0x06, 0x07, 0x0F):
        ask(drive, 0x2B, 0x6040, word)
    assert drive.state is DriveState.OPERATION_ENABLED
    drive.inputs = switch
    for _ in range(20):
        drive.advance(drive.now_ns + MS)
        assert ask(drive, 0x40, 0x6041) & LIMITED == 0
