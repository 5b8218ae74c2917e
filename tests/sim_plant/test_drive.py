"""One servo drive: what feeds its watchdog, what latches, and what opens the latches again."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.protocols.base import DriveStatus
from sim_plant.drives.servo import NEVER_NS, ServoDrive, Trip

MS = 1_000_000
MODULUS = 256


def make_drive(has_brake: bool = False, opening_ns: int = 0) -> ServoDrive:
    return ServoDrive(0, 5.0, 1e-7, 10 * MS, has_brake, MODULUS, opening_ns=opening_ns)


def command(drive: ServoDrive, sequence: int, force: float = 1.0, *, enable: bool = True, reset: bool = False) -> bool:
    return drive.on_command(force, enable, reset, sequence, sequence * MS)


def test_applies_force_only_where_enabled() -> None:
    drive = make_drive()
    assert drive.deadline_ns == NEVER_NS  # not armed: no host has spoken yet
    command(drive, 1, enable=False)
    assert (drive.force, drive.status & DriveStatus.ENABLED) == (0.0, 0)
    command(drive, 2)
    assert (drive.force, drive.status & DriveStatus.ENABLED) == (1.0, DriveStatus.ENABLED)


def test_an_older_or_repeated_command_neither_acts_nor_feeds_the_watchdog() -> None:
    drive = make_drive()
    command(drive, 200, force=1.0)
    for sequence in (200, 199, 200 - MODULUS // 2 + 1):
        assert not command(drive, sequence, force=3.0)
    assert (drive.force, drive.deadline_ns, drive.stale) == (1.0, 210 * MS, 3)
    assert command(drive, 255)
    assert drive.on_command(2.0, True, False, 256 % MODULUS, 256 * MS)  # the sequence wraps
    assert drive.force == 2.0


@pytest.mark.requirement(id="SR-6.2")
def test_the_watchdog_latches_until_a_fresh_reset_edge() -> None:
    drive = make_drive()
    command(drive, 1, force=2.0)
    drive.trip(11 * MS)
    assert drive.trips == [Trip(1 * MS, 11 * MS, 2.0)]
    assert (drive.force, drive.status & DriveStatus.WATCHDOG) == (0.0, DriveStatus.WATCHDOG)
    command(drive, 20, reset=True)  # left on from before: no edge
    command(drive, 21, reset=True)
    assert drive.status & DriveStatus.WATCHDOG
    command(drive, 22)
    assert drive.force == 0.0
    command(drive, 23, reset=True)
    assert not drive.status & DriveStatus.WATCHDOG
    assert drive.force == 1.0


def test_a_host_that_starts_its_sequence_anew_is_heard_after_the_watchdog_expired() -> None:
    drive = make_drive()
    command(drive, 100)
    assert not command(drive, 3)
    drive.trip(110 * MS)
    assert command(drive, 3)


@pytest.mark.parametrize("force", [5.1, -5.1, math.nan, math.inf, -math.inf])
def test_an_impossible_force_is_a_latched_fault(force: float) -> None:
    drive = make_drive()
    command(drive, 1, force=force)
    assert (drive.force, drive.status & DriveStatus.FAULT) == (0.0, DriveStatus.FAULT)
    command(drive, 2, force=1.0)
    assert drive.force == 0.0


def test_a_broken_drive_comes_back_with_its_fault_after_every_reset() -> None:
    drive = make_drive()
    drive.broken = True
    drive.fail()
    command(drive, 1)
    command(drive, 2, reset=True)
    assert drive.status & DriveStatus.FAULT
    drive.broken = False
    command(drive, 3)
    command(drive, 4, reset=True)
    assert not drive.status & DriveStatus.FAULT


def test_the_brake_is_on_whenever_there_is_no_force() -> None:
    drive = make_drive(has_brake=True)
    assert drive.status & DriveStatus.BRAKE
    command(drive, 1)
    assert not drive.status & DriveStatus.BRAKE
    drive.trip(11 * MS)
    assert drive.status & DriveStatus.BRAKE


def test_a_brake_that_takes_time_opens_on_the_force_that_stands_by_then() -> None:
    drive = make_drive(has_brake=True, opening_ns=3 * MS)
    for sequence in range(1, 4):  # later commands do not put it off
        command(drive, sequence)
        assert (drive.opens_ns, drive.force) == (4 * MS, 1.0)
        drive.open(4 * MS - 1)
        assert drive.status & DriveStatus.BRAKE
        assert drive.status & DriveStatus.ENABLED
    drive.open(4 * MS)
    assert not drive.status & DriveStatus.BRAKE
    assert drive.opens_ns == NEVER_NS


@pytest.mark.parametrize("how", ["disabled", "trip", "fault"])
def test_a_drive_that_lets_go_while_its_brake_opens_keeps_it_closed(how: str) -> None:
    drive = make_drive(has_brake=True, opening_ns=3 * MS)
    command(drive, 1)
    assert drive.opens_ns == 4 * MS
    if how == "disabled":
        command(drive, 2, enable=False)
    elif how == "trip":
        drive.trip(2 * MS)
    else:
        drive.fail()
    drive.open(100 * MS)
    assert drive.status & DriveStatus.BRAKE
    if how == "disabled":
        command(drive, 3)
        assert drive.opens_ns == 6 * MS, "it begins anew"


def test_the_encoder_rounds_to_its_resolution_and_answers_with_the_last_sequence() -> None:
    drive = make_drive()
    command(drive, 7)
    sample = drive.sample(1.26e-6, 8 * MS)
    assert (sample.position, sample.sequence, sample.stamp_ns) == (13, 7, 8 * MS)


actions = st.lists(
    st.one_of(
        st.tuples(st.just("command"), st.integers(0, 255), st.floats(allow_nan=True), st.booleans(), st.booleans()),
        st.tuples(st.just("trip")),
        st.tuples(st.just("fail")),
    ),
    max_size=40,
)


@given(actions)
def test_whatever_happens_a_latched_or_disabled_drive_applies_no_force(script: list[tuple[object, ...]]) -> None:
    drive = make_drive(has_brake=True)
    for now_ms, action in enumerate(script):
        if action[0] == "command":
            _, sequence, force, enable, reset = action
            drive.on_command(force, enable, reset, sequence, now_ms * MS)  # type: ignore[arg-type]
        elif action[0] == "trip":
            drive.trip(now_ms * MS)
        else:
            drive.fail()
        assert drive.status & DriveStatus.WATCHDOG or action[0] != "trip"
        assert abs(drive.force) <= 5.0 * 1.000001
        applies = bool(drive.status & DriveStatus.ENABLED)
        latched = bool(drive.status & (DriveStatus.FAULT | DriveStatus.WATCHDOG))
        assert not (applies and latched)
        assert applies != bool(drive.status & DriveStatus.BRAKE)
        if not applies:
            assert drive.force == 0.0
