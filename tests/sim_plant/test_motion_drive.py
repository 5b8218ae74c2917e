"""The drive that stands alone: every mode its EDS offers moves its motor, and no other is taken."""

from pathlib import Path

import pytest

from drivers.families.cia402.cia301 import DriveState
from sim_plant.drives.motion_drive import (
    CSP,
    CST,
    CSV,
    EMULATED,
    HM,
    NEGATIVE_LIMIT,
    POSITIVE_LIMIT,
    PP,
    PV,
    TQ,
    MotionDrive,
)
from sim_plant.drives.motor import Motor
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from tests.support.foreign_drive import I32, MOTION_DRIVE, U16, U32, Fact, eds_text
from tests.support.motion_line import ACCELERATION, MS, NODE, SPEED, Line


@pytest.mark.parametrize("mode", range(-1, 12))
def test_a_mode_is_taken_where_the_eds_offers_it_and_it_is_emulated(mode: int, tmp_path: Path) -> None:
    line = Line(tmp_path, modes=0x3FF)
    taken = line.write(0x6060, mode, 1) == 0
    assert taken == (mode in EMULATED or mode == 0)
    assert line.drive.dictionary.get(key_of(0x6061)) == (mode if taken else 0)
    other = Line(tmp_path / "other", modes=0x1)  # profile position alone
    assert (other.write(0x6060, mode, 1) == 0) == (mode in (0, PP))


def test_profile_position_moves_within_its_profile_and_shakes_hands(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(PP)
    assert line.write(0x607A, 5000, 4) == line.write(0x6040, 0x1F, 2) == 0
    assert line.word & 0x1400 == 0x1000  # acknowledged, not reached
    assert line.write(0x6040, 0x0F, 2) == 0
    assert line.word & 0x1000 == 0
    fastest = 0
    start = line.now
    while not line.word & 0x0400 and line.now < start + 2000 * MS:
        line.pass_time(1)
        fastest = max(fastest, line.speed)
    assert line.position == 5000
    assert 0.9 * SPEED <= fastest <= SPEED
    assert (line.now - start) * 1e-9 == pytest.approx(5000 / SPEED + SPEED / ACCELERATION, rel=0.1)
    assert line.write(0x607A, -1000, 4) == line.write(0x6040, 0x5F, 2) == 0  # relative
    line.pass_time(1000)
    assert line.position == 4000


def test_profile_velocity_ramps_and_halts(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(PV)
    assert line.word & 0x1000
    assert line.write(0x60FF, 10_000, 4) == 0
    line.pass_time(25)
    assert line.speed == pytest.approx(5000, rel=0.1)
    assert line.word & 0x1400 == 0
    line.pass_time(100)
    assert line.speed == 10_000
    assert line.word & 0x0400
    assert line.write(0x6040, 0x010F, 2) == 0
    line.pass_time(1)
    assert line.speed == 0
    stood = line.position
    line.pass_time(100)
    assert line.position == stood
    assert line.write(0x6040, 0x0F, 2) == 0
    line.pass_time(5)
    assert line.speed == pytest.approx(ACCELERATION * 5e-3)
    assert line.position - stood <= 3  # 0.5 a t^2: nothing of the time in which it was halted


def test_cyclic_positions_are_reached_at_the_next_sync_and_velocities_at_once(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(CSP)
    for target in (0, 100, 200, 300):
        assert line.write(0x607A, target, 4) == 0
        line.send(0x080)
        line.pass_time(10)
    assert line.position == 300
    line.pass_time(100)
    assert (line.position, line.speed) == (300, 0)  # the master fell silent: it stands
    assert line.word & 0x1000
    line.enable(CSV)
    assert line.write(0x60FF, -1000, 4) == 0
    assert line.speed == 0
    line.send(0x080)
    line.pass_time(100)
    assert (line.position, line.speed) == (200, -1000)
    assert line.write(0x6040, 0x06, 2) == 0
    line.pass_time(1)
    assert line.speed == pytest.approx(-1000, abs=2)  # switched off, it runs out
    line.pass_time(20_000)
    assert line.speed == 0


@pytest.mark.parametrize("mode", [TQ, CST])
def test_torque_accelerates_the_motor_at_once_or_at_sync(mode: int, tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(mode)
    assert line.write(0x6071, 500, 2) == 0
    line.pass_time(1)
    assert (line.servo.force == 1.0) == (mode == TQ)
    line.send(0x080)
    line.pass_time(1)
    assert line.servo.force == 1.0  # half of 2 N m
    before = line.speed
    line.pass_time(1)
    assert line.speed - before == pytest.approx(1000, rel=0.01)  # 1 N m on 1e-3 kg m^2, in counts of 1e-3 rad, in 1 ms


def test_homing_calls_its_place_home(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.motor.position = 123.0
    line.enable(HM)
    assert line.word & 0x1000 == 0
    assert line.write(0x607C, 40, 4) == line.write(0x6040, 0x1F, 2) == 0
    assert line.word & 0x1400 == 0x1400
    assert line.position == 40


@pytest.mark.parametrize(("switch", "sign"), [(POSITIVE_LIMIT, 1), (NEGATIVE_LIMIT, -1)])
def test_a_limit_switch_stops_the_motor_and_lets_it_move_away(switch: int, sign: int, tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(PV)
    assert line.write(0x60FF, sign * 1000, 4) == 0
    line.pass_time(100)
    assert line.word & 0x0800 == 0
    line.drive.inputs = switch
    assert line.drive.dictionary.get(key_of(0x60FD)) == switch
    stopped = line.position
    line.pass_time(100)
    assert (line.position, line.speed) == (stopped, 0)
    assert line.word & 0x0800
    assert line.write(0x60FF, -sign * 1000, 4) == 0
    line.pass_time(100)
    assert sign * (line.position - stopped) < -50
    assert line.word & 0x0800 == 0


def test_software_limits_hold_the_motor(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(PP)
    assert line.write(0x607D, -100, 4, 1) == line.write(0x607D, 300, 4, 2) == 0
    assert line.write(0x607A, 5000, 4) == line.write(0x6040, 0x1F, 2) == 0
    line.pass_time(1000)
    assert line.position == 300
    assert line.word & 0x0C00 == 0x0800  # limited, not reached


def test_power_that_fails_leaves_a_drive_as_it_came(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.enable(CST)
    line.servo.fail()
    line.pass_time(1)
    assert line.drive.state is DriveState.FAULT
    line.drive.reboot()
    assert [frame.data for frame in line.drive.advance(line.now)] == [b"\0"]
    assert line.drive.state is DriveState.SWITCH_ON_DISABLED
    assert line.drive.mode == line.drive.dictionary.number(key_of(0x6060))


def test_a_following_error_shows_while_it_is_driven_and_after_its_fault_until_the_reset(tmp_path: Path) -> None:
    window = {(0x6065, 0): Fact(U32, "rw", "30"), (0x6066, 0): Fact(U16), (0x60F4, 0): Fact(I32, "ro")}
    line = Line(tmp_path, more=window)
    line.enable(CSP)
    line.drive.blocked = True
    shown = []
    for target in (0, 20, 0):
        line.write(0x607A, target, 4)
        line.send(0x080)
        line.pass_time(10)
        shown.append(line.drive.dictionary.get(key_of(0x60F4)))
    assert shown == [0, 20, 0]
    for word, error in ((0x0F, 20), (0x06, 0)):
        line.write(0x607A, 20, 4)
        line.send(0x080)
        line.write(0x6040, word, 2)
        line.pass_time(10)
        assert (line.drive.dictionary.get(key_of(0x60F4)), line.word & 0x2000) == (error, 0)
    line.enable(CSP)
    line.write(0x607A, 90, 4)
    line.send(0x080)
    line.pass_time(20)
    assert line.drive.state is DriveState.FAULT
    line.pass_time(20)
    assert line.word & 0x2000
    line.write(0x6040, 0x80, 2)
    line.pass_time(1)
    assert line.drive.state is DriveState.SWITCH_ON_DISABLED
    assert line.word & 0x2000 == 0


def test_facts_that_the_file_lacks_are_no_obstacle(tmp_path: Path) -> None:
    facts = {key: fact for key, fact in MOTION_DRIVE.items() if key[0] not in (0x607A, 0x60FF, 0x6081, 0x6502)}
    (tmp_path / "bare.eds").write_text(eds_text(facts | {(0x2001, 0): MOTION_DRIVE[0x6081, 0]}))
    drive = MotionDrive(
        NODE, ServoDrive(0, 1.0, 1e-3, NEVER_NS, False, 0), Motor(1, 1, 1, 0), eds=tmp_path / "bare.eds"
    )
    assert [mode for mode in EMULATED if drive.emulates(mode)] == [CST]
    (tmp_path / "barer.eds").write_text(eds_text({key: fact for key, fact in facts.items() if key[0] != 0x6071}))
    barer = MotionDrive(
        NODE, ServoDrive(0, 1.0, 1e-3, NEVER_NS, False, 0), Motor(1, 1, 1, 0), eds=tmp_path / "barer.eds"
    )
    assert not any(barer.emulates(mode) for mode in EMULATED)
